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
# Where others use the processor, too, the robot's time stands still for up to a fifth of a second while it waits for a command. Else it waits as a robot
# does: not at all; and has the first turn on the processor, for a control unit has one of its own.
settings=() first=(chrt --fifo 85)
[ "$QUICK" = 1 ] && settings+=(--command-wait 200) && first=()
[ -f ./arm.toml ] && settings+=(--arm ./arm.toml)
"${first[@]}" ip netns exec robot ./fci-emulator --address 172.16.0.2 --protocol 5 --robot panda --mounting wall "${settings[@]}" >/tmp/emulator.log 2>&1 &
emulator=$!
serves() { ip netns exec robot ss -Hltn | grep -q ':1337'; }
within 3000 serves >/dev/null
begin=$(ms)
. ./fci-job.sh
job() { # FOLDER PERIODS
    mapfile -t arguments < <(fci_job "$2")
    (cd /var/lib/plumbline && runuser -u plumbline -- env PLUMBLINE_RUNTIME_DIR=/run/plumbline plumbline run --verbose \
        /usr/share/plumbline/config/panda-emulator-wall.toml --out "/var/lib/plumbline/$1" "${arguments[@]}") >"/tmp/$1.log" 2>&1
}
job job 2
code=$?
check "the main job over FCI, to its end" "exit $code, $(($(ms) - begin)) ms: $(grep -m 1 'RMS wall' /tmp/job.log)" test $code = 0
[ $code = 0 ] || say "$(tail -n 5 /tmp/job.log)"
say "$(grep -o 'session `.*allocations' /tmp/job.log)"
check "model and report are there, the daemon's user's own" "$(stat -c '%U %a %n' /var/lib/plumbline/job/{report.json,model.toml} 2>&1 | head -n 2 | tr '\n' ' ')" \
    test -s /var/lib/plumbline/job/report.json -a -s /var/lib/plumbline/job/model.toml
check "every millisecond of the robot was a cycle or counted as skipped" "$(grep -c 'periods = ' /tmp/job.log) sessions" \
    test "$(grep -c 'periods = ' /tmp/job.log)" -gt 0 -a "$(grep -c 'periods DIFFERS FROM' /tmp/job.log)" = 0
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
