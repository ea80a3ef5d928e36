#!/usr/bin/env python3
"""The second judge of the diagnosis: cases of MuJoCo, which share nothing with the project's own simulation.

    judge.py make  FOLDER SEED...  [--clean] [--kinds A,B] [--quick] [--settled]     datasets with truth.json
    judge.py plain SEED...                       whether arms of the plain law of friction leave nothing
    judge.py judge RESULTS --program PLUMBLINE --from SEED --count N [--clean] [--quick] [--settled] [--keep FOLDER] [--jobs N]
    judge.py again RESULTS KEPT                  scores the kept reports once more, after a change of the rules here
    judge.py table RESULTS [--cases]

Seeds below 1000 are for developing the generator, 1000 to 4999 for building the diagnosis. From 5000 on seeds belong to the judge:
nobody looks at one of those cases, and this program refuses it: it keeps no dataset and no report of them and prints totals only.
"""

import argparse
import hashlib
import json
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from multiprocessing import Pool
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(__file__).resolve().parents[2] / "target" / "study" / "compiled"))
sys.dont_write_bytecode = True

JUDGES_SEEDS = 5000
NONNEGATIVE = {"mass", "gap", "compliance", "ia", "fp"}
HARM = 1.02  # of the plain model's held-out error
OFF = (0.3, 3.0)  # a parameter outside these shares of the true one, by five deviations, is another effect: a payload of -2 kg is none
PLAIN = 0.2  # floors that the plain model may leave of an arm that has its law of friction, and no noise
UNSEEN = 2.0  # floors of an unseen run, of as many periods as it has, that "nothing-significant" must not stand beside
LIMIT = 900  # s for one diagnosis
# What the friction of an arm truly is, in small: no false finding, but on a clean arm an alarm.
OWN = {"tanh": {"coulomb-slope"}, "arctan": {"coulomb-slope", "nonlinear-viscous"}, "lugre": {"presliding"}, "maxwell": {"presliding"}, "stribeck": {"stribeck"}, "power": {"nonlinear-viscous"}}


def named(report):
    """Effects that the report names, delivered or not: id, joints, parameters, standard deviations."""
    d = report["diagnosis"]
    out, seen = [], set()
    for e in list(d["effects"]) + [e for c in d.get("changes", []) for e in c["effects"]]:
        key = json.dumps([e["id"], e["joints"], e.get("parameters")])
        if key in seen:  # a change between sessions stands in both lists
            continue
        seen.add(key)
        out.append({"id": e["id"], "joints": e["joints"], "parameters": e.get("parameters", {}), "std": e.get("std", {}),
                    "in_model": e.get("in_model"), "stratum": e.get("stratum"), "form": e.get("form", ""), "rms": e.get("torque_rms")})
    return out


def matches(effect, truth):
    if truth["families"] is None or effect["id"] not in truth["families"]:
        return False
    for stem, true in truth["parameters"].items():
        got = value_of(effect, stem)
        if got and not OFF[0] < got[0] / true < OFF[1] and abs(got[0] - true) > 5 * (got[1] or 0.0):
            return False
    if effect["id"] == "mounting" or not truth["joints"] and not truth["optional_joints"]:
        return True
    if truth["kind"] == "contact":  # the outer links are not told apart by every pose
        return bool(effect["joints"]) and abs(effect["joints"][0] - truth["joints"][0]) <= 1
    if truth["cause"] is not None:
        return sorted(effect["joints"][:2]) == sorted([truth["joints"][0], truth["cause"]])
    return bool(effect["joints"]) and (effect["joints"][0] in truth["joints"] or effect["joints"][0] in truth["optional_joints"])


def value_of(effect, stem):
    """Parameter of an effect by its stem: `offset` of `offset3`."""
    for name, value in effect["parameters"].items():
        if value is not None and re.sub(r"[_\d]*$", "", name.split("_")[0]) == stem:
            # a tight spring from above or below pulls with another sign for the same stiffness
            return (abs(value) if stem == "spring" else value), effect["std"].get(name)
    return None


def covers(report, truth, found):
    """Deviations of parameters from the truth in standard deviations: those of the effects, and the model's own."""
    effects, base = [], []
    for e, t in found:
        for stem, true in t["parameters"].items():
            got = value_of(e, stem)
            if got and got[1]:
                effects.append([f"{e['id']}.{stem}", round((got[0] - true) / got[1], 2), got[0], true])
    allowed = {"__builtins__": {}}
    for p in report["base"]["parameters"]:
        if p.get("std"):
            # `0.25 (m4 + m5)` means a product
            text = re.sub(r"([\d.])\s+([A-Za-z(])", r"\1 * \2", p["expression"])
            try:
                true = eval(text, allowed, truth["parameters"])
            except (NameError, SyntaxError, TypeError):
                continue
            low, high = p["interval_95"]
            base.append([p["name"], round((p["value"] - true) / p["std"], 2), bool(low <= true <= high)])
    return effects, base


def score(report, truth):
    """Class of one case and why."""
    d = report["diagnosis"]
    effects = named(report)
    wanted = [t for t in truth["effects"] if t["families"] is not None and t["ratio"] >= 1.0]
    outside = [t for t in truth["effects"] if t["families"] is None and t["ratio"] >= 1.0]
    known = [t for t in truth["effects"] if t["families"] is not None]
    found = [(e, next(t for t in known if matches(e, t))) for e in effects if any(matches(e, t) for t in known)]
    # a spring at rest elsewhere than at zero is a spring and an offset
    preload = {t["joints"][0] for t in known if t["kind"] == "spring"}
    false = [e for e in effects if not any(matches(e, t) for t in known) and not (e["id"] == "torque-offset" and set(e["joints"]) <= preload)]
    own = [e for e in false if e["id"] in OWN[truth["conditions"]["form"]]]
    if not truth["clean"]:
        false = [e for e in false if e not in own]
    missed = []
    for t in wanted:
        joints = {e["joints"][0] for e, u in found if u is t and e["joints"]}
        if not any(u is t for _, u in found) or (t["optional_joints"] and not set(t["joints"]) <= joints):
            missed.append(t)
    verdict = d["verdict"]
    floor = d.get("noise_floor") or []
    unexplained = [u["joint"] for u in d["unexplained"]]
    if truth["clean"] or not truth["effects"]:
        quiet = verdict in ("nothing-significant", "not-determined") and not effects
        kind = "clean: quiet" if quiet else "clean: alarm"
    elif outside and not wanted:
        kind = "outside: unexplained" if verdict in ("unexplained", "partly") and not false else "outside: named" if false else "outside: silent"
    elif not wanted:
        kind = "below: right" if found and not false else "below: quiet" if not effects and verdict in ("nothing-significant", "not-determined") else "below: alarm"
    elif not missed:
        kind = "right" if not false and (verdict in ("diagnosed", "ambiguous") or outside) else "right, beside"
    else:
        kind = "wrong" if false else "missed, part" if found else "missed"
    cover, base = covers(report, truth, found)
    unseen = 0.0
    for run in report["validate"]:
        unseen = max([unseen] + [x / y for x, y in zip(run["rms_filtered"], floor) if x and y])
    # the report's floor is that of the mean of the identified periods
    unseen *= (truth["conditions"]["unseen_periods"] / truth["conditions"]["periods"]) ** 0.5
    before, after = d["before"]["validate_rms"], d["after"]["validate_rms"]
    harm = [round(b / a, 3) for a, b in zip(before, after) if a and b]
    # the whole interval of 95 % above zero
    intervals = (d.get("change") or {}).get("intervals", [])
    surely = [round(b / a, 3) for a, b, (low, _) in zip(before, after, intervals) if a and b and low > 0]
    return {
        "class": kind, "verdict": verdict, "false": [(e["id"], e["joints"], e["form"], e["in_model"], e["rms"]) for e in false],
        "own": [(e["id"], e["joints"]) for e in own], "named": [(e["id"], e["joints"]) for e in effects], "missed": [(t["kind"], t["joints"], t["ratio"]) for t in missed],
        "unexplained": unexplained, "unseen": round(unseen, 2), "cover": cover, "base_cover": base, "harm": max(harm, default=1.0), "sure_harm": max(surely, default=1.0), "impossible": [f"{e['id']} {n}" for e in effects for n, v in e["parameters"].items()
                                                      if v is not None and v < 0 and n.rstrip("0123456789") in NONNEGATIVE],
        "floors": floor, "confirmation": d.get("confirmation"),
    }


def one(job):
    import cases
    import numpy as np

    seed, clean, quick, settled, program, keep = job
    secret = seed >= JUDGES_SEEDS
    work = Path(tempfile.mkdtemp(prefix="study-"))
    row = {"seed": seed, "clean": clean}
    try:
        begin = time.monotonic()
        truth = cases.make(seed, clean, work / "data", quick=quick, settled=settled)
        row |= {"made": round(time.monotonic() - begin, 1), "conditions": truth["conditions"], "seconds": truth["seconds"],
                "rows": truth["rows"], "kinds": [(t["kind"], t["ratio"], t["joints"]) for t in truth["effects"]]}
        begin, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        command = ["/usr/bin/env", "python3", "-c", "import resource,subprocess,sys;p=subprocess.run(sys.argv[1:],stdout=subprocess.DEVNULL);"
                   "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss);sys.exit(p.returncode)",
                   program, "diagnose", str(work / "data"), "--out", str(work / "out")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        row |= {"wall": round(time.monotonic() - begin, 2), "cpu": round(after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime, 2),
                "megabytes": int(done.stdout.split()[-1]) // 1024 if done.stdout.split() else None}
        if done.returncode:
            row |= {"class": "failed", "message": done.stderr.strip()[-300:]}
        else:
            row |= score(json.loads((work / "out" / "report.json").read_text()), truth)
        if keep and not secret:
            target = Path(keep) / f"{seed}{'-clean' if clean else ''}"
            shutil.rmtree(target, ignore_errors=True)
            target.mkdir(parents=True)
            for name in ("data/truth.json", "data/dataset.toml", "out/report.json"):
                if (work / name).exists():
                    shutil.copy(work / name, target)
    except (FloatingPointError, np.linalg.LinAlgError) as error:
        row |= {"class": "not simulated", "message": str(error)}
    except subprocess.TimeoutExpired:
        row |= {"class": "failed", "message": f"no result in {LIMIT} s"}
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return row


def plain(args):
    """Fails where the engine's motion and torques contradict the law that it was given: then every case has an effect that nobody meant."""
    import cases

    worst = 0.0
    for seed in args.seeds:
        case = cases.draw(seed, True)
        cases.plain_law(case.table)
        model = cases.Plain(case)
        left = model.ratios(model.unmodelled(cases.simulate(case, []))).max()
        print(f"seed {seed}, {case.arm.name}: {left:.3f} floors")
        worst = max(worst, left)
    sys.exit(f"judge.py plain: the plain model leaves {worst:.2f} floors of its own law, expected at most {PLAIN}" if worst > PLAIN else 0)


def judge(args):
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=Path(__file__).parent).stdout.strip()
    version = subprocess.run([args.program, "--version"], capture_output=True, text=True).stdout.strip()
    program = hashlib.sha256(Path(args.program).read_bytes()).hexdigest()[:10]
    jobs = [(s, args.clean, args.quick, args.settled, args.program, args.keep) for s in range(args.first, args.first + args.count)]
    done = 0
    Path(args.results).parent.mkdir(parents=True, exist_ok=True)
    with Pool(args.jobs) as pool, open(args.results, "a") as file:
        for row in pool.imap_unordered(one, jobs):
            row |= {"commit": args.commit or commit, "version": version, "program": program}
            file.write(json.dumps(row, default=str) + "\n")
            file.flush()
            done += 1
            if row["seed"] < JUDGES_SEEDS:
                print(f"{done}/{len(jobs)} seed {row['seed']} {row['class']}: truth {row.get('kinds')}, {row.get('verdict')}, "
                      f"false {row.get('false')}, unexplained {row.get('unexplained')}", flush=True)


def again(args):
    rows = [json.loads(line) for line in Path(args.results).read_text().splitlines()]
    for row in rows:
        kept = Path(args.kept) / f"{row['seed']}{'-clean' if row['clean'] else ''}"
        if (kept / "report.json").exists():
            row |= score(json.loads((kept / "report.json").read_text()), json.loads((kept / "truth.json").read_text()))
    Path(args.results).write_text("".join(json.dumps(row, default=str) + "\n" for row in rows))


def share(part, whole):
    return f"{part} of {whole}" + (f" ({100 * part / whole:.0f} %)" if whole else "")


def table(args):
    rows = [json.loads(line) for line in Path(args.results).read_text().splitlines()]
    secret = [r for r in rows if r["seed"] >= JUDGES_SEEDS]
    if args.cases and secret:
        sys.exit(f"judge.py table --cases: seeds from {JUDGES_SEEDS} on are the judge's, and only totals of them are shown")
    good = [r for r in rows if r["class"] not in ("failed", "not simulated")]
    seeds = sorted(r["seed"] for r in rows)
    print(f"seeds {seeds[0]} to {seeds[-1]}, {len(rows)} cases, commit {', '.join(sorted({r['commit'] for r in rows}))}, "
          f"program {', '.join(sorted({r.get('program', '-') for r in rows}))}, "
          f"{sum(r.get('seconds', 0) for r in rows) / max(len(rows), 1):.0f} s of motion each")
    print("classes:", dict(Counter(r["class"] for r in rows)))
    failed = Counter(r.get("message", "") for r in rows if r["class"] == "failed")
    if failed and not secret:
        print("failed:", dict(failed))
    detectable = [r for r in good if r["class"] in ("right", "right, beside", "missed", "missed, part", "wrong")]
    right = sum(r["class"] == "right" for r in detectable)
    print(f"right family and joint, nothing false beside: {share(right, len(detectable))}; "
          f"with something beside: {sum(r['class'] == 'right, beside' for r in detectable)}")
    clean = [r for r in good if r["class"].startswith("clean")]
    print(f"alarms on clean arms: {share(sum(r['class'] == 'clean: alarm' for r in clean), len(clean))}")
    for what, key in (("friction form", "form"), ("rate", "rate"), ("arm", "kind"), ("repeating", "repeating"), ("periods", "periods"),
                      ("start", "start"), ("settled", "settled"), ("motion", "style")):
        groups = defaultdict(list)
        for r in good:
            groups[str(r["conditions"].get(key))].append(r)
        print(f"by {what}:")
        for name, group in sorted(groups.items()):
            some = [r for r in group if r in detectable]
            quiet = [r for r in group if r["class"].startswith("clean")]
            print(f"  {name:10} right {share(sum(r['class'] == 'right' for r in some), len(some)):18} "
                  f"alarms {share(sum(r['class'] == 'clean: alarm' for r in quiet), len(quiet))}")
    print("by kind, one effect of a ratio of 1 or more:")
    kinds = defaultdict(Counter)
    for r in good:
        if len(r["kinds"]) == 1 and not r["class"].startswith(("clean", "below")):
            kinds[r["kinds"][0][0]][r["class"]] += 1
    for name, classes in sorted(kinds.items()):
        print(f"  {name:18} {dict(classes)}")
    by_cause = Counter(f[0] for r in clean for f in {tuple(map(str, f)) for f in r["false"]})
    print("named on clean arms:", dict(by_cause), "; unexplained joints in", sum(bool(r["unexplained"]) for r in clean))
    alone = sum(bool(r["own"]) and len(r["own"]) == len(r["named"]) and not r["unexplained"] for r in clean)
    print(f"named by their own friction law: {sum(bool(r['own']) for r in good if not r['class'].startswith('clean'))} arms with effects, clean arms with an alarm of nothing else {alone}")
    print("verdicts on clean arms:", dict(Counter(r["verdict"] for r in clean)))
    print("named falsely beside effects:", dict(Counter(f[0] for r in good if not r["class"].startswith("clean") for f in r["false"])))
    impossible = Counter(i for r in good for i in r["impossible"])
    print("named with a negative size that cannot be:", dict(impossible))
    silent = [r for r in good if r["verdict"] == "nothing-significant" and r["unseen"] > UNSEEN]
    print(f"nothing-significant with an unseen run above {UNSEEN} floors: {share(len(silent), sum(r['verdict'] == 'nothing-significant' for r in good))}")
    for name, key, at in (("effects", "cover", 1), ("base parameters", "base_cover", 1)):
        z = [abs(c[at]) for r in good for c in r[key]]
        if z:
            print(f"cover of {name}: {share(sum(x <= 3 for x in z), len(z))} within 3 standard deviations, "
                  f"{share(sum(x <= 1.96 for x in z), len(z))} within 1.96")
    held = [c[2] for r in good for c in r["base_cover"]]
    if held:
        print(f"intervals of 95 % that hold the true base parameter: {share(sum(held), len(held))}")
    for key, beyond in (("harm", ""), ("sure_harm", ", and by more than the interval of 95 % allows")):
        worse = [r for r in good if r.get(key, 1.0) > HARM]
        print(f"a joint worse than plain by more than {100 * (HARM - 1):.0f} % on held-out data{beyond}: {share(len(worse), len(good))}")
    if good:
        walls = [r["wall"] for r in good]
        print(f"time of a diagnosis: median {statistics.median(walls):.1f} s, most {max(walls):.1f} s; memory: most {max(r['megabytes'] or 0 for r in good)} MB; "
              f"generator: median {statistics.median(r['made'] for r in good):.1f} s")
    if args.cases:
        for r in sorted(rows, key=lambda r: (r["class"], r["seed"])):
            print(r["seed"], r["class"], r.get("kinds"), r.get("verdict"), "false", r.get("false"), "missed", r.get("missed"), "unexplained",
                  r.get("unexplained"), "unseen", r.get("unseen"), "harm", r.get("harm"), r.get("message", ""),
                  {k: r["conditions"][k] for k in ("arm", "rate", "form", "periods", "style", "start")} if "conditions" in r else "")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("make")
    make.add_argument("folder")
    make.add_argument("seeds", type=int, nargs="+")
    make.add_argument("--kinds")
    law = commands.add_parser("plain")
    law.add_argument("seeds", type=int, nargs="+")
    verdict = commands.add_parser("judge")
    verdict.add_argument("results")
    verdict.add_argument("--program", required=True)
    verdict.add_argument("--from", dest="first", type=int, required=True)
    verdict.add_argument("--count", type=int, required=True)
    verdict.add_argument("--keep", help="folder for truth and report of each case")
    verdict.add_argument("--jobs", type=int, default=os.cpu_count())
    verdict.add_argument("--commit", help="of the program, where it is not the checked-out one")
    for p in (make, verdict):
        p.add_argument("--clean", action="store_true")
        p.add_argument("--quick", action="store_true", help="three periods of 5 s, two motions: for CI")
        p.add_argument("--settled", action="store_true", help="record repeating runs from their second period on")
    more = commands.add_parser("again")
    more.add_argument("results")
    more.add_argument("kept")
    show = commands.add_parser("table")
    show.add_argument("results")
    show.add_argument("--cases", action="store_true", help="each case; not with seeds of the judge")
    args = parser.parse_args()
    if max(getattr(args, "seeds", [0])) >= JUDGES_SEEDS:
        sys.exit(f"judge.py {args.command}: seeds from {JUDGES_SEEDS} on are the judge's; nobody looks at one of those cases")
    if args.command == "make":
        import cases

        for seed in args.seeds:
            truth = cases.make(seed, args.clean, Path(args.folder) / str(seed), args.kinds.split(",") if args.kinds else None, args.quick, args.settled)
            print(seed, truth["conditions"], "unmodelled", truth["unmodelled"], [(e["kind"], e["joints"], e["ratio"]) for e in truth["effects"]])
    elif args.command == "plain":
        plain(args)
    elif args.command == "judge":
        judge(args)
    elif args.command == "again":
        again(args)
    else:
        table(args)


if __name__ == "__main__":
    main()
