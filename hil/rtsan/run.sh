#!/usr/bin/env bash
# Whole runs of the loop on every arm under LLVM's RealtimeSanitizer: it ends the program at the first call of the loop's thread
# that may block (malloc, free, write, a mutex that is taken, sleep ...), with the place where it was made.
#
#     hil/rtsan/run.sh
#
# The library with the feature `rtsan` is built beside the ordinary one; that takes a few minutes of processor time, so this is a command of its
# own and no part of .ci/run. The sanitizer's runtime comes with the Rust toolchain. RTSan sees calls of the C library: what goes past it
# (rustix speaks to the kernel itself) is what the system call filter of the same test watches.
set -euo pipefail
cd "$(dirname "$0")/../.."

host=$(rustc -vV | sed -n 's/^host: //p')
runtime=$(find "$(rustc --print sysroot)/lib/rustlib/$host/lib" -name 'librustc*_rt.rtsan.a' -print -quit)
if [ -z "$runtime" ]; then
    echo "this Rust toolchain has no RealtimeSanitizer for $host: expected librustc-*_rt.rtsan.a in its lib/rustlib/$host/lib" >&2
    exit 2
fi
export RTSAN_ENABLE=1 RTSAN_LIB_PATH=$runtime
exec cargo test --locked --features rtsan --test rt_clean "$@"
