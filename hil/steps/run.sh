#!/usr/bin/env bash
# Steps at random times while a simulated Panda is identified (payload, tilt, torque offset, friction), undeclared: how many are named, and in time?
#
#   CASES=100 SEED=1 hil/steps/run.sh              JOBS=2 at a time; a line per case, the counts at the end
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo test --locked --test jobs -- --ignored --nocapture --exact steps::steps_while_an_arm_is_identified_are_named_with_their_time
