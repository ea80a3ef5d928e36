#!/usr/bin/env python3
"""How much of the plain model's residual could be predicted at all, and how much of that named effects and empirical terms take.

    learner.py --program PLUMBLINE DATASET...        (without datasets: every folder of ../shared/data)

Per joint, on data that no fit has seen (runs of role `validate`, else the last 40 % of each run), as shares of the plain model's squared error:

learned   gradient boosting on q, dq, ddq, sign(dq), time and displacement since the joint's last reversal, for the residual of
          the model of `plumbline identify`; its size is chosen by cross-validation over contiguous blocks of the identification data alone
named     the delivered model of `plumbline diagnose` with its named effects alone: its file without the terms `empirical`
both      the delivered model, empirical terms included
fixed     without any search: Dahl states of 0.1, 0.5 and 2 mrad and sign(dq) |tau_rb| in every joint, fitted with the plain model here;
          its share is of a plain model that is fitted here in the same way

Both models' torques come from `plumbline predict`. Residuals and predictions pass the same zero-phase low-pass. The diagnosis uses a part of
the unseen runs to accept findings, the learner none.
"""

import argparse
import csv
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(__file__).resolve().parents[2] / "target" / "study" / "compiled"))
sys.dont_write_bytecode = True

import numpy as np
from scipy.linalg import qr
from scipy.signal import butter, sosfiltfilt
from sklearn.ensemble import HistGradientBoostingRegressor

import arms
import rigid

CUTOFF = 4.0  # Hz
REACHES = (1e-4, 5e-4, 2e-3)
SIZES = ((4, 30), (8, 60), (16, 120))  # leaves, trees
BLOCKS = 6


def read(path):
    with open(path) as file:
        names = next(csv.reader(file))
    data = np.loadtxt(path, delimiter=",", skiprows=1)
    return {name: data[:, k] for k, name in enumerate(names)}


def joint_columns(data, stem, n):
    return np.column_stack([data[f"{stem}{i + 1}"] for i in range(n)])


def low_pass(x, rate):
    sos = butter(4, min(CUTOFF, 0.4 * rate), fs=rate, output="sos")
    return sosfiltfilt(sos, x, axis=0)


def since_reversal(t, q, dq):
    """Time and displacement since the joint last turned, per joint."""
    time, way = np.zeros_like(q), np.zeros_like(q)
    for j in range(q.shape[1]):
        last = 0
        for k in range(1, len(t)):
            if dq[k, j] * dq[k - 1, j] < 0:
                last = k
            time[k, j], way[k, j] = t[k] - t[last], q[k, j] - q[last, j]
    return np.minimum(time, 5.0), way


def load_run(folder, run, n, gain):
    raw = read(folder / run["file"])
    keep = np.concatenate([[True], np.diff(raw["t"]) > 0])
    t = raw["t"][keep]
    even = np.arange(t[0], t[-1], np.median(np.diff(t)))
    rate = 1 / (even[1] - even[0])
    on = lambda x: np.column_stack([np.interp(even, t, x[keep, j]) for j in range(n)])
    sos = butter(4, min(10.0, 0.4 * rate), fs=rate, output="sos")
    q = sosfiltfilt(sos, on(joint_columns(raw, "q", n)), axis=0)
    dq = np.gradient(q, 1 / rate, axis=0)
    return {"t": even, "rate": rate, "q": q, "dq": dq, "ddq": np.gradient(dq, 1 / rate, axis=0),
            "tau": on(joint_columns(raw, "tau", n)) * gain, "on": on, "role": run.get("role", "identify"), "file": run["file"]}


def predict(program, model, path, n, work):
    out = work / "predicted.csv"
    done = subprocess.run([program, "predict", str(model), str(path), "--out", str(out)], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"predict {model.name} {path.name}: {done.stderr.strip()[-300:]}")
    data = read(out)
    return joint_columns(data, "tau", n), data["at_end"]


def without_empirical(text):
    """A model file without learned terms, and without what was computed for all of its parameters together."""
    gone = lambda block: block.startswith(("[uncertainty]", "[consistent")) or 'id = "empirical"' in block
    kept = "\n\n".join(block for block in text.split("\n\n") if not gone(block))
    return "\n".join(line for line in kept.split("\n") if not line.startswith("content = ")) + "\n"


def dahl(q, reach):
    """States of elastic contact that yield at a displacement, -1 to 1."""
    z = np.zeros_like(q)
    for k in range(1, len(q)):
        step = (q[k] - q[k - 1]) / reach
        s = np.sign(step)
        z[k] = s + (z[k - 1] - s) * np.exp(-np.abs(step))
    return z


def fixed_set(arm, gravity, runs, identify, unseen):
    """Unseen squared errors per joint of a plain model and of one with the fixed friction set, both fitted here."""
    n = arm.n
    rng = np.random.default_rng(0)
    probe = np.empty((60, n, 10 * n))
    rigid.regressor(arm.dh, gravity, np.arange(10 * n), *rng.normal(size=(3, 60, n)), probe)
    _, r, order = qr(probe.reshape(60 * n, -1), mode="economic", pivoting=True)
    base = np.sort(order[: int((np.abs(np.diag(r)) > 1e-8 * abs(r[0, 0])).sum())])
    wanted = np.full(10 * n, -1)
    wanted[base] = np.arange(len(base))
    errors, tau_rb = [], None
    for extra in (False, True):
        blocks = []
        for k, run in enumerate(runs):
            y = np.empty((len(run["t"]), n, len(base)))
            rigid.regressor(arm.dh, gravity, wanted, run["q"], run["dq"], run["ddq"], y)
            own = [np.tanh(100 * run["dq"]), run["dq"], np.ones_like(run["dq"])] + ([run["ddq"]] if arm.sensing == "motor" else [])
            if extra:
                own += [dahl(run["q"], reach) for reach in REACHES] + [np.tanh(100 * run["dq"]) * np.abs(tau_rb[k])]
            full = np.zeros((len(run["t"]), n, len(base) + n * len(own)))
            full[:, :, : len(base)] = low_pass(y, run["rate"])
            for m, x in enumerate(own):
                x = low_pass(x, run["rate"])
                for i in range(n):
                    full[:, i, len(base) + m * n + i] = x[:, i]
            blocks.append((full, low_pass(run["tau"], run["rate"]), y))
        weight = np.ones(n)
        for _ in range(3):
            w = np.concatenate([(b[0][identify[k]] * weight[:, None]).reshape(-1, b[0].shape[-1]) for k, b in enumerate(blocks)])
            y = np.concatenate([(b[1][identify[k]] * weight).ravel() for k, b in enumerate(blocks)])
            size = np.linalg.norm(w, axis=0) + 1e-12
            beta = np.linalg.lstsq(w / size, y, rcond=1e-8)[0] / size
            rest = np.concatenate([(b[1] - b[0] @ beta)[identify[k]] for k, b in enumerate(blocks)])
            weight = 1 / rest.std(axis=0)
        tau_rb = [b[2] @ beta[: len(base)] for b in blocks]
        left = np.concatenate([(b[1] - b[0] @ beta)[unseen[k]] for k, b in enumerate(blocks)])
        errors.append((left**2).mean(axis=0))
    return errors


def learn(features, target, groups, unseen):
    """Predictions for the unseen rows by boosting whose size was chosen over contiguous blocks."""
    best = (np.inf, None)
    for leaves, trees in SIZES:
        loss = 0.0
        for block in range(BLOCKS):
            hold = groups == block
            model = HistGradientBoostingRegressor(max_leaf_nodes=leaves, max_iter=trees, learning_rate=0.08, min_samples_leaf=80, random_state=0)
            loss += ((model.fit(features[~hold], target[~hold]).predict(features[hold]) - target[hold]) ** 2).sum()
        best = min(best, (loss, (leaves, trees)), key=lambda pair: pair[0])
    # nothing, where the blocks themselves are predicted best by nothing
    if best[0] >= (target**2).sum():
        return np.zeros(len(unseen))
    leaves, trees = best[1]
    model = HistGradientBoostingRegressor(max_leaf_nodes=leaves, max_iter=trees, learning_rate=0.08, min_samples_leaf=80, random_state=0)
    return model.fit(features, target).predict(unseen)


def dataset(program, folder):
    about = tomllib.loads((folder / "dataset.toml").read_text())
    robot = about["robot"]
    arm = arms.load(folder / robot, "log") if robot.endswith(".toml") else arms.shipped(robot, "log")
    n = arm.n
    gain = np.array(about.get("torque", {}).get("gain", np.ones(n)))
    gravity = arms.gravity_vector(about["mounting"]["rho"], about["mounting"]["phi"])
    runs = [load_run(folder, run, n, gain) for run in about["run"]]
    held = any(run["role"] == "validate" for run in runs)
    with tempfile.TemporaryDirectory(prefix="learner-") as scratch:
        work = Path(scratch)
        for command, key in (("identify", "plain"), ("diagnose", "both")):
            done = subprocess.run([program, command, str(folder), "--out", str(work / key)], capture_output=True, text=True)
            if done.returncode:
                print(f"{folder.name}: no {command}: {done.stderr.strip()[-300:]}")
                return []
        (work / "named").mkdir()
        (work / "named" / "model.toml").write_text(without_empirical((work / "both" / "model.toml").read_text()))
        for run in runs:
            for key in ("plain", "named", "both"):
                model = work / key / "model.toml"
                tau, _ = predict(program, model, folder / run["file"], n, work)
                run[key] = run["on"](tau)
    identify, unseen = [], []
    for run in runs:
        count = len(run["t"])
        edge = int(0.3 * run["rate"])
        moving = (np.abs(run["dq"]) > 0.01).any(axis=1)
        moving[:edge] = moving[count - edge :] = False
        first = np.arange(count) < (count if held else int(0.6 * count))
        identify.append(moving & first if run["role"] == "identify" else np.zeros(count, bool))
        unseen.append(moving if run["role"] == "validate" else moving & ~first)
    plain_here, fixed = fixed_set(arm, gravity, runs, identify, unseen)
    gather = lambda key, mask: np.concatenate([low_pass(run["tau"] - run[key], run["rate"])[m] for run, m in zip(runs, mask)])
    features = []
    for run in runs:
        time, way = since_reversal(run["t"], run["q"], run["dq"])
        features.append(np.hstack([run["q"], run["dq"], run["ddq"], np.sign(run["dq"]), time, way]))
    known = np.concatenate([x[m] for x, m in zip(features, identify)])
    new = np.concatenate([x[m] for x, m in zip(features, unseen)])
    thin = max(1, len(known) // 20000)
    groups = np.arange(len(known)) * BLOCKS // len(known)
    train, test, named, both = gather("plain", identify), gather("plain", unseen), gather("named", unseen), gather("both", unseen)
    rows = []
    for j in range(n):
        learned = test[:, j] - learn(known[::thin], train[::thin, j], groups[::thin], new)
        square = (test[:, j] ** 2).mean()
        rows.append({"log": folder.name, "joint": j + 1, "plain": square**0.5, "learned": 1 - (learned**2).mean() / square,
                     "named": 1 - (named[:, j] ** 2).mean() / square, "both": 1 - (both[:, j] ** 2).mean() / square, "fixed": 1 - fixed[j] / plain_here[j], "plain_here": plain_here[j] ** 0.5})
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", required=True)
    parser.add_argument("datasets", nargs="*")
    args = parser.parse_args()
    root = Path(__file__).resolve().parents[2]
    folders = [Path(d) for d in args.datasets] or sorted(p.parent for p in (root.parent / "shared" / "data").glob("*/dataset.toml"))
    if not folders:
        print("learner.py: NO REAL LOGS: ../shared/data is absent, so that nothing was measured")
        return
    every = []
    print(f"{CUTOFF} Hz; shares of the plain model's squared error on unseen data; plain: RMS in Nm of plumbline identify (fitted here)")
    for folder in folders:
        rows = dataset(args.program, folder)
        every += rows
        for r in rows:
            print(f"{r['log']:16} joint {r['joint']}  plain {r['plain']:9.3f} ({r['plain_here']:9.3f})  learned {r['learned']:6.2f}  "
                  f"named {r['named']:6.2f}  both {r['both']:6.2f}  fixed {r['fixed']:6.2f}", flush=True)
    some = [r for r in every if r["learned"] > 0.1]
    if some:
        print(f"joints where the learner takes more than 0.1: {len(some)} of {len(every)}; median of named / learned "
              f"{np.median([r['named'] / r['learned'] for r in some]):.2f}, of both / learned "
              f"{np.median([r['both'] / r['learned'] for r in some]):.2f}; fixed set better than named in "
              f"{sum(r['fixed'] > r['named'] for r in every)} joints; worse than plain by more than 2 % RMS: "
              f"named in {sum((1 - r['named']) ** 0.5 > 1.02 for r in every)}, both in {sum((1 - r['both']) ** 0.5 > 1.02 for r in every)}")


if __name__ == "__main__":
    sys.exit(main())
