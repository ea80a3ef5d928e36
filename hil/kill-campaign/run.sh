#!/usr/bin/env bash
# Kills estimator, torque client, daemon and robot at random moments and writes the tables into docs/results/campaigns.md.
#
#   hil/kill-campaign/run.sh         ROUNDS of each kind (default 50 by SIGKILL and 50 by SIGSTOP), moments by SEED (default 1)
#
# Takes about half an hour. Best as a user who may use SCHED_FIFO.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo test --test clock -- --ignored --nocapture --exact kill_campaign::the_whole_campaign
