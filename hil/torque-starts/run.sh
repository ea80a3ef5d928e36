#!/usr/bin/env bash
# Ten torque-controlled starts in each of ten mountings against the emulator of Franka's control interface, whose arm compensates upright
# gravity whatever the mounting. Prints the table of docs/results/franka-clients.md.
#
#   hil/torque-starts/run.sh
#
# Takes about three minutes.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo test --test fci -- --ignored --nocapture --exact torque_starts::ten_starts_in_each_of_ten_mountings
