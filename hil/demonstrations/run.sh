#!/usr/bin/env bash
# The six demonstrations of undeclared effects (config/demo-*.toml), each as it is shipped, compared with what its arm file says.
#
#   hil/demonstrations/run.sh [TEST...]            (tests of tests/jobs/demonstrations.rs; all six); SEED=n: other motions and other noise
#
# Prints what each job prints first, and its seconds; exit code 0 when all found the truth. All six take two and a half minutes.
set -euo pipefail
cd "$(dirname "$0")/../.."
[ $# -gt 0 ] || set -- demonstrations::
exec cargo test --locked --test jobs -- --ignored --nocapture --test-threads=2 "$@"
