#!/usr/bin/env bash
# Cuts commands off at every write of every result and writes the table into docs/results/campaigns.md. Needs strace; takes some minutes.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo test --test jobs -- --ignored --nocapture --exact power_cut::every_result_survives_an_interruption_at_every_write
