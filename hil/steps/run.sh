#!/usr/bin/env bash
# Steps at random times in a simulated Panda (payload, tilt, torque offset, friction), undeclared: how many are named, and in time?
#
#   CASES=100 SEED=1 hil/steps/run.sh              while it is identified; JOBS=2 at a time; a line per case, the counts at the end
#   CASES=100 SEED=1 hil/steps/run.sh --serving    while its model is served: one step, and then its end, another one on top, or nothing
set -euo pipefail
cd "$(dirname "$0")/../.."
test=steps::steps_while_an_arm_is_identified_are_named_with_their_time
case "${1-}" in
    "") ;;
    --serving) test=live_steps::steps_while_a_model_is_served_are_named_with_their_time ;;
    *) sed -n 2,5p "$0" >&2; exit 2 ;;
esac
exec cargo test --locked --test jobs -- --ignored --nocapture --exact "$test"
