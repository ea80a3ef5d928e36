#!/usr/bin/env bash
# The tests that take ten seconds or more of a processor and have lighter ones beside them, so that `cargo test` takes minutes, and, without a name, the
# effect that is added by the recipe in CONTRIBUTING.md. .ci/run has no time for them.
#
#   hil/long-tests/run.sh [NAME...]       (parts of their names; all that are marked with this file)
#
# Exit code 0 when each of them has run and passed. They take minutes.
set -euo pipefail
cd "$(dirname "$0")/../.."
[ $# -gt 0 ] || CARGO_TARGET_DIR=target/made-up-effect cargo test --locked --features made-up-effect --test made_up_effect
marked=$(grep -rh --include='*.rs' -A1 'ignore = "hil/long-tests/run.sh"' tests crates | sed -n 's/^fn \(\w*\)().*/\1/p')
names=$marked
[ $# -eq 0 ] || names=$(printf '%s\n' "$marked" | grep -F "$(printf '%s\n' "$@")")
out=$(mktemp)
trap 'rm -f "$out"' EXIT
# shellcheck disable=SC2086 # one argument for each name
cargo test --locked -- --ignored $names | tee "$out"
passed=$(awk '/^test result: ok/ { sum += $4 } END { print sum + 0 }' "$out")
[ "$passed" = "$(printf '%s\n' "$names" | wc -l)" ] || { echo "$passed tests passed, which are not those: $names" >&2; exit 1; }
