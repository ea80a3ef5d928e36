#!/usr/bin/env bash
# Torque and model on another machine by iceoryx2's own tunnel over zenoh: two network namespaces with shared memory of their own stand for the two
# machines, with one clock, and with two whose difference is a day in either direction. Prints the age of the torque on both sides, the followed
# model, and what the client of the other side reports while the link is down.
#
#   hil/tunnel/run.sh [VALUES]           values per measurement (20000 by default)
#
# Needs root, Linux 5.6 (time namespaces), ip, unshare, nsenter, cargo, python3 with venv, and package indices that cargo and pip reach. The first call builds the tunnel, which takes
# about ten minutes of processor time.
set -euo pipefail
cd "$(dirname "$0")/../.."
values=${1:-20000}
[ "$(id -u)" = 0 ] || { echo "hil/tunnel/run.sh: needs root, for network namespaces" >&2; exit 2; }

# The version of the tunnel is that of iceoryx2 in Cargo.lock.
tunnel=target/tunnel/bin/iox2-link-tunnel-zenoh
[ -x "$tunnel" ] || cargo install --quiet --locked --root target/tunnel iceoryx2-integrations-zenoh-link-tunnel-cli --version '=0.10.0'
cargo build --quiet --locked --bin plumbline
wheels=target/python/wheels
python=$(hil/peers/venv.sh --in python 'maturin==1.*' 'numpy==2.*' 'pytest==8.*')
rm -rf "$wheels" && mkdir -p "$wheels"
"$python" -m maturin build --quiet --locked --profile dev --manifest-path crates/python/Cargo.toml --out "$wheels"
"$python" -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$wheels"/*.whl

place=$(mktemp -d) robot=tunnel-$$
declare -A holder
down() {
    local side left pids
    for left in {1..50}; do
        pids=$(for side in arm desk; do ip netns pids "plumbline-$side" 2>/dev/null || true; done)
        [ -n "$pids" ] || break
        # The daemon ends with a controlled stop.
        [ "$left" != 1 ] || kill $pids 2>/dev/null || true
        sleep 0.2
    done
    for side in arm desk; do ip netns delete "plumbline-$side" 2>/dev/null || true; done
    rm -rf "${place:?}"/*
}
trap 'down; rm -rf "$place"' EXIT

# A side: network, /dev/shm, folder of names, time since boot, and iceoryx2's configuration for the tunnel, which reads config/iceoryx2.toml where
# it is started.
side() { # SIDE [SECONDS by which its CLOCK_BOOTTIME is ahead of this machine's; this machine's own clock by default]
    local side=$1 time=${2:+--time --boottime $2}
    ip netns add "plumbline-$side"
    ip -n "plumbline-$side" link set lo up
    mkdir -p "$place/$side/run" "$place/$side/config"
    # Mirrors of the other side's services are made with these sizes: the latest value only.
    cat >"$place/$side/config/iceoryx2.toml" <<TOML
[global]
root-path = "$place/$side/run/iceoryx2"
prefix = "plumbline_0_"

[defaults.publish-subscribe]
publisher-history-size = 1
subscriber-max-buffer-size = 1
max-subscribers = 32
max-nodes = 48
TOML
    ip netns exec "plumbline-$side" unshare --mount $time sleep infinity &
    holder[$side]=$!
    sleep 0.2
    on "$side" mount -t tmpfs tmpfs /dev/shm
}

on() {
    local side=$1 pid=${holder[$1]}
    shift
    nsenter --target "$pid" --mount --net --time="/proc/$pid/ns/time_for_children" \
        env --chdir="$PWD" PLUMBLINE_RUNTIME_DIR="$place/$side/run" "$@"
}

zenoh() { # SIDE WHAT: one TCP connection, no scouting
    echo "{ mode: \"peer\", $2, scouting: { multicast: { enabled: false } } }" >"$place/$1/zenoh.json5"
}

client() { on "$1" "$python" hil/tunnel/client.py "$robot" "${@:2}"; }

case_of() { # CLOCKS [SECONDS of the arm's clock, SECONDS of the desk's]
    echo "== $1"
    side arm "${2:-}"
    side desk "${3:-}"
    ip link add arm0 netns plumbline-arm type veth peer name desk0 netns plumbline-desk
    ip -n plumbline-arm address add 10.19.0.1/24 dev arm0
    ip -n plumbline-desk address add 10.19.0.2/24 dev desk0
    ip -n plumbline-arm link set arm0 up
    ip -n plumbline-desk link set desk0 up
    zenoh arm 'listen: { endpoints: ["tcp/10.19.0.1:7447"] }'
    zenoh desk 'connect: { endpoints: ["tcp/10.19.0.1:7447"] }, listen: { endpoints: [] }'

    # Both look for new values every millisecond: with --reactive alone the other side never woke (0.10.0).
    local root=$PWD side
    for side in desk arm; do
        (cd "$place/$side" && on "$side" "$root/$tunnel" --zenoh-config "$place/$side/zenoh.json5" --poll 1 --allow "plumbline/$robot/feed-forward" \
            --allow "plumbline/$robot/model" >"$place/$side/tunnel.log" 2>&1) &
    done
    sleep 2
    # A daemon that holds the simulated arm and serves a model.
    on arm target/debug/plumbline daemon config/sim-panda-wall.toml --out "$place/out" --model config/models/panda-paper-table3.toml \
        --set "serve.id=$robot" --set backend.pace=wall-clock --set safety.max-lost=1000 --set realtime.lock-memory=false \
        --set excitation.trajectories=1 --set excitation.starts=1 --set excitation.rounds=0 --set validation.counter-experiment=false \
        >"$place/daemon.log" 2>&1 &

    local status=0
    client arm age "$values" --name "arm's machine" || status=$?
    client desk age "$values" --name "other machine, through the tunnel" || status=$?
    client desk watch 21 &
    local watch=$!
    sleep 3
    echo "link down"
    ip -n plumbline-desk link set desk0 down
    sleep 8
    echo "link up"
    ip -n plumbline-desk link set desk0 up
    wait $watch || status=$?
    [ $status = 0 ] || tail -n 20 "$place"/*/tunnel.log "$place/daemon.log" >&2
    down
    return $status
}

case_of "one clock"
case_of "the other machine's clock is a day ahead" 1000 87400
case_of "the other machine's clock is a day behind" 87400 1000
