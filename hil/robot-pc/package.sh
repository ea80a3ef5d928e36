#!/usr/bin/env bash
# The Debian package from programs that are built already: hil/robot-pc/package.sh PROGRAM prints the .deb file. The program `rig` is taken
# from the folder `examples` beside PROGRAM, as cargo builds it. Needs cargo-deb; installs it where it is missing.
set -euo pipefail

program=$(realpath "$1")
rig=$(dirname "$program")/examples/rig
root=$(cd "$(dirname "$0")/../.." && pwd)
cache=${PLUMBLINE_CACHE:-$root/target/robot-pc}
mkdir -p "$cache/deb/release/examples"
[ -x "$rig" ] || { echo "$rig is missing: cargo build --release --bin plumbline --example rig" >&2; exit 1; }
cargo deb --version >/dev/null 2>&1 || cargo install --locked --debug --quiet cargo-deb >&2
# cargo-deb takes the programs from target/release; here it finds the ones that were given, whatever profile they were built with.
strip --strip-all --remove-section=.comment --remove-section=.note -o "$cache/deb/release/plumbline" "$program"
strip --strip-all --remove-section=.comment --remove-section=.note -o "$cache/deb/release/examples/rig" "$rig"
cd "$root"
# What the program writes of itself, and Debian's form of a changelog.
rm -rf target/package
"$program" manual --out target/package >&2
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)
maintainer=$(sed -n 's/^maintainer = "\(.*\)"/\1/p' Cargo.toml)
date=$(git log -1 --format=%cD 2>/dev/null || date -R)
printf 'plumbline (%s-1) unstable; urgency=medium\n\n  * Changes: /usr/share/doc/plumbline/CHANGELOG.md\n\n -- %s  %s\n' \
    "$version" "$maintainer" "$date" >target/package/changelog
CARGO_TARGET_DIR=$cache/deb cargo deb --no-build --no-strip --fast --quiet --output "$cache/plumbline.deb" >&2
echo "$cache/plumbline.deb"
