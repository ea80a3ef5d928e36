#!/usr/bin/env bash
# Plays every fault at every phase of a job against the emulator of Franka's control interface and writes docs/results/franka-faults.md.
#
#   hil/fci-faults/run.sh
#
# Takes about six minutes. Best as a user who may use SCHED_FIFO, and on a machine that has nothing else to do: a robot waits 20 ms.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo test --test fci -- --ignored --nocapture --exact fci_faults::the_whole_campaign
