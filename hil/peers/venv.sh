#!/usr/bin/env bash
# Makes the Python environment for peers (clients and reference implementations in Python) and prints its interpreter.
#
#   hil/peers/venv.sh [--in NAME] [REQUIREMENT...]     e.g. hil/peers/venv.sh 'pin==3.*'
#
# The common environment always holds iceoryx2; further requirements are added. Packages that don't get along with each other go
# into environments of their own, by NAME. What is there already is not installed again, and several callers
# at once wait for each other. Needs python3 with venv, and a package index that pip reaches. Everything lies in
# target/peers: remove that directory to start over.
set -euo pipefail

root=$(cd "$(dirname "$0")/../.." && pwd)
peers=$root/target/peers
mkdir -p "$peers"

venv=$peers/venv
always=('iceoryx2==0.10.*')
if [ "${1:-}" = --in ]; then
    venv=$peers/venv-$2
    always=()
    shift 2
fi

exec 9>"$venv.lock"
flock 9

python=$venv/bin/python
installed=$venv/installed.txt
if ! "$python" -c '' 2>/dev/null; then
    rm -rf "$venv"
    python3 -m venv "$venv" >&2
fi
touch "$installed"
for requirement in "${always[@]}" "$@"; do
    if ! grep -qxF -- "$requirement" "$installed"; then
        "$python" -m pip install --quiet --disable-pip-version-check -- "$requirement" >&2
        echo "$requirement" >>"$installed"
    fi
done
echo "$python"
