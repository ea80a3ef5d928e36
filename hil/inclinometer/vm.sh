#!/bin/sh
# SocketCAN for real: boots Debian's PREEMPT_RT kernel in QEMU (no KVM needed) with vcan, and runs the simulated inclinometer and
# plumbline on it. Needs Debian's qemu-system-x86, cpio and xz-utils; kernel and busybox are fetched with `apt-get download`, or found in
# the folder KERNEL as `dpkg-deb -x` leaves them.
#
#     cargo build --bin plumbline --example sim-inclinometer
#     hil/inclinometer/vm.sh target/debug [SCENARIO]
#
# Exits 0 when the scenario does; its output is printed.
#
# With ICOUNT=1 the machine's clock counts instructions, a nanosecond each, and skips idle time, whatever else the host does. A time inside is one of
# that machine alone.
set -eu

here=$(cd "$(dirname "$0")/../.." && pwd)
bins=$(cd "${1:?folder of the binaries}" && pwd)
scenario=$here/hil/inclinometer/${2:-scenario.sh}
work=$(mktemp -d /tmp/plumbline-can.XXXXXX)
trap 'rm -rf "$work"' EXIT

kernel=${KERNEL:-$work/kernel}
if [ ! -d "$kernel" ]; then
    mkdir -p "$work/debs" "$kernel"
    image=$(apt-cache search --names-only '^linux-image-6.1.*-rt-amd64$' | awk '{print $1}' | sort -V | tail -n 1)
    (cd "$work/debs" && apt-get -q download "$image" busybox-static)
    for deb in "$work"/debs/*.deb; do dpkg-deb -x "$deb" "$kernel"; done
fi
version=$(ls "$kernel/lib/modules")

# An initial file system is all that there is: busybox, four modules, two programs and their libraries.
root=$work/root
mkdir -p "$root/bin" "$root/modules" "$root/proc" "$root/sys" "$root/dev" "$root/tmp" "$root/etc" "$root/job"
cp "$kernel/bin/busybox" "$root/bin/"
for module in net/can/can net/can/can-raw drivers/net/can/dev/can-dev drivers/net/can/vcan; do
    file=$kernel/lib/modules/$version/kernel/$module.ko
    if [ -f "$file.xz" ]; then xz -dc "$file.xz" > "$root/modules/${module##*/}.ko"; else cp "$file" "$root/modules/"; fi
done
for program in "${PLUMBLINE:-$bins/plumbline}" "${SIMULATOR:-$bins/examples/sim-inclinometer}"; do
    cp "$program" "$root/bin/"
    ldd "$program" | awk '/\// {for (i = 1; i <= NF; i++) if ($i ~ /^\//) print $i}' | while read -r library; do
        mkdir -p "$root$(dirname "$library")"
        cp -nL "$library" "$root$library"
    done
done
cp -r "$here/config/." "$root/job/"
cp "$scenario" "$root/scenario.sh"
cat > "$root/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin HOME=/tmp TERM=dumb
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs dev /dev
mkdir -p /dev/shm
mount -t tmpfs shm /dev/shm
mount -t tmpfs tmp /tmp
echo root:x:0:0:root:/tmp:/bin/sh > /etc/passwd
for module in can can-raw can-dev vcan; do insmod /modules/$module.ko; done
ip link set lo up
ip link add dev vcan0 type vcan
ip link set vcan0 up
cd /job
sh /scenario.sh > /dev/ttyS0 2>&1
echo "scenario: exit $?" > /dev/ttyS0
poweroff -f
INIT
chmod +x "$root/init"
(cd "$root" && find . | cpio -o -H newc --quiet | gzip -1) > "$work/initrd"

clock="-accel tcg,thread=multi -smp 2"
[ "${ICOUNT:-0}" = 1 ] && clock="-accel tcg,thread=single -icount shift=0,sleep=off -rtc clock=vm -smp 1"
# shellcheck disable=SC2086
timeout "${TIMEOUT:-540}" qemu-system-x86_64 $clock -cpu max -machine q35 -m 1536 -nodefaults -display none -no-reboot \
    -kernel "$kernel/boot/vmlinuz-$version" -initrd "$work/initrd" -append "console=ttyS0 quiet loglevel=3 panic=1" -serial stdio < /dev/null |
    tee "$work/log" || true
tr -d '\r' < "$work/log" | grep -qx "scenario: exit 0"
