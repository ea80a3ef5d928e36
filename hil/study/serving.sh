#!/usr/bin/env bash
# Steps while a model is served, on the second engine: an arm of MuJoCo is identified and watched along an unseen motion, in which a payload, a tilt, a
# torque offset or friction comes, and then goes, or another one comes on top.
#
#     hil/study/serving.sh [CASES] [CLEAN] [FIRST_SEED]     (100, 40, 1000; clean arms, in which nothing comes, have their seeds after the others)
#
# The recorded samples go through the estimator's watch one by one, as fast as it takes them. Seeds from 5000 on are the judge's: totals only.
set -euo pipefail
cd "$(dirname "$0")/../.."
cases=${1:-100} clean=${2:-40} first=${3:-1000}
for number in "$cases" "$clean" "$first"; do
    case $number in '' | *[!0-9]*) echo "hil/study/serving.sh: expected numbers [CASES] [CLEAN] [FIRST_SEED], found '$number'" >&2; exit 2 ;; esac
done
python=$(hil/peers/venv.sh --in study 'mujoco==3.*' numpy scipy scikit-learn numba)
# The last of the messages that name a test program of the package itself.
replay=$(cargo test --locked --lib --package plumbline-robot --no-run --message-format json 2>/dev/null |
    "$python" -c 'import json, sys; print([m["executable"] for m in map(json.loads, sys.stdin) if m.get("executable")][-1])')
export NUMBA_CACHE_DIR=$PWD/target/study/compiled PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
mkdir -p target/study
results=target/study/serving-$first.jsonl
rm -f "$results"
[ "$cases" -eq 0 ] || "$python" hil/study/serving.py "$results" --replay "$replay" --from "$first" --count "$cases"
[ "$clean" -eq 0 ] || "$python" hil/study/serving.py "$results" --replay "$replay" --from $((first + cases)) --count "$clean" --clean
