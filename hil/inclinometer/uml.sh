#!/bin/sh
# SocketCAN for real: boots a user-mode Linux on this machine's own files, loads vcan there, and runs the simulated inclinometer and
# plumbline on it. Needs root and Debian's packages user-mode-linux, kmod and iproute2; takes about two minutes.
#
#     cargo build --release --features sim-inclinometer --bin plumbline --bin sim-inclinometer
#     hil/inclinometer/uml.sh target/release
#
# Inside, the host's files are read through hostfs; everything is written below a temporary folder, which is printed at the end.
set -eu

here=$(cd "$(dirname "$0")/../.." && pwd)
bins=$(cd "${1:?folder of the binaries}" && pwd)
scenario=${2:-scenario.sh}
out=$(mktemp -d /tmp/plumbline-can.XXXXXX)

cat > "$out/init.sh" <<INIT
#!/bin/sh
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=$out
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /dev/shm 2>/dev/null || { mkdir -p /dev/shm; mount -t tmpfs tmpfs /dev/shm; }
mount -t tmpfs tmpfs /tmp/iceoryx2 2>/dev/null || true
modules=/usr/lib/uml/modules/\$(uname -r)/kernel
for module in net/can/can net/can/can-raw drivers/net/can/vcan; do
    insmod \$modules/\$module.ko || echo "no \$module"
done
ip link set lo up
ip link add dev vcan0 type vcan
ip link set vcan0 up
cd $here
BINS=$bins OUT=$out sh hil/inclinometer/$scenario > $out/log 2>&1
echo "exit \$?" >> $out/log
sync
# The kernel ends with its first process.
echo o > /proc/sysrq-trigger 2>/dev/null; sleep 1
INIT
chmod +x "$out/init.sh"

timeout "${TIMEOUT:-400}" linux.uml mem=512M rootfstype=hostfs rootflags=/ root=/dev/root rw init="$out/init.sh" \
    con0=null,fd:1 con=null quiet > "$out/console" 2>&1 < /dev/null || true
cat "$out/log"
echo "files: $out"
tail -n 1 "$out/log" | grep -qx "exit 0"
