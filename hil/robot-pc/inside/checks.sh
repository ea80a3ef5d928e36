#!/bin/bash
# What is tried inside the virtual robot PC, with the package's own units under its own systemd. Run as root by checks.service.
#
# checks.sh runs one part after the other, each in a process of its own and for a limited time; checks.sh PART is one of them.
cd "$(dirname "$0")" && . ./common.sh
QUICK=${QUICK:-1}
SEED=${SEED:-1}
ROUNDS=${ROUNDS:-3}
# The parts, one after the other: by name on the kernel's command line where several machines share them, else all that this form has.
PARTS=$(sed -n 's/.*robot-pc=\([a-z_,]*\).*/\1/p' /proc/cmdline | tr , ' ')
[ "$QUICK" = 1 ] && PARTS="install start strangers fci move kill hang upgrade limits leave"
PARTS=${PARTS:-install start kernel_and_can tilt fci move kill hang upgrade limits leave}
# How long each may take [s].
declare -A LIMITS=([install]=60 [start]=60 [strangers]=300 [kernel_and_can]=30 [tilt]=120 [fci]=240 [move]=60 [kill]=$((60 * ROUNDS))
    [hang]=90 [upgrade]=30 [limits]=30 [leave]=60)
# All parts together [s]; the table has its last line in any case.
TOTAL=${TOTAL:-540}
RANDOM=$SEED

part_install() {
    dpkg -i /robot-pc/plumbline.deb >/tmp/install.log 2>&1
    check "the package installs" "exit $?" test -x /usr/bin/plumbline
    check "installing starts and enables nothing" "$(systemctl is-active plumbline) $(systemctl is-enabled plumbline 2>/dev/null)" \
        test "$(systemctl is-active plumbline)$(systemctl is-enabled plumbline 2>/dev/null)" = inactivedisabled
    said=$(systemd-analyze verify plumbline.service plumbline-estimator.service plumbline-relay@panda.service 2>&1 | grep -i plumbline)
    check "systemd-analyze verify is silent" "${said:-nothing said}" test -z "$said"
    for unit in plumbline plumbline-estimator plumbline-relay@panda; do
        exposure=$(systemd-analyze security --no-pager --threshold=25 $unit.service 2>&1); good=$?
        check "systemd-analyze security of $unit, at most 2.5" "$(printf '%s' "$exposure" | sed -n 's/.*service: \([0-9.]*\).*/\1/p')" test $good = 0
    done

    # A short programme, so that the checks end within a minute; planned on the host where this machine is slow.
    cat ./short.toml >>/etc/plumbline/daemon.toml
    # The checks share their processors with whatever runs beside them; a stall of theirs is not what is tried here.
    sed -i '/^\[safety\]/a max-lost = 1000' /etc/plumbline/daemon.toml
    # A simulated arm that is integrated in fewer steps, where one is here.
    [ -f ./arm.toml ] && install -m 644 ./arm.toml /etc/plumbline/arm.toml && sed -i 's|^arm = .*|arm = "/etc/plumbline/arm.toml"|' /etc/plumbline/daemon.toml
    cp /etc/plumbline/daemon.toml /tmp/daemon.toml.before
    [ -d /robot-pc/results ] && cp -r /robot-pc/results /tmp/alice-out
    for planned in results job job2; do
        [ -d /robot-pc/$planned ] && cp -r /robot-pc/$planned /var/lib/plumbline/ && chown -R plumbline:plumbline /var/lib/plumbline/$planned
    done
}

part_start() {
    # The units take limits, no capabilities. A container on a machine that lets nobody raise a limit gets the two capabilities instead.
    expected=0000000000000000
    if ! (ulimit -r 90) 2>/dev/null; then
        say "this machine lets nobody raise the real-time limits: CAP_SYS_NICE and CAP_IPC_LOCK by drop-in instead"
        mkdir -p /etc/systemd/system/plumbline.service.d
        printf '[Service]\nCapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK\nAmbientCapabilities=CAP_SYS_NICE CAP_IPC_LOCK\n' \
            >/etc/systemd/system/plumbline.service.d/robot-pc.conf
        systemctl daemon-reload
        expected=0000000000804000
    fi
    begin=$(ms)
    systemctl start plumbline plumbline-estimator; started=$?
    check "daemon and estimator start, Type=notify" "$(($(ms) - begin)) ms" test $started = 0
    took=$(within 5000 is phase hold)
    check "the daemon answers its operator" "$(field robot), after $took ms" answers
    daemon=$(pid_of plumbline)
    caps=$(sed -n 's/^CapEff:\t//p' "/proc/$daemon/status")
    check "it runs as plumbline, without a capability that it was not given" "$(ps -o user= -p "$daemon") $caps" \
        test "$(ps -o user= -p "$daemon")$caps" = plumbline$expected
    check "seccomp and no-new-privileges are on" "$(grep -E 'Seccomp:|NoNewPrivs' "/proc/$daemon/status" | tr '\n\t' '  ')" \
        test "$(sed -n 's/^Seccomp:\t//p' "/proc/$daemon/status")" = 2
    loop=$(loop_of "$daemon")
    policy=$(chrt -p "$loop" 2>&1 | tr '\n' ' ' | sed "s/pid $loop's current //g")
    check "the loop runs under SCHED_FIFO 80" "$policy" grep -q 'FIFO.*80' <<<"$policy"
    locked=$(sed -n 's/^VmLck:[ \t]*//p' "/proc/$daemon/status")
    check "its memory is locked" "$locked" test "${locked%% *}" -gt 1000
    begin=$(ms); before=$(field cycles); sleep 1; after=$(field cycles); took=$(($(ms) - begin))
    check "the loop turns while it holds" "$((after - before)) cycles in $took ms" test $((after - before)) -gt 0
    check "at no less than half of 1 kHz" "$(((after - before) * 1000 / took)) Hz" test $(((after - before) * 2)) -gt $took
    check "it holds and moves nothing before a start" "phase, progress, motion: $(fields phase progress motion)" holds
    event=$(journalctl -u plumbline --no-pager -o json PLUMBLINE_ROBOT=panda | wc -l)
    check "the journal has structured fields" "$event lines with PLUMBLINE_ROBOT" test "$event" -gt 0
}

part_strangers() { . ./strangers.sh; }
part_kernel_and_can() { . ./can.sh; }
part_tilt() { . ./tilt.sh; }
part_fci() { . ./fci.sh; }

part_move() {
    check "an operator's start moves the arm" "$(operator command start 2>&1)" within 20000 is progress driving >/dev/null
    moved=$(within 20000 is phase excite)
    check "motion under way" "after $moved ms" is phase excite
    old=$(pid_of plumbline)
    dpkg -i /robot-pc/plumbline.deb >/tmp/upgrade.log 2>&1
    check "an upgrade leaves a moving arm alone, and says so" "$(grep -c 'NOT restarted' /tmp/upgrade.log) note, same process" \
        test "$(pid_of plumbline)" = "$old" -a "$(grep -c 'NOT restarted' /tmp/upgrade.log)" = 1
}

part_kill() { . ./kills.sh; }

# A loop that hangs: one thread of it, while all others run.
part_hang() {
    systemctl reset-failed
    daemon=$(pid_of plumbline)
    mark
    perl ./freeze_thread.pl "$(loop_of "$daemon")" $((60 * PATIENCE)) >/tmp/freeze.log 2>&1 &
    freezer=$!
    hung=$(within 40000 other_pid plumbline "$daemon")
    check "a hung loop is ended by the watchdog, WatchdogSec=10" "new process after $hung ms" test "$hung" -gt 5000 -a "$hung" -lt $((40000 * PATIENCE))
    kill $freezer 2>/dev/null; wait $freezer 2>/dev/null
    check "the watchdog is named in the journal" "$(journal | grep -i -m 1 watchdog)" journal_says "Failed with result 'watchdog'"
    within 5000 holds >/dev/null
    check "after the watchdog the arm holds" "phase, progress, motion: $(fields phase progress motion)" holds
}

part_upgrade() {
    old=$(pid_of plumbline)
    dpkg -i /robot-pc/plumbline.deb >/tmp/upgrade.log 2>&1
    upgraded=$(within 5000 up_again "$old")
    check "an upgrade at rest restarts the services" "up after $upgraded ms" up_again "$old"
}

# A configuration that anybody may change.
part_limits() {
    failed() { [ "$(systemctl is-active plumbline)" = failed ]; }
    chmod 0666 /etc/plumbline/daemon.toml
    mark
    systemctl restart plumbline 2>/dev/null
    within 5000 failed >/dev/null
    sleep 1.5
    result=$(systemctl show --property=ExecMainStatus --value plumbline)
    check "limits that others can change are refused, once" "exit $result, $(systemctl is-active plumbline)" \
        test "$result$(systemctl is-active plumbline)" = 2failed
    check "and the refusal names file and mode" "mode 666" journal_says "/etc/plumbline/daemon.toml that others can write to (mode 666)"
    chmod 0644 /etc/plumbline/daemon.toml
    systemctl restart plumbline
}

part_leave() {
    within 5000 answers >/dev/null
    operator command start >/dev/null
    within 20000 is phase excite >/dev/null
    mark
    begin=$(ms)
    dpkg --remove plumbline >/tmp/remove.log 2>&1; removed=$?
    check "removal brakes the arm and ends the services" "exit $removed, $(($(ms) - begin)) ms" journal_says "the arm is being stopped: signal SIGTERM arrived"
    check "removal leaves results and configuration" "" test -d /var/lib/plumbline -a -f /etc/plumbline/daemon.toml
    uid=$(id -u plumbline)
    dpkg --purge plumbline >/tmp/purge.log 2>&1
    left=$(find /etc/plumbline /var/lib/plumbline /run/plumbline /dev/shm/plumbline_"$uid"_* /usr/lib/systemd/system/plumbline* 2>/dev/null | tr '\n' ' ')
    check "a purge leaves nothing" "${left:-no file}, user $(id -u plumbline 2>/dev/null || echo gone)" test -z "$left"
    MARK=
    sessions=$(journal | grep -c '^session `.* periods')
    check "every millisecond of every session was a cycle or counted as skipped" "$sessions sessions, skipped in them: $(
        journal | sed -n 's/^session .* + \([0-9]*\) skipped.*/\1/p' | tr '\n' ' ')" \
        test "$sessions" -gt 0 -a "$(journal | grep -c 'periods DIFFERS FROM')" = 0
}

# What a part that was cut off may leave behind.
in_order() {
    # Its own processes ended with it; what it did to the machine stays.
    rm -f /etc/systemd/system/plumbline.service.d/tilt.conf
    [ -f /etc/plumbline/daemon.toml ] && install -m 644 /tmp/daemon.toml.before /etc/plumbline/daemon.toml
    ip netns delete robot 2>/dev/null
    systemctl daemon-reload
    systemctl reset-failed
    timeout 60 systemctl restart plumbline plumbline-estimator
    within 5000 answers >/dev/null
}

# part NAME SECONDS: for so long at most, times PATIENCE.
part() {
    local begin=$SECONDS limit=$(($2 * PATIENCE)) left=$((TOTAL - SECONDS))
    if [ $left -lt 20 ]; then row FAILED "part \`$1\`" "not begun: $TOTAL s are over"; return; fi
    timeout --kill-after=5 $((limit < left ? limit : left)) /bin/bash ./checks.sh "$1"
    local code=$?
    LAST=$(ms)
    if [ $code = 124 ] || [ $code = 137 ]; then
        row FAILED "part \`$1\` runs to its end" "cut off after $((SECONDS - begin)) s"
        in_order
    fi
}

if [ $# = 1 ]; then
    "part_$1"
    exit 0
fi

say "seed $SEED, kernel $(uname -r)"
begin=$(ms)
for _ in {1..20}; do /bin/true; done
say "robot-pc: up after $(cut -d ' ' -f 1 /proc/uptime) s, a process takes $((($(ms) - begin) / 20)) ms, limits of time are taken times $PATIENCE"
for name in $PARTS; do part "$name" "${LIMITS[$name]}"; done
# Another local user, or what needs the real-time kernel and CAN: an emulated processor has not the time for both.
if [ "$QUICK" = 1 ]; then
    not_shown "CAN, and a tilting base" "hil/robot-pc/full.sh"
elif [[ " $PARTS " = *" tilt "* ]]; then
    not_shown "another local user's attempts" "hil/robot-pc/quick.sh"
    not_shown "latency under load, and any figure of time" "another machine's clock and caches: plumbline doctor on the robot's PC"
fi

cp /tmp/*.log /var/lib/robot-pc/ 2>/dev/null
say "robot-pc: $(grep -c ^HELD "$TABLE") held, $(grep -c ^FAILED "$TABLE") failed, $(grep -c '^NOT SHOWN' "$TABLE") not shown here, in $SECONDS s"
say "robot-pc: end"
