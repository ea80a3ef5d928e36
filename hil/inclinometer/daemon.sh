# What `hil/inclinometer/vm.sh BINARIES daemon.sh` runs inside: the daemon serves a model while the base tilts, tilts too far, and loses its
# inclinometer. The arm is the simulated Panda, upright whatever the base does: what is shown is what the daemon makes of the sensor.
#
# An emulated processor is about twenty times slower than a real one: without real-time priority, which would leave nothing to the thread
# that listens to the sensor, and with the lowest rate of slopes.

failed=0
held() { # WHAT PATTERN
    if echo "$status" | tr -d ' \n' | grep -q "$2"; then echo "held: $1"; else echo "NOT HELD: $1 (no '$2')"; failed=1; fi
}
mkfifo /tmp/orders
sim-inclinometer --interface vcan0 --tilt 1,0 --noise 0.05 < /tmp/orders 2> /tmp/simulator &
exec 3> /tmp/orders
PLUMBLINE_LOG=info plumbline daemon daemon-inclinometer.toml --set inclinometer.interface=vcan0 --set safety.max-lost=1000 \
    --set realtime.priority=0 --set "inclinometer.rate=10 Hz" --set "inclinometer.heartbeat=1 s" --set excitation.starts=1 --set excitation.rounds=0 --model models/panda-paper-table3.toml --out /tmp/out > /tmp/daemon 2>&1 &
look() { # SECONDS
    sleep "$1"
    status=$(plumbline command status --json)
    echo "$status" | tr -d ' \n' | sed -n 's/.*"mounting":{\([^}]*\)},"gravity":{"source":"\([a-z]*\)","inclinometer":"\([^"]*\)".*"torques":\([^]]*\]\|null\),"refused":\("[^"]*"\|null\).*/    \1 | \2 | \3 | torques \4 | refused \5/p'
}
served() { plumbline torque --follow --rate 20 --count 3 | tail -n 1; }
for _ in $(seq 60); do plumbline command status > /dev/null 2>&1 && break; sleep 2; done

echo "--- base at 1 deg"
look 8; served
held "the measured direction is served" '"source":"measured"'
held "nothing speaks against it" '"refused":null'
before=$(plumbline torque --follow --rate 20 --count 3 | tail -n 1)
echo "--- tilts to 4 deg in a second: the model follows at 1 deg/s"
echo "tilt 4 0 1" >&3
look 2; look 2; look 4; served
held "still measured" '"source":"measured"'
held "within tolerance" '"refused":null'
after=$(plumbline torque --follow --rate 20 --count 3 | tail -n 1)
[ "${before#*tau_ff}" != "${after#*tau_ff}" ] && echo "held: the torque follows" || { echo "NOT HELD: the torque follows"; failed=1; }
echo "--- tilts to 10 deg: beyond the tolerance"
echo "tilt 10 0 3" >&3
look 8; served
held "refused for the tilt" 'theinclinometersays'
echo "--- back to 1 deg"
echo "tilt 1 0 3" >&3
look 14; served
held "served again" '"refused":null'
echo "--- unplugged"
echo "unplug" >&3
look 4; served
held "refused for the loss" 'on-loss='
echo "well" >&3
look 10
held "served again" '"refused":null'
plumbline command quit
sleep 2
echo "--- log"
cat /tmp/daemon
exit $failed
