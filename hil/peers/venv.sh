#!/usr/bin/env bash
# Makes the Python environment for peers (clients and reference implementations in Python) and prints its interpreter.
#
#   hil/peers/venv.sh [REQUIREMENT...]     e.g. hil/peers/venv.sh 'pin==3.*'
#
# Always holds iceoryx2; further requirements are added. What is there already is not installed again, and several callers
# at once wait for each other. Needs python3 with venv, and a package index that pip reaches. Everything lies in
# target/peers: remove that directory to start over.
set -euo pipefail

root=$(cd "$(dirname "$0")/../.." && pwd)
peers=$root/target/peers
mkdir -p "$peers"

exec 9>"$peers/.lock"
flock 9

python=$peers/venv/bin/python
installed=$peers/venv/installed.txt
if ! "$python" -c '' 2>/dev/null; then
    rm -rf "$peers/venv"
    python3 -m venv "$peers/venv" >&2
fi
touch "$installed"
for requirement in 'iceoryx2==0.10.*' "$@"; do
    if ! grep -qxF -- "$requirement" "$installed"; then
        "$python" -m pip install --quiet --disable-pip-version-check -- "$requirement" >&2
        echo "$requirement" >>"$installed"
    fi
done
echo "$python"
