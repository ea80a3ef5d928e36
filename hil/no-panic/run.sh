#!/usr/bin/env bash
# Shows that functions of the loop's cycle hold no panic: every function of the product under `#[cfg_attr(no_panic, no_panic::no_panic)]` is
# compiled with all optimisations, and one whose panic the compiler could not rule out calls a function that exists nowhere. The link fails, and
# names it.
#
#     hil/no-panic/run.sh
#
# It shows it for release arithmetic (a sum that overflows wraps), on the processor that it runs on. The loop and the model are the product's own crates;
# building them takes about a minute of processor time, and no part of .ci/run.
set -euo pipefail
cd "$(dirname "$0")"
export CARGO_TERM_COLOR=never RUSTFLAGS="--cfg no_panic"
target=${CARGO_TARGET_DIR:-target}
log=$(mktemp)
trap 'rm -f "$log"' EXIT

build() { cargo rustc --release --locked --quiet --bin "$@" >"$log" 2>&1; }
named() { sed -n 's/.*detected panic in function `\(.*\)`.*/\1/p' "$log" | sort -u | paste -sd ' '; }
fail() { cat "$log" >&2; echo "hil/no-panic: $1" >&2; exit 1; }

# Controls first: does the check bite?
# A function that can panic must keep a program from being linked, and one beside it that can't must not be named.
if build control; then fail "a program with a function that can panic was linked"; fi
[ "$(named)" = out_of_reach ] || fail "expected the linker to name out_of_reach alone"

# A function for which the compiler makes no code would not be looked at. Without optimisation it rules nothing out, and leaves a
# trace of each that it looks at: they must be those in the sources.
build loop --config profile.release.opt-level=0 --config 'profile.release.lto="off"' -- -Clink-arg=-Wl,--unresolved-symbols=ignore-all ||
    fail "the build without optimisation"
wanted=$(cd ../../crates && grep -rn 'cfg_attr(no_panic' . | sed 's/^\.\/\([^:]*:[0-9]*\):.*/\1/' | sort -u)
found=$(nm -Cl "$target/release/loop" | sed -n 's/.*__NoPanic as .*\/crates\/\([^:]*:[0-9]*\).*/\1/p' | sort -u)
diff <(echo "$wanted") <(echo "$found") >"$log" || fail "marked in crates (<), and looked at (>), differ"

build loop || fail "these may panic: $(named)"
echo "no panic in $(wc -l <<<"$wanted") functions: $(cut -d: -f1 <<<"$wanted" | uniq -c | awk '{ printf "%s%s %s", sep, $2, $1; sep = ", " }')"
