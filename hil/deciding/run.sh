#!/usr/bin/env bash
# Pairs of effects that a small motion cannot tell apart, and the motions that plumbline plans and drives to decide: docs/results/diagnosis.md.
# run.sh SEED...   results in target/deciding
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo build --release
exec hil/deciding/study.py target/release/plumbline target/deciding "${@:-11}"
