# The main job over FCI, against the emulator on a second virtual host. Sourced by checks.sh.
if [ ! -x ./fci-emulator ]; then
    row SKIPPED "the main job over FCI" "fci-emulator is not built: cargo build --example fci-emulator"
    return
fi
systemctl stop plumbline-estimator plumbline
ip netns add robot
ip link add robot0 type veth peer name eth0 netns robot
ip address add 172.16.0.1/24 dev robot0; ip link set robot0 up
ip -n robot address add 172.16.0.2/24 dev eth0; ip -n robot link set eth0 up; ip -n robot link set lo up
# The robot's time stands still while it waits for a command: for a fifth of a second on a machine that others use, too, and for as long as it takes
# where a millisecond takes longer than a millisecond. Then nobody gives up on the other, either.
slow_robot=(--patience 200) slow_job=()
if [ "$PATIENCE" != 1 ]; then
    slow_robot=(--patience 2000 --arm /robot-pc/arm.toml)
    slow_job=(--set "backend.franka.state-timeout=5 s" --set "backend.franka.connect-timeout=60 s")
fi
ip netns exec robot /robot-pc/fci-emulator --address 172.16.0.2 --protocol 5 --robot panda --mounting wall "${slow_robot[@]}" >/tmp/emulator.log 2>&1 &
emulator=$!
serves() { ip netns exec robot ss -Hltn | grep -q ':1337'; }
within 3000 serves >/dev/null
begin=$(ms)
. ./fci-job.sh
job() { # FOLDER PERIODS
    mapfile -t arguments < <(fci_job "$2")
    arguments+=("${slow_job[@]}")
    (cd /var/lib/plumbline && runuser -u plumbline -- env PLUMBLINE_RUNTIME_DIR=/run/plumbline plumbline run \
        /usr/share/plumbline/config/panda-emulator-wall.toml --out "/var/lib/plumbline/$1" "${arguments[@]}") >"/tmp/$1.log" 2>&1
}
if [ "$PATIENCE" = 1 ]; then
    job job 3
    code=$?
    check "the main job over FCI, to its end" "exit $code, $(($(ms) - begin)) ms: $(grep -m 1 'RMS wall' /tmp/job.log)" test $code = 0
    [ $code = 0 ] || say "$(tail -n 5 /tmp/job.log)"
    say "$(grep -o 'session `.*allocations' /tmp/job.log)"
    check "model and report are there, the daemon's user's own" "$(stat -c '%U %a %n' /var/lib/plumbline/job/{report.json,models/*.toml} 2>&1 | head -n 2 | tr '\n' ' ')" \
        test -s /var/lib/plumbline/job/report.json
    check "every millisecond of the robot was a cycle or counted as skipped" "$(grep -c 'periods = ' /tmp/job.log) sessions" \
        test "$(grep -c 'periods = ' /tmp/job.log)" -gt 0 -a "$(grep -c 'periods DIFFERS FROM' /tmp/job.log)" = 0
else
    not_shown "the main job over FCI, to its end" "an emulated processor has not the time for 40 s of motion and an identification: README.md has the two commands for a real one"
    not_shown "FCI at 1 kHz by the clock on the wall" "the emulator's time stands still while it waits for a command"
fi
# The emulator dies in mid-motion: the daemon's own word for it, and an end.
job job2 50 &
run=$!
took=$(within 60000 is phase excite)
sleep 3
read -r phase cycles lost <<<"$(fields phase cycles lost)"
check "a job moves the arm over FCI" "$phase after $took ms, $cycles cycles, $lost skipped" test "$phase" = excite
kill -KILL $emulator
wait $run; code=$?
say "$(grep -m 1 -o 'session `wall`.*allocations' /tmp/job2.log)"
check "the robot dies in mid-motion: the job ends and says so" "exit $code: $(tail -n 1 /tmp/job2.log | cut -c 1-80)" test $code = 1
ip netns delete robot
systemctl start plumbline plumbline-estimator
not_shown "a robot's own control unit, its reflexes and its network" "the emulator stands for it: hil/rig"
within 20000 answers >/dev/null
