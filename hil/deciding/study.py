#!/usr/bin/env python3
"""Pairs of effects that a small motion cannot tell apart, and the motions that plumbline plans and drives to decide.

study.py PROGRAM OUT SEED...: for each kind and seed, a job whose first motion is small (each joint within 0.2 rad), then at most two rounds. Prints one
line per case and, at the end, a table.
"""
import json
import pathlib
import re
import subprocess
import sys

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
START = [0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854]
REACH = 0.2
ROUNDS = 2

# Effect, joint, its entry in the arm file.
KINDS = {
    "ripple of one wave a turn, joint 3": ("position-ripple", 3, "order = 1\nsine = 0.6"),
    "ripple of one wave a turn, joint 5": ("position-ripple", 5, "order = 1\nsine = 0.15"),
    "ripple of two waves a turn, joint 5": ("position-ripple", 5, "order = 2\nsine = 0.1"),
    "spring, joint 3": ("spring", 3, "stiffness = 0.6\nrest = 0.0"),
    "spring, joint 5": ("spring", 5, "stiffness = 0.2\nrest = 0.0"),
    "friction that rises with the square of the speed": ("nonlinear-viscous", 4, 'form = "quadratic"\nsize = 1.0'),
    "friction that rises with the cube of the speed": ("nonlinear-viscous", 4, 'form = "cubic"\nsize = 3.0'),
    "elasticity of a joint": ("joint-elasticity", 4, "stiffness = 8000"),
    "offset of an encoder": ("encoder-offset", 4, "offset = 0.05"),
}


def narrowed(folder):
    """The robot with each joint within REACH of the start, for the plan of the first motion."""
    text = (REPOSITORY / "config/robots/panda.toml").read_text()
    for key, sign in (("q-min", -1), ("q-max", 1)):
        values = iter(START)
        text = re.sub(rf"^{key} = .*$", lambda _: f"{key} = {next(values) + sign * (REACH + 0.05)}", text, flags=re.M)
    path = folder / "narrow.toml"
    path.write_text(text)
    return path


def run(command, log):
    with open(log, "w") as out:
        return subprocess.run(command, stdout=out, stderr=subprocess.STDOUT, timeout=900).returncode


def case(program, folder, name, seed):
    kind, joint, keys = KINDS[name]
    folder.mkdir(parents=True, exist_ok=True)
    arm = folder / "arm.toml"
    plain = (REPOSITORY / "config/arms/sim-panda.toml").read_text()
    arm.write_text(f'{plain}\n[[effect]]\nid = "{kind}"\njoint = {joint}\n{keys}\n')
    plan = folder / "small.toml"
    command = [program, "plan", "--robot", narrowed(folder), "--out", plan, "--starts", "4", "--rounds", "0", "--seed", str(seed)]
    assert run(command, folder / "plan.log") == 0, f"{folder}/plan.log"
    job = folder / "job.toml"
    job.write_text(f"""
robot = "panda"
mounting = "upright"
[backend]
kind = "sim"
arm = "{arm}"
seed = {seed}
start = {[f"{q} rad" for q in START]}
[excitation]
plan = "{plan}"
trajectories = 1
periods = 6
[validation]
trajectories = 0
[diagnosis]
rounds = {ROUNDS}
[output]
dir = "{folder / "out"}"
dataset = true
""")
    code = run([program, "run", job], folder / "run.log")
    rounds = sorted((folder / "out").glob("round-*")) + [folder / "out"]
    told = []
    for report in rounds:
        try:
            told.append(json.loads((report / "report.json").read_text())["diagnosis"])
        except (OSError, ValueError) as error:
            return None, f"exit {code}, {error}"
    right = lambda one: one["verdict"] == "diagnosed" and [(e["id"], e["joints"]) for e in one["effects"]] == [(kind, [joint])]
    words = [
        f'{one["verdict"]} {[e["id"] + str(e["joints"]) + "/" + "/".join(e.get("alternatives", [])) for e in one["effects"]]}'
        + "".join(f' ({o["question"]}: {o["now"]:.3g}, expected {o.get("expected", float("nan")):.3g})' for o in one.get("open", []))
        for one in told
    ]
    return [right(one) for one in told], " -> ".join(words)


def main():
    program, out, seeds = sys.argv[1], pathlib.Path(sys.argv[2]).resolve(), [int(seed) for seed in sys.argv[3:]]
    rows = {}
    for name in KINDS:
        for seed in seeds:
            right, words = case(program, out / f'{name.replace(" ", "-")}-{seed}', name, seed)
            print(name, seed, right, words, flush=True)
            rows.setdefault(name, []).append(right)
    print("\n| effect | cases | right at once | nothing found | left open | of these right after a round | after two |")
    print("|---|---|---|---|---|---|---|")
    for name, cases in rows.items():
        known = [right for right in cases if right]
        still = [right for right in known if len(right) > 1]
        after = lambda rounds: sum(any(right[1 : rounds + 1]) for right in still)
        at_once = sum(right[0] for right in known)
        print(f"| {name} | {len(cases)} | {at_once} | {len(known) - at_once - len(still)} | {len(still)} | {after(1)} | {after(2)} |")


if __name__ == "__main__":
    main()
