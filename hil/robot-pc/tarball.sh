#!/usr/bin/env bash
# A tarball for a machine without dpkg, with the contents of the Debian package: hil/robot-pc/tarball.sh PROGRAM prints its name.
#
#   tar -xf plumbline-VERSION-ARCH-linux.tar.gz && plumbline-VERSION-ARCH-linux/bin/plumbline --version
#
# bin, lib and share are those of the package's /usr, etc its /etc. Nothing needs root but the services.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
deb=$("$here/package.sh" "$1")
name=plumbline-$(dpkg-deb --field "$deb" Version)-$(uname -m)-linux
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
dpkg-deb -x "$deb" "$work/package"
mkdir "$work/$name"
mv "$work/package/usr/"* "$work/package/etc" "$work/$name/"
cp "$root"/LICENSE-* "$work/$name/"
tar -C "$work" --owner=0 --group=0 --sort=name -czf "$root/target/$name.tar.gz" "$name"
echo "$root/target/$name.tar.gz"
