#!/usr/bin/env bash
# Motions that plumbline plans and drives for what a diagnosis leaves open, on the simulated Panda: docs/results/diagnosis.md.
# run.sh pairs|intervals [SEED COUNT]   results in target/deciding
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo build --release
exec hil/deciding/study.py "${1:?pairs or intervals}" target/release/plumbline "target/deciding/$1" "${2:-1}" "${3:-20}"
