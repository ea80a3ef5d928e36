#!/usr/bin/env bash
# Makes every Python environment that the tests want, so that none of them waits for a package index.
set -euo pipefail

venv=$(dirname "$0")/venv.sh
# tests/identification: export_peers, consistency_peers; tests/fci/external_servers.rs
"$venv" 'pin==4.1.0' 'mujoco==3.*' 'clarabel==0.11.*' scipy 'franka-sim==1.1.7' 'franky-sim==1.0.4'
# tests/fci/fci_clients.rs
"$venv" --in libfranka-0.9 'panda-python==1.1.1'
"$venv" --in libfranka-0.21 'pylibfranka==0.21.3' 'franky-control==2.0.0'
# tests/jobs/flight_recorder.rs
"$venv" --in flight 'mcap-ros2-support==0.5.*'
# tests/jobs/schemas.rs
"$venv" --in schema 'jsonschema==4.*'
