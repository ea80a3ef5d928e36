#!/usr/bin/env bash
# The six demonstrations of undeclared effects (config/demo-*.toml), each as it is shipped, compared with what its arm file says.
#
#   hil/demonstrations/run.sh            SEED=n: other motions and other noise
#
# Prints what each job prints first, and its seconds; exit code 0 when all found the truth. About two minutes.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo test --locked --test jobs -- --ignored --nocapture --test-threads=2 demonstrations::
