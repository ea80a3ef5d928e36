#!/usr/bin/env bash
# Mutants of one crate against the tests of that crate:
#   hil/mutants/run.sh CRATE            a sample of about 40 mutants, minutes
#   hil/mutants/run.sh CRATE 3/20       the mutants 3, 23, 43, ... of its list
#   hil/mutants/run.sh CRATE all        all of them, hours for most crates
#   hil/mutants/run.sh CRATE diff       those in what is not committed yet
# CRATE is a folder of crates/. What is printed as MISSED passed every test: write the test, or the reason into docs/results/mutants.md.
set -euo pipefail
cd "$(dirname "$0")/../.."
crate=${1:?name a folder of crates/} which=${2:-sample}
test -d "crates/$crate" || { echo "crates/$crate: no such folder" >&2; exit 2; }
command -v cargo-mutants >/dev/null || cargo install --locked cargo-mutants
# Tests that take minutes stay out: what a mutant costs is one build of the crate and one run of the rest.
case $crate in
    diagnose) tests=(--lib --test diagnose -- gates tests::) ;;
    identify) tests=(--lib --test identify -- --skip estimators --skip streaming) ;;
    rt) tests=(--lib --test guard --test cycle --test torque) ;;
    *) tests=() ;;
esac
options=(--package "plumbline-$crate" --test-package "plumbline-$crate" --output "target/mutants/$crate" --no-shuffle)
case $which in
    all) ;;
    diff) git diff HEAD -- "crates/$crate" >"target/mutants-$crate.diff"; options+=(--in-diff "target/mutants-$crate.diff") ;;
    */*) options+=(--shard "$which" --sharding round-robin) ;;
    sample)
        count=$(cargo mutants --package "plumbline-$crate" --list 2>/dev/null | wc -l)
        options+=(--shard "0/$(((count + 39) / 40))" --sharding round-robin)
        ;;
    *) echo "\`$which\`: expected nothing, K/N, all or diff" >&2; exit 2 ;;
esac
mkdir -p "target/mutants/$crate"
CARGO_INCREMENTAL=1 cargo mutants "${options[@]}" ${tests[@]+-- "${tests[@]}"}
