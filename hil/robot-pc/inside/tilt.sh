# The base tilts, its inclinometer is lost and comes back: the real unit in its own sandbox, SocketCAN on a virtual bus, a simulated device after
# CiA 410 and the simulated arm, which stands upright whatever the base does. Sourced by checks.sh; can0 is there.
systemctl stop plumbline-estimator plumbline
cat ./inclinometer.toml >>/etc/plumbline/daemon.toml
install -m 644 ./model.toml /etc/plumbline/model.toml
mkdir -p /etc/systemd/system/plumbline.service.d
printf '[Service]\nExecStart=\nExecStart=/usr/bin/plumbline daemon --root-owned --model /etc/plumbline/model.toml /etc/plumbline/daemon.toml\n' \
    >/etc/systemd/system/plumbline.service.d/tilt.conf
systemctl daemon-reload
rm -f /tmp/orders
mkfifo /tmp/orders
device() { # TILT: the device, with its orders on descriptor 3
    ./sim-inclinometer --interface can0 --tilt "$1" --noise 0.05 </tmp/orders 2>>/tmp/simulator.log &
    simulator=$!
    exec 3>/tmp/orders
}
# Degrees between the gravity that the model has and upright.
tilt() { status | awk '/"rho":/ {gsub(/[^0-9.]/, "", $2); printf "%.2f", 180 - $2 * 57.29578; exit}'; }
near() { awk -v is="$(tilt)" -v want="$1" 'BEGIN {exit !(is > want - 0.25 && is < want + 0.25)}'; }
refused() { local why; why=$(field refused); [ "${why:-null}" != null ]; }
good() { [ "$(fields refused source)" = "null measured" ]; }
# A value that is old by the time that it is read says `STALE` instead of `NO MODEL`: what counts is whose torque it is.
serves() { operator torque | grep -q 'model [0-9a-f]*[1-9a-f][0-9a-f]* '; }
serves_not() { operator torque | grep -q 'model 0* '; }
torque() { operator torque | sed 's/.*tau_ff//'; }
why() { field refused | cut -c 1-90; }

mark
device 1,0
systemctl start plumbline
took=$(within 20000 good)
check "the unit hears the inclinometer on can0 from its sandbox" "after $took ms: $(field inclinometer)" good
took=$(within 10000 near 1)
check "a base at 1 deg: the model has the measured gravity" "$(tilt) deg after $took ms" near 1
within 5000 serves >/dev/null
check "and is served" "$(operator torque | cut -c 1-60)" serves
before=$(torque)
echo "tilt 4 0 1" >&3
took=$(within 15000 near 4)
check "the base tilts to 4 deg in a second: the model follows at 1 deg/s" "$(tilt) deg after $took ms" test "$took" -gt 2000 -a "$took" -lt $((10000 * PATIENCE))
after=$(torque)
check "and its torque with it" "$(printf '%s' "$before" | cut -c 1-32) ->$(printf '%s' "$after" | cut -c 1-32)" test "$before" != "$after"
echo "tilt 10 0 3" >&3
# While it tilts, three sides may disagree in other ways.
by_angle() { grep -q 'deg off the declared' <<<"$(field refused)"; }
took=$(within 15000 by_angle)
check "10 deg are beyond the tolerance: refused, by angle" "after $took ms: $(why)" by_angle
within 5000 serves_not >/dev/null
check "and the model is withdrawn" "$(operator torque | grep -oE 'NO MODEL|STALE')" serves_not
echo "tilt 1 0 3" >&3
took=$(within 20000 good)
check "back at 1 deg it is served again" "after $took ms" good
for fault in unplug no-heartbeat no-slopes; do
    echo $fault >&3
    took=$(within 10000 refused)
    check "$fault: refused for the loss, as the job wants" "after $took ms: $(why)" grep -q 'on-loss' <<<"$(status | grep '"refused"')"
    echo well >&3
    took=$(within 15000 good)
    check "and served again when it is well" "after $took ms" good
done
ip link set can0 down
took=$(within 10000 refused)
check "the CAN interface goes down: refused" "after $took ms: $(why)" refused
ip link set can0 up
took=$(within 15000 good)
check "and served again when it is up" "after $took ms" good
kill -KILL $simulator; exec 3>&-; wait $simulator 2>/dev/null
took=$(within 10000 refused)
check "the device dies: refused" "after $took ms: $(why)" refused
device 2,0
took=$(within 20000 good)
check "another one in its place: brought up and served" "after $took ms, lost $(field losses) times, $(field lost_s) s in all" good
check "every loss is in the daemon's status and journal" "$(field losses) losses" test "$(field losses)" -ge 5 -a "$(journal | grep -c 'the inclinometer is lost')" -ge 5
check "with it an operator's start moves the arm" "$(operator command start 2>&1)" within 20000 is progress driving >/dev/null
took=$(within 20000 is phase excite)
check "motion under way" "after $took ms: $(fields phase progress motion stopped)" is phase excite
echo unplug >&3
took=$(within 10000 is progress stopped)
check "lost in mid-motion: the arm is braked" "after $took ms: $(field stopped | cut -c 1-80)" is progress stopped
echo quit >&3
exec 3>&-
systemctl stop plumbline
rm /etc/systemd/system/plumbline.service.d/tilt.conf
systemctl daemon-reload
install -m 644 /tmp/daemon.toml.before /etc/plumbline/daemon.toml
systemctl start plumbline plumbline-estimator
within 20000 answers >/dev/null
