#!/usr/bin/env bash
# Shows that functions of the loop's cycle hold no panic: every function of the product under `#[cfg_attr(no_panic, no_panic::no_panic)]` is
# compiled with all optimisations, and one whose panic the compiler could not rule out calls a function that exists nowhere. The link fails, and
# names it.
#
#     hil/no-panic/run.sh
#
# The check holds for release arithmetic (a sum that overflows wraps), on the processor that it runs on. It takes some minutes of processor
# time, and is no part of .ci/run.
set -euo pipefail
cd "$(dirname "$0")/../.."
export CARGO_TERM_COLOR=never RUSTFLAGS="--cfg no_panic" CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-hil/no-panic/target}"
log=$(mktemp)
trap 'rm -f "$log"' EXIT

# One piece with everything that it calls, or the compiler could not see that a call returns.
build() {
    cargo rustc --release --locked --quiet --package plumbline-franka --config 'profile.release.lto="fat"' \
        --config profile.release.codegen-units=1 --example "$@" >"$log" 2>&1
}
named() { sed -n 's/.*detected panic in function `\(.*\)`.*/\1/p' "$log" | sort -u | paste -sd ' '; }
fail() { cat "$log" >&2; echo "hil/no-panic: $1" >&2; exit 1; }

# Controls first. A function that can panic must keep a program from being linked, and one beside it that can't must not be named.
if build no_panic_control; then fail "a program with a function that can panic was linked"; fi
[ "$(named)" = out_of_reach ] || fail "expected the linker to name out_of_reach only"

# A function without generated code is not checked. Without optimisation the compiler excludes no panic, and leaves a trace of each checked
# function: they must be those of the sources.
build no_panic --config profile.release.opt-level=0 --config 'profile.release.lto="off"' -- -Clink-arg=-Wl,--unresolved-symbols=ignore-all ||
    fail "the build without optimisation"
wanted=$(cd crates && grep -rn 'cfg_attr(no_panic' . | sed 's/^\.\/\([^:]*:[0-9]*\):.*/\1/' | sort -u)
found=$(nm -Cl "$CARGO_TARGET_DIR/release/examples/no_panic" | sed -n 's/.*__NoPanic as .*\/crates\/\([^:]*:[0-9]*\).*/\1/p' | sort -u)
diff <(echo "$wanted") <(echo "$found") >"$log" || fail "marked in crates (<), and looked at (>), differ"

build no_panic || fail "these may panic: $(named)"
echo "no panic in $(wc -l <<<"$wanted") functions: $(cut -d: -f1 <<<"$wanted" | uniq -c | awk '{ printf "%s%s %s", sep, $2, $1; sep = ", " }')"
