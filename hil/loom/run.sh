#!/usr/bin/env bash
# Runs the loop's lock-free hand-overs under every order of events that two or three threads can see: crates/rt/src/controls.rs, and the
# rings, which are the crate rtrb in the version that the product has, with loom's atomics in place of core's.
#
#     hil/loom/run.sh
set -euo pipefail
cd "$(dirname "$0")"

manifest=$(cargo metadata --locked --format-version 1 --filter-platform "$(rustc -vV | sed -n 's/^host: //p')" --manifest-path ../../Cargo.toml |
    python3 -c 'import json, sys; print(next(p["manifest_path"] for p in json.load(sys.stdin)["packages"] if p["name"] == "rtrb"))')
rings=target/rtrb
rm -rf "$rings"
mkdir -p "$rings"
cp -r "$(dirname "$manifest")/src" "$rings/src"
sed -i 's/core::sync::atomic/loom::sync::atomic/' "$rings"/src/*.rs
grep -q 'use loom::sync::atomic::{AtomicU8, AtomicUsize' "$rings/src/lib.rs" || { echo "rtrb's atomics are not where they were" >&2; exit 1; }
sed -n '/^\[package\]/,/^$/p' "$(dirname "$manifest")/Cargo.toml.orig" | grep -E '^(name|version|edition) =' | sed '1i [package]' >"$rings/Cargo.toml"
printf '[features]\ndefault = ["std"]\nstd = []\n[dependencies]\nloom = "0.7"\n' >>"$rings/Cargo.toml"

# A control: where the rings' sides don't wait for each other's words, that is found.
sed -i.sound 's/Ordering::Release/Ordering::Relaxed/' "$rings/src/lib.rs"
if cargo test --release --locked --quiet rings:: >target/control.log 2>&1; then
    echo "rings whose sides publish nothing were found sound: the check is blind" >&2
    exit 1
fi
grep -q 'Causality violation' target/control.log || { cat target/control.log; exit 1; }
mv "$rings/src/lib.rs.sound" "$rings/src/lib.rs"
touch "$rings/src/lib.rs"
cargo test --release --locked "$@"

# The crate itself, with loom's atomics.
cd ../..
RUSTFLAGS="--cfg loom" CARGO_TARGET_DIR=hil/loom/target/rt cargo test --release --locked -p plumbline-rt --lib loom_tests "$@"
