# Another user of the same machine: neither commands, nor models, nor samples. Sourced by checks.sh.
useradd --create-home alice 2>/dev/null
uid=$(id -u plumbline)
alice() { runuser -u alice -- "$@" 2>&1; }

open=$(find /dev/shm -maxdepth 1 -name "plumbline_${uid}_*" -perm /077 | wc -l)
all=$(find /dev/shm -maxdepth 1 -name "plumbline_${uid}_*" | wc -l)
check "shared memory is closed to others" "$all files, $open open" test "$all" -gt 3 -a "$open" = 0
check "the folder of names is closed to others" "$(stat -c '%U %a' /run/plumbline)" test "$(stat -c '%U%a' /run/plumbline)" = plumbline700
for what in start stop quit status; do
    said=$(alice plumbline command $what); code=$?
    check "another user's \`command $what\` is refused" "exit $code" test $code = 1
done
check "and is told whose service it is" "$(printf '%s' "$said" | cut -c 1-70)..." grep -q "belongs to user $uid" <<<"$said"
said=$(alice env PLUMBLINE_RUNTIME_DIR=/run/plumbline plumbline command start); code=$?
check "also when pointed at the daemon's folder" "exit $code" test $code = 1 -a "$(field progress)" = idle
said=$(alice env PLUMBLINE_RUNTIME_DIR=/run/plumbline plumbline torque); code=$?
check "another user reads no torque" "exit $code" test $code = 1
# A segment may be gone between the listing and the reading: what counts is what was read.
runuser -u alice -- cat /dev/shm/plumbline_"${uid}"_* >/tmp/stolen 2>/tmp/refused
refused=$(grep -c 'Permission denied' /tmp/refused || true)
check "nor a byte of any segment" "$(wc -c </tmp/stolen) bytes; $refused of $all refused" test ! -s /tmp/stolen -a "$refused" -gt 3
alice sh -c ': > /run/plumbline/panda.lock' >/dev/null
check "nor touches the lock" "process $(sed -n 's/process //p' /run/plumbline/panda.lock)" grep -q "$(pid_of plumbline)" /run/plumbline/panda.lock

# A user of the group, through the relay: torque, and no request. Model and states: tests/clock/relay.rs.
useradd --create-home --groups plumbline bob 2>/dev/null
bob() { runuser -u bob -- env PLUMBLINE_RUNTIME_DIR=/tmp/bob "$@" 2>&1; }
systemctl start plumbline-relay@panda
listens=$(within 5000 test -S /run/plumbline-relay/panda.sock)
check "the relay listens, for the group alone" "after $listens ms, $(stat -c '%U %G %a' /run/plumbline-relay/panda.sock)" \
    test "$(stat -c '%U%G%a' /run/plumbline-relay /run/plumbline-relay/panda.sock | tr '\n' ' ')" = "plumblineplumbline750 plumblineplumbline660 "
said=$(alice plumbline relay join); code=$?
check "a user outside the group is refused" "$(printf '%s' "$said" | tail -n 1 | cut -c 1-70)" test $code != 0 -a -n "$(grep 'Permission denied' <<<"$said")"
runuser -u bob -- env PLUMBLINE_RUNTIME_DIR=/tmp/bob plumbline relay join >/tmp/bob.log 2>&1 &
joined=$!
bob_reads() { bob plumbline torque | grep -q tau_ff; }
reads=$(within 20000 bob_reads)
check "a user of the group reads the torque" "after $reads ms" bob_reads
for what in start quit status; do
    said=$(bob plumbline command $what); code=$?
    check "and its \`command $what\` is refused" "exit $code" test $code = 1 -a -n "$(grep 'passes no requests' <<<"$said")"
done
bob plumbline command stop >/dev/null; code=$?
check "nor does its stop arrive" "exit $code" test $code = 1 -a "$(field phase)" = hold
said=$(bob env PLUMBLINE_RUNTIME_DIR=/run/plumbline plumbline torque); code=$?
check "the daemon's own folder stays closed to the group" "exit $code" test $code = 1
kill $joined; wait $joined 2>/dev/null
systemctl stop plumbline-relay@panda

# Forging: what is on the disk, then straight through shared memory, with no care of plumbline's own in the way.
modeldir=/var/lib/plumbline/results
mkdir -p $modeldir && chown plumbline:plumbline $modeldir
[ -e $modeldir/model.toml ] || runuser -u plumbline -- sh -c "echo genuine > $modeldir/model.toml"
before=$(sha256sum $modeldir/model.toml)
for attempt in "echo forged > $modeldir/model.toml" "echo forged > $modeldir/forged.toml" "mv /etc/hostname $modeldir/model.toml" \
    "rm -f $modeldir/model.toml" "ln -sf /tmp/forged.toml $modeldir/model.toml" "echo forged > /etc/plumbline/model.toml" \
    "echo '[limits]' >> /etc/plumbline/daemon.toml"; do
    alice sh -c "$attempt" >/dev/null
    code=$?
    # `rm -f` of what can't be seen succeeds: what counts is what is there afterwards.
    case $attempt in rm*) code=1 ;; esac
    check "another user's \`$(printf '%s' "$attempt" | sed "s|$modeldir|MODELS|" | cut -c 1-44)\` fails" "exit $code" \
        test $code != 0 -a "$(sha256sum $modeldir/model.toml)" = "$before"
done
opened=0 objects=0
for object in /dev/shm/plumbline_"${uid}"_* $(find /run/plumbline 2>/dev/null); do
    objects=$((objects + 1))
    # Opening for writing, and for directories the making of a name. What has gone since it was listed is not made anew, as everybody may.
    if [ -d "$object" ]; then alice sh -c ": > $object/forged" >/dev/null; else alice dd if=/dev/null of="$object" conv=nocreat,notrunc status=none >/dev/null; fi && opened=$((opened + 1))
done
check "another user opens nothing of the daemon's for writing" "$opened of $objects objects" test $opened = 0 -a $objects -gt 6
if [ -x ./forger ]; then
    said=$(alice ./forger /run/plumbline plumbline_"${uid}"_ panda); code=$?
    check "a forger of another user reaches no service" "exit $code, $(grep -c refused <<<"$said") of 3 refused" test $code = 1
    # A folder of names of the stranger's own, and the daemon's prefix: the segments themselves are met then.
    runuser -u alice -- mkdir -p /tmp/alice
    said=$(alice ./forger /tmp/alice plumbline_"${uid}"_ panda); code=$?
    rival=$(grep -c '^rival: LET IN' <<<"$said")
    check "nor with names of its own" "$(grep -c refused <<<"$said") of 3 refused, $rival rival apart from it" test "$(grep -cE '^(model|feed-forward): LET IN' <<<"$said")" = 0
    find /dev/shm -maxdepth 1 -user alice -delete
    said=$(runuser -u plumbline -- ./forger /run/plumbline plumbline_"${uid}"_ panda 2>&1); code=$?
    check "the same forger as the daemon's own user is let in: it is a real one" "$(grep -m 1 'LET IN' <<<"$said" | cut -c 1-60)" test $code = 0
else
    row SKIPPED "a forger at the services" "forger is not built: cargo build --example forger"
fi
# A daemon of the stranger's own for the same robot, in a place of its own: nobody else ever hears of it.
genuine=$(field epoch)
[ -d /tmp/alice-out ] && chown -R alice: /tmp/alice-out
(cd /tmp && exec runuser -u alice -- env PLUMBLINE_RUNTIME_DIR=/tmp/alice-plumbline plumbline daemon /etc/plumbline/daemon.toml --out /tmp/alice-out) >/tmp/alice.log 2>&1 &
rival=$!
alice_sees() { [ -n "$(alice env PLUMBLINE_RUNTIME_DIR=/tmp/alice-plumbline plumbline command status --json | grep '"epoch"')" ]; }
up=$(within 60000 alice_sees)
check "a rival daemon of another user changes nothing for the operator" "it was up after $up ms; same start of the genuine one" \
    test -n "$genuine" -a "$(field epoch)" = "$genuine"
runuser -u alice -- env PLUMBLINE_RUNTIME_DIR=/tmp/alice-plumbline plumbline command quit >/dev/null 2>&1
wait $rival 2>/dev/null

# Squatting: files of the daemon's names in shared memory before it starts, plain and as a link.
systemctl stop plumbline-estimator plumbline
for kind in file link; do
    squat=/dev/shm/plumbline_${uid}_squat
    [ $kind = file ] && alice sh -c "echo x > $squat; chmod 666 $squat"
    [ $kind = link ] && alice ln -s /etc/shadow $squat
    mark
    systemctl start --no-block plumbline
    refused=$(within 5000 journal_says "$squat belongs to user $(id -u alice)")
    check "a squatter's $kind in shared memory is refused by name" "after $refused ms, $(systemctl is-active plumbline)" \
        journal_says "$squat belongs to user $(id -u alice)"
    check "and nothing of the squatter's was followed or changed" "" test -e $squat -o -L $squat
    rm -f $squat
    recovered=$(within 8000 answers)
    check "without it the daemon comes up by itself" "after $recovered ms" answers
    systemctl stop plumbline
done
# A model file that somebody else made or can change is not taken, whoever asks for it; root's and the daemon's own are.
take() { # FILE: the daemon's own words
    runuser -u plumbline -- env PLUMBLINE_RUNTIME_DIR=/run/plumbline timeout 60 plumbline daemon /etc/plumbline/daemon.toml --model "$1" --out $modeldir 2>&1 &
    local taker=$!
    # One that takes it goes on until it is told.
    within 30000 sh -c "! kill -0 $taker 2>/dev/null || [ -n \"\$(runuser -u plumbline -- env PLUMBLINE_RUNTIME_DIR=/run/plumbline plumbline command status 2>/dev/null)\" ]" >/dev/null
    operator command quit >/dev/null 2>&1
    wait $taker
}
if [ -f ./model.toml ]; then
    mkdir -p /srv/models && chmod 755 /srv/models
    install -m 644 ./model.toml /srv/models/root.toml
    install -m 600 -o plumbline ./model.toml /srv/models/own.toml
    install -m 644 -o alice ./model.toml /srv/models/alice.toml
    install -m 664 -o plumbline -g alice ./model.toml /srv/models/group.toml
    for file in alice:"belongs to user $(id -u alice) (owner $(id -u alice), group 0, mode 644)" group:"others can write to (owner $uid, group $(id -g alice), mode 664)"; do
        name=/srv/models/${file%%:*}.toml
        said=$(take "$name"); code=$?
        check "a model file that ${file#*:} is refused" "exit $code" grep -qF "$name that ${file#*:}" <<<"$said"
        [ $code = 2 ] || row FAILED "and it is bad input, exit code 2" "exit $code"
    done
    for name in root own; do
        said=$(take /srv/models/$name.toml); code=$?
        check "the same model as $name's file is taken" "exit $code" grep -q 'is served from now on' <<<"$said"
    done
fi
# The folder of names laid out by a stranger where a person without the service would have it.
alice sh -c 'mkdir -p /tmp/plumbline-65533; chmod 777 /tmp/plumbline-65533' >/dev/null
said=$(setpriv --reuid=65533 --regid=65533 --clear-groups plumbline command status 2>&1)
check "a folder that a stranger prepared is refused" "$(printf '%s' "$said" | cut -c 1-70)..." grep -q "belongs to user $(id -u alice)" <<<"$said"
systemctl start plumbline plumbline-estimator
within 5000 answers >/dev/null
