#!/usr/bin/env bash
# Installs the C and C++ interface below PREFIX: headers, libplumbline.so and .a, files of pkg-config and CMake.
#
#   crates/client-c/install.sh [--library FOLDER] PREFIX      e.g. sudo crates/client-c/install.sh /usr/local && sudo ldconfig
#
# FOLDER has the library that was built already (target/release); without it, the release profile is built.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
library=
if [ "${1:-}" = --library ]; then
    library=$(realpath "$2")
    shift 2
fi
if [ $# != 1 ] || [ "${1#-}" != "$1" ]; then
    sed -n '2,6s/^# \{0,1\}//p' "$0" >&2
    exit 2
fi
prefix=$1
if [ -z "$library" ]; then
    cargo build --release --locked --manifest-path "$root/Cargo.toml" --package plumbline-client-c
    library=${CARGO_TARGET_DIR:-$root/target}/release
fi

install -d "$prefix/include" "$prefix/lib/pkgconfig" "$prefix/lib/cmake/plumbline"
install -m 644 "$here"/include/plumbline.h "$here"/include/plumbline.hpp "$prefix/include/"
install -m 644 "$library/libplumbline_c.so" "$prefix/lib/libplumbline.so.0"
install -m 644 "$library/libplumbline_c.a" "$prefix/lib/libplumbline.a"
ln -sf libplumbline.so.0 "$prefix/lib/libplumbline.so"
install -m 644 "$here/packaging/plumbline.pc" "$prefix/lib/pkgconfig/"
install -m 644 "$here"/packaging/plumblineConfig*.cmake "$prefix/lib/cmake/plumbline/"
