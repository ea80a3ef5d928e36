#!/usr/bin/env bash
# Builds the Python wheel in the dev profile, installs it into an environment of its own, and runs test_plumbline.py with pytest. Needs python3 with
# venv, and a package index that pip reaches. Further arguments are pytest's: hil/python/run.sh -k bit
set -euo pipefail
cd "$(dirname "$0")/../.."

wheels=target/python/wheels peer=target/python/peer
python=$(hil/peers/venv.sh --in python 'maturin==1.*' 'numpy==2.*' 'pytest==8.*')
rm -rf "$wheels" && mkdir -p "$wheels" "$peer"
"$python" -m maturin build --quiet --locked --profile dev --manifest-path crates/python/Cargo.toml --out "$wheels"
"$python" -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$wheels"/*.whl
# As `cargo test` builds it.
cargo build --quiet --locked --bin plumbline
cargo build --quiet --locked --package plumbline-python --example python-peer
target/debug/examples/python-peer expected "$peer"
"$python" -m pytest -q -p no:cacheprovider hil/python/test_plumbline.py "$@"
