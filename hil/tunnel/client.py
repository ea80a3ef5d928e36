"""A client of the torque and of the model on one side of the tunnel: called by run.sh.

    client.py ROBOT age VALUES       age of that many values when they arrive, and the followed model
    client.py ROBOT watch SECONDS    what changes meanwhile; exit code 1 unless the values stopped and came again
"""

import argparse
import sys
import time

import numpy as np

import plumbline


def age(feed_forward, values, name, robot):
    model = plumbline.Model.follow(robot, timeout=30)
    ages, last, lost = [], None, 0
    end = time.monotonic() + 30 + 5e-3 * values
    while len(ages) < values:
        latest = feed_forward.latest()
        if latest is not None and (last is None or latest.sequence > last):
            lost += 0 if last is None else latest.sequence - last - 1
            last = latest.sequence
            ages.append(latest.age)
        elif time.monotonic() > end:
            sys.exit(f"{name}: {len(ages)} of {values} values, {lost} lost")
    p50, p99, p999, most = (1e3 * np.quantile(ages, share) for share in (0.5, 0.99, 0.999, 1.0))
    status = model.status()
    print(
        f"{name}: age of the torque p50 {p50:.3f}, p99 {p99:.3f}, p99.9 {p999:.3f}, max {most:.3f} ms; {lost} of {values + lost} values"
        f" lost; model {status.model:016x} {status.validity}",
        flush=True,
    )


def watch(feed_forward, seconds):
    """Prints every change of what the client reports."""
    begin, before, seen = time.monotonic(), None, []
    while time.monotonic() < begin + seconds:
        latest = feed_forward.latest()
        now = "no value" if latest is None else "STALE" if latest.stale else latest.validity
        if now != before:
            age = "" if latest is None else f", age {1e3 * latest.age:.1f} ms, value {latest.sequence}"
            running = "runs" if feed_forward.running else "is gone"
            # A value late by the machine's own pauses is no news.
            seen.append((time.monotonic(), f"{time.monotonic() - begin:7.3f} s  {now}{age}; the publisher {running}"))
            before = now
        time.sleep(0.0002)
    lasting = [one for one, after in zip(seen, [*seen[1:], (float("inf"), "")]) if after[0] - one[0] > 0.2]
    print("\n".join(text for _, text in lasting))
    stopped = [k for k, (_, text) in enumerate(lasting) if "STALE" in text]
    sys.exit(0 if stopped and stopped[-1] < len(lasting) - 1 else 1)


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
        watch(feed_forward, options.amount)


main()
