#!/usr/bin/env bash
# The loop's statistics with sixteen torque clients and without, into docs/results/campaigns.md.
#
#   hil/torque-clients/run.sh        ROUNDS of each kind (default 10) of SECONDS (default 20)
#
# Takes a quarter of an hour. Best as a user who may use SCHED_FIFO, on a machine that has nothing else to do.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo test --test clock -- --ignored --nocapture --exact torque_clients::the_loop_with_clients_and_without
