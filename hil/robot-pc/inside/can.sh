# The real-time kernel, and CAN: a virtual bus, used from inside the unit's own sandbox. Sourced by checks.sh in the full form.
check "the kernel is PREEMPT_RT" "$(uname -v | grep -o PREEMPT_RT), /sys/kernel/realtime $(cat /sys/kernel/realtime 2>/dev/null)" \
    test "$(cat /sys/kernel/realtime 2>/dev/null)" = 1
check "and the daemon knows it" "no complaint about the kernel" test "$(journalctl -u plumbline --no-pager -o cat | grep -ci 'preempt_rt')" = 0

modprobe vcan; modprobe can-raw
ip link add can0 type vcan && ip link set can0 up
sandbox() {
    # Type, program and limits aside, what plumbline.service says.
    local args=() line address
    while IFS= read -r line; do
        # systemd-run takes one address a time.
        if [[ $line == IPAddressAllow=* ]]; then for address in ${line#*=}; do args+=(-p "IPAddressAllow=$address"); done; else args+=(-p "$line"); fi
    done < <(sed -n '/^CapabilityBoundingSet/,/^IPAddressAllow/{/^#/d;/=/p}' /usr/lib/systemd/system/plumbline.service)
    systemd-run --quiet --wait --pipe -p User=plumbline "${args[@]}" "$@"
}
listens() { grep -q '^ *can0 ' /proc/net/can/rcvlist_all; }
timeout $((10 * PATIENCE)) candump -n 1 can0 >/tmp/candump.log &
listener=$!
within 5000 listens >/dev/null
sandbox cansend can0 18A#0100020003000400; wait $listener
check "CAN reaches the bus from inside the unit's sandbox" "$(cat /tmp/candump.log)" grep -q '18A' /tmp/candump.log
not_shown "errors on a CAN bus: bus-off, error-passive, noise on the wire" "vcan has no controller"
