# What needs the real-time kernel and CAN: sourced by checks.sh in the full form.
check "the kernel is PREEMPT_RT" "$(uname -v | grep -o PREEMPT_RT), /sys/kernel/realtime $(cat /sys/kernel/realtime 2>/dev/null)" \
    test "$(cat /sys/kernel/realtime 2>/dev/null)" = 1
check "and the daemon knows it" "no complaint about the kernel" test "$(journalctl -u plumbline --no-pager -o cat | grep -ci 'preempt_rt')" = 0

# --- CAN: a virtual bus, used from inside the unit's own sandbox
modprobe vcan; modprobe can-raw
ip link add can0 type vcan && ip link set can0 up
sandbox() {
    # Type, program and limits aside, what plumbline.service says.
    local args=()
    while IFS= read -r line; do args+=(-p "$line"); done < <(sed -n '/^CapabilityBoundingSet/,/^IPAddressAllow/{/^#/d;/=/p}' /usr/lib/systemd/system/plumbline.service)
    systemd-run --quiet --wait --pipe -p User=plumbline "${args[@]}" "$@"
}
timeout 10 candump -n 1 can0 >/tmp/candump.log &
listener=$!
sleep 1
sandbox cansend can0 18A#0100020003000400; wait $listener
check "CAN reaches the bus from inside the unit's sandbox" "$(cat /tmp/candump.log)" grep -q '18A' /tmp/candump.log

# --- the base tilts
if [ -x ./sim-inclinometer ]; then . ./tilt.sh; else row SKIPPED "the base tilts by CAN" "sim-inclinometer is not built"; fi

# --- the main job over FCI, against the emulator on a second virtual host
systemctl stop plumbline-estimator plumbline
ip netns add robot
ip link add robot0 type veth peer name eth0 netns robot
ip address add 172.16.0.1/24 dev robot0; ip link set robot0 up
ip -n robot address add 172.16.0.2/24 dev eth0; ip -n robot link set eth0 up; ip -n robot link set lo up
ip netns exec robot /robot-pc/fci-emulator --address 172.16.0.2 --protocol 5 --robot panda --mounting wall >/tmp/emulator.log 2>&1 &
emulator=$!
sleep 3
begin=$(ms)
. ./fci-job.sh
job() { # FOLDER PERIODS
    mapfile -t arguments < <(fci_job "$2")
    (cd /var/lib/plumbline && operator run /usr/share/plumbline/config/panda-emulator-wall.toml --out "/var/lib/plumbline/$1" "${arguments[@]}") >"/tmp/$1.log" 2>&1
}
job job 3
code=$?
check "the main job over FCI" "exit $code, $(($(ms) - begin)) ms: $(grep -m 1 'RMS wall' /tmp/job.log)" test $code = 0
[ $code = 0 ] || tail -n 5 /tmp/job.log >/dev/console
# The emulator dies in mid-motion: the daemon's own word for it, and an end.
job job2 50 &
run=$!
within 60000 is phase excite >/dev/null
kill -KILL $emulator
wait $run; code=$?
check "the robot dies in mid-motion: the job ends and says so" "exit $code: $(tail -n 1 /tmp/job2.log | cut -c 1-80)" test $code = 1
systemctl start plumbline plumbline-estimator
ip netns delete robot
not_shown "errors on a CAN bus: bus-off, error-passive, noise on the wire" "vcan has no controller"
not_shown "a robot's own control unit, its reflexes and its network" "the emulator stands for it: hil/rig"
within 20000 answers >/dev/null
