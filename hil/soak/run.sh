#!/usr/bin/env bash
# The loop for a long time with a busy machine beside it: every period accounted for, memory and file descriptors flat, jitter beside cyclictest's.
#
#     hil/soak/run.sh [SECONDS]            (3600 by default; 60 at least)
#
# A daemon drives the simulated Panda at 1 kHz by the clock. Beside it stress-ng keeps the processors, the memory and the disk busy, and
# cyclictest wakes up every millisecond with a priority just above the loop's: what it sees is what the machine gives anybody.
# Exit 0: everything holds. Nothing here fails for microseconds, for those are the machine's.
set -euo pipefail
cd "$(dirname "$0")/../.."
seconds=${1:-3600}
if ! [ "$seconds" -ge 60 ] 2>/dev/null; then
    echo "hil/soak/run.sh: expected a number of seconds, 60 or more, found '$seconds'" >&2
    exit 2
fi
for tool in stress-ng cyclictest python3; do
    command -v "$tool" >/dev/null || { echo "needs $tool (Debian: stress-ng, rt-tests, python3)" >&2; exit 2; }
done
program=${PLUMBLINE:-}
if [ -z "$program" ]; then
    cargo build --release --locked --quiet --bin plumbline
    program=${CARGO_TARGET_DIR:-target}/release/plumbline
fi
exec python3 hil/soak/soak.py "$program" "$seconds"
