#!/usr/bin/env bash
# The Debian package from a program that is built already: hil/robot-pc/package.sh PROGRAM prints the .deb file.
# Needs cargo-deb; installs it where it is missing.
set -euo pipefail

program=$(realpath "$1")
root=$(cd "$(dirname "$0")/../.." && pwd)
cache=${PLUMBLINE_CACHE:-$root/target/robot-pc}
mkdir -p "$cache/deb/release"
cargo deb --version >/dev/null 2>&1 || cargo install --locked --debug --quiet cargo-deb >&2
# cargo-deb takes the program from target/release; here it finds the one that was given, whatever profile it was built with.
strip --strip-debug -o "$cache/deb/release/plumbline" "$program"
cd "$root"
CARGO_TARGET_DIR=$cache/deb cargo deb --no-build --no-strip --fast --quiet --output "$cache/plumbline.deb" >&2
echo "$cache/plumbline.deb"
