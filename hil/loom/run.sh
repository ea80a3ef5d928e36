#!/usr/bin/env bash
# Runs the loop's lock-free hand-overs (src/rt/controls.rs, the very file) under every order of events that two or three threads can see.
#
#     hil/loom/run.sh
set -euo pipefail
cd "$(dirname "$0")"
exec cargo test --release --locked "$@"
