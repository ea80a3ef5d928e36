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
alice cat /dev/shm/plumbline_"${uid}"_* >/tmp/stolen 2>/dev/null
check "nor a byte of any segment" "$(grep -vc 'Permission denied' /tmp/stolen) read of $all" test "$(grep -vc 'Permission denied' /tmp/stolen)" = 0
alice sh -c ': > /run/plumbline/panda.lock' >/dev/null
check "nor touches the lock" "process $(sed -n 's/process //p' /run/plumbline/panda.lock)" grep -q "$(pid_of plumbline)" /run/plumbline/panda.lock

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
# The folder of names laid out by a stranger where a person without the service would have it.
alice sh -c 'mkdir -p /tmp/plumbline-65533; chmod 777 /tmp/plumbline-65533' >/dev/null
said=$(setpriv --reuid=65533 --regid=65533 --clear-groups plumbline command status 2>&1)
check "a folder that a stranger prepared is refused" "$(printf '%s' "$said" | cut -c 1-70)..." grep -q "belongs to user $(id -u alice)" <<<"$said"
systemctl start plumbline plumbline-estimator
within 5000 answers >/dev/null
