# What hil/inclinometer/vm.sh runs inside: the inclinometer is tilted, silenced, restarted, and its bus breaks; what plumbline says of it is
# printed with its own time. The numbers in docs/results/campaigns.md come from here.

failed=0
said() { # WHAT PATTERN FILE
    if grep -q "$2" "$3"; then echo "held: $1"; else echo "NOT HELD: $1 (no '$2')"; failed=1; fi
}
uname -srv
cat /sys/kernel/realtime 2>/dev/null | sed 's/^/realtime: /'
mkfifo /tmp/orders
sim-inclinometer --interface vcan0 --tilt 1.5,-0.5 --noise 0.05 < /tmp/orders 2> /tmp/simulator &
exec 3> /tmp/orders
sleep 1

echo "--- a single reading"
plumbline inclinometer daemon-inclinometer.toml --set inclinometer.interface=vcan0 | tee /tmp/once
said "the tilt is read: sqrt(1.5^2 + 0.5^2) = 1.58 deg off" "1\.[56][0-9]* +- .* off the declared" /tmp/once

echo "--- watching: every fault in turn"
plumbline inclinometer daemon-inclinometer.toml --set inclinometer.interface=vcan0 --watch --rate 20 > /tmp/watch 2> /tmp/log &
watch=$!
order() { echo "$1" >&3; sleep "$2"; }
sleep 6
order "tilt 4 -0.5 1" 4
order "no-slopes" 2
order "well" 5
order "no-heartbeat" 2
order "well" 5
order "reset" 5
order "emergency 5000" 2
order "emergency 0" 5
order "tilt 12 -0.5" 1
order "tilt 4 -0.5 2" 6
# Ten heartbeats are counted to find it, and ten more until the device is believed again.
order "twin" 5
order "well" 8
order "error-passive" 1
order "error-active" 5
order "bus-off" 1
order "error-active" 5
ip link set vcan0 down
sleep 2
ip link set vcan0 up
sleep 6
kill $watch
# Lines where something else is said than before.
awk '{ said = $0; sub(/^ *[0-9.]+ s  /, "", said); gsub(/[0-9.]+/, "#", said); if (said != last) print; last = said }' /tmp/watch
echo "--- log"
cat /tmp/log /tmp/simulator
said "slopes lost" "no slopes from the inclinometer for" /tmp/log
said "heartbeat lost" "no heartbeat of the inclinometer for" /tmp/log
said "restart noticed" "has restarted" /tmp/log
said "emergency" "emergency 5000h" /tmp/log
said "jump of 8 deg" "has jumped by" /tmp/log
said "two senders" "another node have the same id" /tmp/log
said "error-passive" "error-passive" /tmp/log
said "bus-off" "bus-off" /tmp/log
said "interface down" "interface is down" /tmp/log
tail -n 1 /tmp/watch > /tmp/last
said "good again at the end" "off the declared mounting" /tmp/last
exit $failed
