#!/usr/bin/env bash
# Crosses every limit of the guard in every phase and writes its table into docs/results/campaigns.md. A minute, most of it building.
set -euo pipefail
cd "$(dirname "$0")/../.."
PLUMBLINE_WRITE_DOCS=1 exec cargo test --test limit_campaign -- --nocapture
