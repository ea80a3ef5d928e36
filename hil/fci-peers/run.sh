#!/usr/bin/env bash
# Clients of other origin against the emulator of Franka's control interface, and what each of them did, into docs/results/franka-clients.md.
#
#   hil/fci-peers/run.sh [--only PART-OF-A-NAME] [--command-wait MS]
#
# Needs cargo, a C compiler, python3 with venv, and a package index that pip reaches. FCI_EMULATOR names a built emulator; otherwise
# one is built. With --only the table is left as it is. Exit code 1 where a cell says that something failed.
set -euo pipefail
cd "$(dirname "$0")/../.."

emulator=${FCI_EMULATOR:-}
if [ -z "$emulator" ]; then
    cargo build --release --locked --example fci-emulator
    emulator=${CARGO_TARGET_DIR:-target}/release/examples/fci-emulator
fi

library=$(mktemp -d)
trap 'rm -rf "$library"' EXIT
cc -shared -fPIC -O1 -Wall -Wextra -Werror -o "$library/libfcimodels.so" hil/fci-peers/model_library.c -lm

hil/peers/venv.sh --in libfranka-0.9 panda-python==1.1.1 >/dev/null
hil/peers/venv.sh --in libfranka-0.15 franky-control==1.1.2 >/dev/null
hil/peers/venv.sh --in libfranka-0.21 pylibfranka==0.21.3 franky-control==2.0.0 >/dev/null
hil/peers/venv.sh --in franka-rs franka-rs==0.4.0 numpy >/dev/null

table=(--table docs/results/franka-clients.md)
for argument in "$@"; do [ "$argument" = --only ] && table=(); done
python3 hil/fci-peers/drive.py "$emulator" --library "$library/libfcimodels.so" --venvs target/peers "${table[@]}" "$@"
