#!/usr/bin/env bash
# The virtual robot PC in its quick form: the package under Debian's own systemd in a container, on this machine's kernel.
#
#   hil/robot-pc/quick.sh [PROGRAM]      PROGRAM: the plumbline to package, default target/debug/plumbline;
#                                        examples are looked for beside it
#
# Prints what held as a table; exit code 0 when all of it did. Needs root and systemd-container: else it says SKIPPED.
# The robot of the job over FCI is the emulator in a network of its own: cargo build --example fci-emulator --example forger.
# No CAN and no real-time kernel here: hil/robot-pc/full.sh has both.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
program=${1:-$root/target/debug/plumbline}
skip() { echo "SKIPPED: the virtual robot PC: $1"; exit 0; }

[ "$(id -u)" = 0 ] || skip "it needs root"
if ! command -v systemd-nspawn >/dev/null || ! command -v mmdebstrap >/dev/null; then
    apt-get install -qq -y systemd-container mmdebstrap >/dev/null 2>&1 || skip "systemd-container and mmdebstrap could not be installed"
fi
[ -x "$program" ] || skip "$program is not built"
image=$("$here/image.sh") || skip "the image could not be built"
package=$("$here/package.sh" "$program") || { echo "the package could not be built"; exit 1; }

machine=$(mktemp -d "${TMPDIR:-/tmp}/robot-pc.XXXXXX")
trap 'rm -rf "$machine"' EXIT
tar -C "$machine" -xf "$image" --exclude=./dev
mkdir -p "$machine/dev" "$machine/robot-pc"
cp "$here"/inside/* "$package" "$machine/robot-pc/"
install -m 644 "$root/config/models/panda-paper-table3.toml" "$machine/robot-pc/model.toml"
for example in forger fci-emulator; do
    built=$(dirname "$program")/examples/$example
    [ ! -x "$built" ] || strip --strip-debug -o "$machine/robot-pc/$example" "$built"
done
printf 'QUICK=1\nSEED=%s\nROUNDS=%s\n' "${SEED:-1}" "${ROUNDS:-3}" >"$machine/robot-pc/environment"
install -m 644 "$here/inside/checks.service" "$machine/etc/systemd/system/robot-pc-checks.service"
mkdir -p "$machine/etc/systemd/system/multi-user.target.wants"
ln -sf ../robot-pc-checks.service "$machine/etc/systemd/system/multi-user.target.wants/"

begin=$SECONDS
timeout 600 systemd-nspawn --quiet --directory="$machine" --register=no --keep-unit --boot --console=pipe --private-network \
    --capability=CAP_SYS_NICE,CAP_IPC_LOCK --hostname=robot-pc >"$machine.console" 2>&1 </dev/null || true
cat "$machine/var/lib/robot-pc/log" || true
table=$machine/var/lib/robot-pc/table.tsv
failed=$(grep -c ^FAILED "$table" 2>/dev/null || true)
echo "robot-pc, quick form: $((SECONDS - begin)) s in the container"
if ! grep -q 'robot-pc: end' "$machine/var/lib/robot-pc/log" || [ "${failed:-1}" != 0 ]; then
    echo "--- the container's console and journal: $machine.console, $machine.journal"
    journalctl --directory="$machine/var/log/journal" --no-pager >"$machine.journal" 2>&1 || true
    cat "$machine"/var/lib/robot-pc/*.log >>"$machine.journal" 2>/dev/null || true
    exit 1
fi
rm -f "$machine.console"
