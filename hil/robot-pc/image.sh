#!/usr/bin/env bash
# The Debian root of the virtual robot PC, made once and kept: hil/robot-pc/image.sh prints its tar file.
# Needs root, mmdebstrap and a Debian mirror. PLUMBLINE_CACHE says where it is kept (default: target/robot-pc).
set -euo pipefail

root=$(cd "$(dirname "$0")/../.." && pwd)
cache=${PLUMBLINE_CACHE:-$root/target/robot-pc}
packages=systemd,systemd-sysv,dbus,iproute2,util-linux,procps,can-utils,kmod
image=$cache/bookworm-$(printf '%s' "$packages" | sha256sum | cut -c 1-12).tar
mkdir -p "$cache"
exec 9>"$cache/lock"
flock 9
if [ ! -s "$image" ]; then
    mmdebstrap --quiet --format=tar --variant=minbase --include="$packages" bookworm "$image.new" >&2
    mv "$image.new" "$image"
fi
echo "$image"
