#!/usr/bin/env python3
"""The live watch on the second engine: an arm of MuJoCo is identified, then watched along an unseen motion in which steps come and go.

    serving.py RESULTS --replay PROGRAM --from SEED --count N [--clean] [--keep FOLDER] [--jobs N]

PROGRAM is the test `estimator::live::replay` of the package, as serving.sh builds it. Seeds as in judge.py: from 5000 on totals only.
"""

import argparse
import json
import math
import os
import shutil
import statistics
import subprocess
import tempfile
from multiprocessing import Pool
from pathlib import Path

from judge import JUDGES_SEEDS, share

TEST = "estimator::live::replay::a_recorded_motion_is_watched"
DETECTED, NAMED, IN_TIME = 1.0, 5.0, 0.3  # s after a change, and s that its begin may be off
USUAL = 1.3  # ratio of the error once a change was served, to that before anything came
RECOVERED = 20.0  # s after it


def error(log, begin, end, before):
    """Worst joint's RMS in the band under the served model, over its own before anything came."""
    def of(begin, end):
        some = [s["rms"] for s in log["stretches"] if s["start"] >= begin and s["end"] <= end]
        return [math.sqrt(statistics.mean(x * x for x in joint)) for joint in zip(*some)] if some else []
    return max((now / usual for now, usual in zip(of(begin, end), of(*before))), default=math.nan)


def seen(log, at, end, before, expected):
    """One change: events from `at` to `end`; `expected` is its effect in truth.json, or none where the arm is as it was."""
    own = [e for e in log["events"] if at <= e["t"] < end and e.get("since", at) > at - 1.0]
    lost = [e for e in own if e["event"] == "lost"]
    proposed = [e for e in own if e["event"] == "proposed"]

    def right(event):
        if expected is None:
            return event["what"].startswith("as it was")
        effects = event["effects"]
        return len(effects) == 1 and effects[0]["id"] in expected["families"] and (not expected["joints"] or effects[0]["joints"] == expected["joints"])
    named_at = proposed[0]["t"] if proposed else math.inf
    off = None
    payload = proposed[-1]["effects"][0] if proposed and proposed[-1]["effects"] else None
    # Another effect may be the same torque.
    if expected and payload and right(proposed[-1]) and "mass" in expected["parameters"] and "mass" in payload["parameters"]:
        true = expected["parameters"]["mass"]
        off = [(payload["parameters"]["mass"] - true) / payload["std"]["mass"], payload["parameters"]["mass"] / true - 1]
    return {
        "kind": expected["kind"] if expected else "gone", "ratio": expected["ratio"] if expected else None,
        "detected": bool(lost) and lost[0]["t"] - at < DETECTED, "alarm": bool(lost),
        "named": named_at - at < NAMED and all(map(right, proposed)), "late": bool(proposed) and right(proposed[-1]),
        "in_time": bool(proposed) and abs(proposed[-1]["since"] - at) < IN_TIME, "alarms": sum(e["t"] > named_at for e in lost),
        "error": error(log, at + min(RECOVERED, 0.7 * (end - at)), end, before), "mass": off,
        "said": [[round(e["t"] - at, 2), e["event"], round(e["since"] - at, 3) if "since" in e else None, e.get("what")] for e in own],
    }


def score(log, truth):
    steps = [(e, *e["when"][0][1:]) for e in truth["effects"]]
    last = log["stretches"][-1]["end"] if log["stretches"] else 0.0
    first = steps[0][1] if steps else last
    early = [e for e in log["events"] if e["event"] in ("lost", "proposed") and e["t"] < first]
    row = {"before": [[e["event"], round(e["t"], 2), e.get("joint"), e.get("what")] for e in early], "watched": first, "changes": []}
    times = sorted([begin for _, begin, _ in steps] + [end for _, _, end in steps if end < last]) + [last]
    for at, until in zip(times, times[1:]):
        expected = next((e for e, begin, _ in steps if begin == at), None)
        row["changes"].append(seen(log, at, until, (0.0, first - 0.5), expected))
    return row


def one(job):
    import cases
    import numpy as np

    seed, clean, program, keep = job
    work = Path(tempfile.mkdtemp(prefix="serving-"))
    row = {"seed": seed, "clean": clean}
    try:
        truth = cases.make(seed, clean, work, served=True)
        row["conditions"] = truth["conditions"]
        done = subprocess.run([program, "--ignored", "--exact", TEST], env=os.environ | {"PLUMBLINE_SERVED_CASE": str(work)}, capture_output=True, text=True)
        if done.returncode or "1 passed" not in done.stdout:
            row["failed"] = done.stdout[-400:] or "no test ran"
        else:
            row |= score(json.loads((work / "live" / "live.json").read_text()), truth)
        if keep and seed < JUDGES_SEEDS:
            target = Path(keep) / f"{seed}{'-clean' if clean else ''}"
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(work, target)
    except (FloatingPointError, np.linalg.LinAlgError) as problem:
        row["failed"] = f"not simulated: {problem}"
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return row


def table(rows):
    failed = [r for r in rows if "failed" in r]
    good = [r for r in rows if "failed" not in r]
    changes = [c for r in good for c in r["changes"]]
    print(f"seeds {min(r['seed'] for r in rows)} to {max(r['seed'] for r in rows)}: {len(good)} arms watched for {sum(r['watched'] for r in good) / 3600:.2f} h "
          f"before a change, {len(failed)} failed; alarms there {sum(len([e for e in r['before'] if e[0] == 'lost']) for r in good)} "
          f"on {sum(bool(r['before']) for r in good)} arms")
    for kind in sorted({c["kind"] for c in changes}) + ["all"] * bool(changes):
        some = [c for c in changes if kind in ("all", c["kind"])]
        named = [c for c in some if c["named"]]
        masses = [c["mass"] for c in some if c["mass"]]
        print(f"{kind}: detected within {DETECTED:.0f} s {share(sum(c['detected'] for c in some), len(some))}, at all {sum(c['alarm'] for c in some)}; named right within "
              f"{NAMED:.0f} s and ever since {share(len(named), len(some))}, in the end {sum(c['late'] for c in some)}; of the first within {IN_TIME} s "
              f"{sum(c['in_time'] for c in named)}, without an alarm after it {sum(not c['alarms'] for c in named)}; usual error after "
              f"{sum(c['error'] < USUAL for c in some)}" + (f"; masses within 2 deviations {sum(abs(z) < 2 for z, _ in masses)} of {len(masses)}, "
              f"within 1 % {sum(abs(x) < 0.01 for _, x in masses)}" if masses else ""))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results")
    parser.add_argument("--replay", required=True)
    parser.add_argument("--from", dest="first", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--clean", action="store_true")
    parser.add_argument("--keep", help="folder for the data and log of each case")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    args = parser.parse_args()
    rows = []
    with Pool(args.jobs) as pool, open(args.results, "a") as file:
        for row in pool.imap_unordered(one, [(s, args.clean, args.replay, args.keep) for s in range(args.first, args.first + args.count)]):
            file.write(json.dumps(row, default=str) + "\n")
            file.flush()
            rows.append(row)
            if row["seed"] < JUDGES_SEEDS:
                print(row["seed"], row["conditions"]["arm"] if "conditions" in row else "", row.get("failed", ""), "before:", row.get("before"), flush=True)
                for c in row.get("changes", []):
                    print("   ", "ok  " if c["named"] and c["in_time"] and not c["alarms"] else "MISS", c["kind"], c["ratio"], f"error {c['error']:.2f} mass {c['mass']}", c["said"], flush=True)
    table(rows)


if __name__ == "__main__":
    main()
