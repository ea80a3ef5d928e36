#!/usr/bin/env bash
# Cases of another engine (MuJoCo) judge the diagnosis: how often is it right where the project made neither arm nor data?
#
#     hil/study/run.sh [CASES] [CLEAN] [FIRST_SEED]     (300, 200, 1000; clean arms have their seeds after those with effects)
#     hil/study/run.sh ci                               (8 cases and 6 clean ones, 40 s of motion each)
#
# Results lie in target/study. Seeds from 5000 on are the judge's: totals only (judge.py). Program: $PLUMBLINE, or a release build.
set -euo pipefail
cd "$(dirname "$0")/../.."
quick=()
if [ "${1:-}" = ci ]; then
    quick=(--quick)
    set -- 8 6 1000
fi
cases=${1:-300} clean=${2:-200} first=${3:-1000}
for number in "$cases" "$clean" "$first"; do
    case $number in '' | *[!0-9]*) echo "hil/study/run.sh: expected numbers [CASES] [CLEAN] [FIRST_SEED], found '$number'" >&2; exit 2 ;; esac
done
python=$(hil/peers/venv.sh --in study 'mujoco==3.*' numpy scipy scikit-learn numba)
program=${PLUMBLINE:-}
if [ -z "$program" ]; then
    cargo build --release --locked --quiet --bin plumbline
    program=${CARGO_TARGET_DIR:-target}/release/plumbline
fi
export NUMBA_CACHE_DIR=$PWD/target/study/compiled PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
mkdir -p target/study
results=target/study/seeds-$first.jsonl
rm -f "$results"
"$python" hil/study/judge.py plain 3110 3115 3126 3131
[ "$cases" -eq 0 ] || "$python" hil/study/judge.py judge "$results" --program "$program" --from "$first" --count "$cases" "${quick[@]}"
[ "$clean" -eq 0 ] || "$python" hil/study/judge.py judge "$results" --program "$program" --from $((first + cases)) --count "$clean" --clean "${quick[@]}"
exec "$python" hil/study/judge.py table "$results"
