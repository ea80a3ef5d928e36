#!/usr/bin/env bash
# The virtual robot PC in its full form: Debian's PREEMPT_RT kernel in QEMU with systemd, the package, CAN, and the emulator of Franka's
# control unit on a network of its own.
#
#   hil/robot-pc/full.sh [FOLDER]        FOLDER: what cargo has built into, default target/release
#
#   cargo build --release --bin plumbline --example fci-emulator --example sim-inclinometer
#
# Prints what held as a table; exit code 0 when all of it did. Needs root, qemu-system-x86, mmdebstrap and cpio: else it says SKIPPED.
#
# An emulated processor is some thirty times slower than the one it runs on, so the machine has a clock of its own: an instruction takes it a nanosecond,
# and where nothing is to be done the time until something is passes at once. Inside, a millisecond is a millisecond of a processor of a thousand
# million instructions a second, whatever the host does meanwhile; that is several times slower than a robot's PC, so limits of time are twice as long
# (PATIENCE), and the simulated arm is integrated in one step a millisecond instead of three. KVM=1 takes the host's processor and clock instead.
# TIMEOUT: all of it, by the host's clock [s].
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
programs=${1:-$root/target/release}
export PLUMBLINE_CACHE=${PLUMBLINE_CACHE:-$root/target/robot-pc}
skip() { echo "SKIPPED: the virtual robot PC, full form: $1"; exit 0; }

[ "$(id -u)" = 0 ] || skip "it needs root"
for tool in qemu-system-x86_64 mmdebstrap cpio depmod; do
    command -v $tool >/dev/null && continue
    apt-get install -qq -y qemu-system-x86 mmdebstrap cpio kmod >/dev/null 2>&1 || skip "$tool is missing and could not be installed"
done
[ -x "$programs/plumbline" ] && [ -x "$programs/examples/fci-emulator" ] || skip "plumbline and fci-emulator are not built in $programs"
image=$("$here/image.sh") || skip "the image could not be built"
echo "image: $SECONDS s"
begin=$SECONDS
package=$("$here/package.sh" "$programs/plumbline") || { echo "the package could not be built"; exit 1; }

# --- the kernel and a busybox that brings the disk up: from Debian's packages, unpacked and not installed
kernel=$PLUMBLINE_CACHE/kernel
if [ ! -e "$kernel/ready" ]; then
    rm -rf "$kernel"; mkdir -p "$kernel/debs" "$kernel/root"
    name=$(apt-cache depends linux-image-rt-amd64 | sed -n 's/.*Depends: \(linux-image-[0-9].*rt-amd64\).*/\1/p' | head -n 1)
    (cd "$kernel/debs" && apt-get download -qq "$name" busybox-static >/dev/null) || skip "Debian's real-time kernel could not be fetched"
    for deb in "$kernel"/debs/*.deb; do dpkg-deb -x "$deb" "$kernel/root"; done
    touch "$kernel/ready"
fi
vmlinuz=$(echo "$kernel"/root/boot/vmlinuz-*)
version=${vmlinuz##*/vmlinuz-}
modules=$kernel/root/lib/modules/$version
depmod -b "$kernel/root" "$version"

machine=$(mktemp -d "${TMPDIR:-/tmp}/robot-pc.XXXXXX")
trap 'rm -rf "$machine"' EXIT

# --- the machine's disk
mkdir -p "$machine/root"
tar -C "$machine/root" -xf "$image" --exclude=./dev
mkdir -p "$machine/root"/{dev,robot-pc}
for part in kernel/drivers/net/can kernel/net/can kernel/drivers/net/veth.ko; do
    [ -e "$modules/$part" ] || continue
    mkdir -p "$machine/root/usr/lib/modules/$version/$(dirname "$part")"
    cp -r "$modules/$part" "$machine/root/usr/lib/modules/$version/$(dirname "$part")/"
done
cp "$modules"/modules.{order,builtin,builtin.modinfo} "$machine/root/usr/lib/modules/$version/" 2>/dev/null || true
depmod -b "$machine/root/usr" "$version" 2>/dev/null || depmod -b "$machine/root" "$version"
cp "$here"/inside/* "$package" "$machine/root/robot-pc/"
install -m 644 "$root/config/models/panda-paper-table3.toml" "$machine/root/robot-pc/model.toml"
for program in fci-emulator sim-inclinometer; do
    [ ! -x "$programs/examples/$program" ] || strip -o "$machine/root/robot-pc/$program" "$programs/examples/$program"
done
sed 's/^substeps = .*/substeps = 1/' "$root/config/arms/sim-panda.toml" >"$machine/root/robot-pc/arm.toml"
# Whoever asks how far something is spends the machine's time: every half second is often enough.
printf 'QUICK=0\nSEED=%s\nROUNDS=%s\nPATIENCE=%s\nPOLL=0.5\n' "${SEED:-1}" "${ROUNDS:-1}" "${PATIENCE:-2}" >"$machine/root/robot-pc/environment"
install -m 644 "$here/inside/checks.service" "$machine/root/etc/systemd/system/robot-pc-checks.service"
mkdir -p "$machine/root/etc/systemd/system/multi-user.target.wants"
ln -sf ../robot-pc-checks.service "$machine/root/etc/systemd/system/multi-user.target.wants/"

# Motions are searched here: inside, that alone would take minutes. The programs inside find them planned, and check them anew.
. "$here/inside/fci-job.sh"
cat "$root/config/daemon.toml" "$here/inside/short.toml" >"$machine/daemon.toml"
plan() { # FOLDER JOB ARGUMENT...: a daemon plans before it does anything else; this one has no time to do more.
    local folder=$machine/root/robot-pc/$1
    shift
    PLUMBLINE_RUNTIME_DIR=$machine/runtime "$programs/plumbline" daemon "$@" --out "$folder" >"$machine/plan.log" 2>&1 &
    local planner=$! waited=0
    until [ -s "$folder/plans/planned-for" ] || [ $waited -gt 1200 ]; do sleep 0.2; waited=$((waited + 1)); done
    kill $planner 2>/dev/null || true
    wait $planner 2>/dev/null || true
    [ -s "$folder/plans/planned-for" ] || { cat "$machine/plan.log"; exit 1; }
}
plan results "$machine/daemon.toml"
mapfile -t arguments < <(fci_job 2)
plan job "$root/config/panda-emulator-wall.toml" "${arguments[@]}" --set backend.franka.address=127.0.0.1
mapfile -t arguments < <(fci_job 50)
plan job2 "$root/config/panda-emulator-wall.toml" "${arguments[@]}" --set backend.franka.address=127.0.0.1

mke2fs -q -t ext4 -O ^has_journal -d "$machine/root" "$machine/disk" 2G
rm -rf "$machine/root"

# --- a first root that has the drivers of the disk, and hands over to it
mkdir -p "$machine"/first/{bin,dev,new,drivers}
install -m 755 "$(find "$kernel/root" -path '*/bin/busybox' -type f | head -n 1)" "$machine/first/bin/busybox"
modprobe -d "$kernel/root" -S "$version" --show-depends -a virtio_pci virtio_blk ext4 | sed -n 's/^insmod \([^ ]*\).*/\1/p' | awk '!seen[$0]++' |
    while read -r driver; do
        number=$((${number:-100} + 1))
        cp "$driver" "$machine/first/drivers/$number-${driver##*/}"
    done
cat >"$machine/first/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox mount -t devtmpfs dev /dev
for driver in /drivers/*; do /bin/busybox insmod "$driver"; done
/bin/busybox mount -t ext4 -o noatime /dev/vda /new
/bin/busybox mount --move /dev /new/dev
exec /bin/busybox switch_root /new /sbin/init
INIT
chmod +x "$machine/first/init"
(cd "$machine/first" && find . | cpio --quiet -o -H newc) >"$machine/first.cpio"

echo "package, kernel, plans and disk: $((SECONDS - begin)) s"
boot=$SECONDS
# One processor: with two, one that waits for the other would count on alone.
processor=(-accel tcg,thread=single -icount shift=0,sleep=off -rtc clock=vm -smp 1 -cpu max,la57=off)
[ "${KVM:-0}" = 1 ] && processor=(-accel kvm -smp 2 -cpu max)
# getty_auto=0: nobody logs in, and without udev systemd would wait 90 s for the line. tsc=reliable: else an emulated kernel asks a timer chip for
# each look at the clock, which costs more than the loop's own work.
# Two machines side by side share the parts: an emulated one uses a single processor of this one.
start() { # PARTS
    local console=$machine.console.${1##*,start,}
    console=${console%%,*}
    timeout "${TIMEOUT:-1500}" qemu-system-x86_64 "${processor[@]}" -machine q35 -m 2048 -nodefaults -display none -no-reboot \
        -kernel "$vmlinuz" -initrd "$machine/first.cpio" -drive "file=$machine/disk,format=raw,if=virtio,cache=unsafe,snapshot=on" \
        -append "console=ttyS0 quiet systemd.show_status=0 systemd.getty_auto=0 mitigations=off tsc=reliable panic=-1 robot-pc=$1" \
        -serial stdio </dev/null 2>&1 | tee "$console" | stdbuf -oL tr -d '\r' |
        stdbuf -oL grep -aE '^(HELD|FAILED|SKIPPED|NOT SHOWN HERE|seed|session|robot-pc: [^e])' || true
    grep -aq 'robot-pc: end' "$console" || echo "FAILED  the machine with the parts $1 came to no end: $console"
}
start install,start,kernel_and_can,tilt,move,hang,upgrade,limits,leave &
start install,start,fci,kill,leave &
wait
count() { cat "$machine".console.* | tr -d '\r' | grep -ac "$1" || true; }
echo "robot-pc, full form: $(count ^HELD) held, $(count ^FAILED) failed; $((SECONDS - begin)) s with the image, $((SECONDS - boot)) s of them in the machines"
if [ "$(count '^robot-pc: end')" != 2 ] || [ "$(count ^FAILED)" != 0 ]; then
    echo "--- the machines' consoles: $machine.console.*"
    exit 1
fi
rm -f "$machine".console.*
