#!/usr/bin/env bash
# `plumbline command stop` under a flood of models, 16 idle clients, full shared memory, and a daemon out of file descriptors: a hundred of each.
#
#   hil/stop/run.sh                  ROUNDS of each case (default 100); exit code 1 when a stop was not taken
#
# Prints a table of the daemon's own stamps. Takes some minutes. Best as a user who may use SCHED_FIFO.
set -euo pipefail
cd "$(dirname "$0")/../.."
export ROUNDS="${ROUNDS:-100}"
out=$(mktemp)
trap 'rm -f "$out"' EXIT
cargo test --test clock -- --nocapture --test-threads=1 stop_path:: 2>&1 | tee "$out" | grep -v "STOP |" || failed=1
echo
echo "| case | stops | until the daemon had taken it, median / largest [ms] | until the loop braked | until the command had ended | both stamps within 100 ms |"
echo "|---|---|---|---|---|---|"
grep "STOP |" "$out" | sed 's/.*STOP |/|/'
exit "${failed:-0}"
