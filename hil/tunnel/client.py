"""A client of the torque and of the model on one side of the tunnel: called by run.sh.

    client.py ROBOT age VALUES       the followed model, evaluated, and the age of that many values when they arrive
    client.py ROBOT watch SECONDS    what changes meanwhile; exit code 1 unless values and daemon went and came again
"""

import argparse
import sys
import time

import numpy as np

import plumbline


def age(feed_forward, values, name, robot):
    begin = time.monotonic()
    model = plumbline.Model.follow(robot, timeout=30)
    status, waited = model.status(), time.monotonic() - begin
    ages, last, lost = [], None, 0
    end = time.monotonic() + 30 + 5e-3 * values
    while len(ages) < values:
        latest = feed_forward.latest()
        if latest is not None and (last is None or latest.sequence > last.sequence):
            lost += 0 if last is None else latest.sequence - last.sequence - 1
            last = latest
            ages.append(latest.age)
        elif time.monotonic() > end:
            sys.exit(f"{name}: {len(ages)} of {values} values, {lost} lost")
    p50, p99, p999, most = (1e3 * np.quantile(ages, share) for share in (0.5, 0.99, 0.999, 1.0))
    print(
        f"{name}: age of the torque p50 {p50:.3f}, p99 {p99:.3f}, p99.9 {p999:.3f}, max {most:.3f} ms; {lost} of {values + lost} values lost",
        flush=True,
    )
    if status.model == 0:
        sys.exit(f"{name}: no model")
    # The arm holds its position: the served torque is the model's at rest.
    rest = np.zeros_like(last.q_d)
    error = np.abs(model.torque(last.q_d, rest, rest) - last.tau).max()
    print(f"{name}: model {status.model:016x} {status.validity} {waited:.2f} s after the call; its torque {error:.1e} Nm from the served one", flush=True)
    if last.phase != "hold" or last.model != status.model or not error < 1e-9:
        sys.exit(f"{name}: another torque than the served one: {last}")


def watch(feed_forward, seconds, robot):
    """Prints every change of what the client reports."""
    model = plumbline.Model.follow(robot, timeout=30)
    begin, before, seen = time.monotonic(), None, []
    while time.monotonic() < begin + seconds:
        latest = feed_forward.latest()
        torque = "no value" if latest is None else "STALE" if latest.stale else latest.validity
        try:
            model.check_daemon()
            daemon = "the daemon is followed"
        except plumbline.errors.DaemonGone as error:
            daemon = str(error)
        if (torque, daemon) != before:
            age = "" if latest is None else f", age {1e3 * latest.age:.1f} ms, value {latest.sequence}"
            now = time.monotonic()
            seen.append((now, torque, daemon, f"{now - begin:7.3f} s  torque {torque}{age}; model {model.status().model:016x}: {daemon}"))
            before = torque, daemon
        time.sleep(0.0002)
    # A value late by the machine's own pauses is no news.
    lasting = [one for one, after in zip(seen, [*seen[1:], (float("inf"),)]) if after[0] - one[0] > 0.2]
    print("\n".join(text for *_, text in lasting))
    down = [k for k, (_, torque, daemon, _) in enumerate(lasting) if torque == "STALE" and "sends nothing" in daemon]
    back = lasting[-1][1] != "STALE" and "sends nothing" not in lasting[-1][2]
    sys.exit(0 if down and back else 1)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("robot")
    parser.add_argument("what", choices=["age", "watch"])
    parser.add_argument("amount", type=float)
    parser.add_argument("--name", default="client")
    options = parser.parse_args()
    feed_forward = plumbline.FeedForward(options.robot, stale_after=0.05, timeout=60)
    if options.what == "age":
        age(feed_forward, int(options.amount), options.name, options.robot)
    else:
        watch(feed_forward, options.amount, options.robot)


main()
