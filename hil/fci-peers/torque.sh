#!/usr/bin/env bash
# A pylibfranka loop holds the emulator of Franka's control interface and drives a motion at 1 kHz, plumbline listens, identifies and serves: what the
# loop's tracking error becomes with the served torque.
#
#   hil/fci-peers/torque.sh [--seconds S] [--command-wait MS]
#
# Three processes: the emulator, `plumbline run config/guest.toml`, and examples/clients/python/pylibfranka_torque.py. Takes three minutes and the
# builds. Needs cargo, python3 (3.11 or newer) with venv, and a package index that pip reaches. Exit code 1 where a goal is missed: error on unseen motion at most 1.05 of the
# sensors' noise, tracking error of every joint at most a fifth.
set -euo pipefail
cd "$(dirname "$0")/../.."

# As `cargo test` builds them.
cargo build --quiet --locked --bin plumbline --example fci-emulator
wheels=target/python/wheels
python=$(hil/peers/venv.sh --in torque 'pylibfranka==0.21.3' 'maturin==1.*' 'numpy==2.*')
rm -rf "$wheels" && mkdir -p "$wheels"
"$python" -m maturin build --quiet --locked --profile dev --manifest-path crates/python/Cargo.toml --out "$wheels"
"$python" -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$wheels"/*.whl
exec "$python" hil/fci-peers/torque.py "$@"
