#!/usr/bin/env bash
# Builds and times the peers of benches/speed.rs: run.sh PYTHON DIRECTORY
#
# PYTHON is the interpreter of the peers' environment (hil/peers/venv.sh --in bench, with what benches/speed.rs asks for). Prints one line per
# figure: what, peer, nanoseconds. A peer that can't be built or run says SKIPPED and why on standard error.
set -uo pipefail
python=$1
out=$2
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$out"
site=$("$python" -c 'import sysconfig; print(sysconfig.get_paths()["purelib"])')

try() {
    local name=$1
    shift
    if ! "$@" 2>"$out/$name.log"; then
        echo "SKIPPED $name: $(tail -n 1 "$out/$name.log") (all of it in $out/$name.log)" >&2
    fi
}

casadi() {
    "$python" "$here/casadi_arm.py" "$out/casadi_arm.c" &&
        cc -O3 -march=native -I"$here" -I"$out" -o "$out/casadi" "$here/casadi_loop.c" "$out/casadi_arm.c" -lm && "$out/casadi"
}

pinocchio() {
    local prefix=$site/cmeel.prefix
    [ "$out/pinocchio" -nt "$here/pinocchio.cpp" ] ||
        g++ -std=c++17 -O3 -march=native -DNDEBUG -I"$here" -isystem "$prefix/include" -isystem "$prefix/include/eigen3" \
            -o "$out/pinocchio" "$here/pinocchio.cpp" -L"$prefix/lib" -lpinocchio_default -Wl,-rpath,"$prefix/lib" || return 1
    "$out/pinocchio"
}

mujoco() {
    local library
    library=$(ls "$site"/mujoco/libmujoco.so.* | head -n 1) &&
        gcc -O3 -march=native -I"$here" -I"$site/mujoco/include" -o "$out/mujoco" "$here/mujoco_arm.c" "$library" -lm \
            -Wl,-rpath,"$site/mujoco" && "$out/mujoco" "$out/arm.xml"
}

try casadi casadi
try pinocchio pinocchio
try mujoco mujoco
