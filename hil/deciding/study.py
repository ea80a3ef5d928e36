#!/usr/bin/env python3
"""Motions that plumbline plans and drives for what its diagnosis leaves open, on the simulated Panda.

study.py pairs PROGRAM OUT SEED COUNT      random effects after a first motion that tells little: at most two planned rounds
study.py intervals PROGRAM OUT SEED COUNT  the widest interval of an effect: half the time, half of it on a planned motion, against one fixed motion

Prints one line per case and, at the end, a table. Two cases are driven at a time.
"""
import json
import math
import pathlib
import random
import re
import statistics
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
START = [0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854]
ARM = "config/arms/sim-panda.toml"
FRICTION = [float(fc) for fc in re.findall(r"^fc = (.*)$", (REPOSITORY / ARM).read_text(), flags=re.M)]
JOINTS = len(START)
ROUNDS = 2
FIXED_PERIODS = 12
JOBS = 2

# First motions: reach of each joint about the start [rad], share of the speed limits, period [s].
FIRST = {"small": (0.2, 1.0, 10.0), "tiny": (0.1, 1.0, 3.0), "slow": (0.4, 0.17, 10.0)}
RECORDED_S = 60.0

# Effects with the sizes that are drawn, in the joint's or arm's own unit; [low, high] of friction are shares of the joint's.
DRAWN = {
    "position-ripple": lambda draw, joint: f"order = {draw.choice([1, 2, 5, 11])}\nsine = {draw.size(0.05, 1.0)}",
    "spring": lambda draw, joint: f"stiffness = {draw.size(0.1, 3.0)}\nrest = {draw.rng.uniform(-0.5, 0.5):.3f}",
    "stribeck": lambda draw, joint: f"excess = {draw.of_friction(joint, 0.1, 0.6)}\nvelocity = {draw.size(0.02, 0.2)}",
    "coulomb-slope": lambda draw, joint: f"size = {draw.of_friction(joint, 0.2, 1.0)}\nvelocity = {draw.size(0.01, 0.05)}",
    "nonlinear-viscous": lambda draw, joint: draw.choice(
        [f'form = "quadratic"\nsize = {draw.size(0.2, 3.0)}', f'form = "cubic"\nsize = {draw.size(0.5, 8.0)}']),
    "presliding": lambda draw, joint: f"delta = {draw.size(0.001, 0.02)}",
    "asymmetric-coulomb": lambda draw, joint: f"asymmetry = {draw.of_friction(joint, 0.05, 0.5)}",
    "position-dependent-friction": lambda draw, joint: f"order = 1\nsine = {draw.of_friction(joint, 0.1, 0.9)}",
    "load-dependent-friction": lambda draw, joint: f"coulomb = {draw.size(0.005, 0.05)}",
    "torque-gain": lambda draw, joint: f"gain = {1.0 + draw.size(0.005, 0.05)}",
    "torque-offset": lambda draw, joint: f"offset = {draw.size(0.03, 0.5)}",
    "encoder-offset": lambda draw, joint: f"offset = {draw.size(0.005, 0.08)}",
    "encoder-eccentricity": lambda draw, joint: f"amplitude = {draw.size(0.0005, 0.01)}",
    "joint-elasticity": lambda draw, joint: f"stiffness = {draw.size(1000, 8000)}",
    "backlash": lambda draw, joint: f"gap = {draw.size(0.001, 0.01)}",
    "rotor-inertia": lambda draw, joint: f"inertia = {draw.size(0.01, 0.2)}",
    "torque-crosstalk": lambda draw, joint: f"other = {draw.other(joint)}\nshare = {draw.size(0.003, 0.05)}",
    "mounting": lambda draw, joint: f"tilt = [{draw.size(0.003, 0.1)}, {draw.size(0.003, 0.1)}, 0.0]",
}


class Draw:
    """Random effect, joint, sizes and first motion of one case."""

    def __init__(self, seed):
        self.rng = random.Random(seed)
        self.first = FIRST[self.choice(sorted(FIRST))]
        self.kind = self.choice(sorted(DRAWN))
        self.joint = None if self.kind == "mounting" else self.rng.randint(1, JOINTS)
        self.keys = DRAWN[self.kind](self, self.joint)

    def choice(self, of):
        return of[self.rng.randrange(len(of))]

    def size(self, low, high):
        """Log-uniform."""
        return float(f"{math.exp(self.rng.uniform(math.log(low), math.log(high))):.3g}")

    def of_friction(self, joint, low, high):
        return float(f"{FRICTION[joint - 1] * self.size(low, high):.3g}")

    def other(self, joint):
        return self.choice([other for other in range(1, JOINTS + 1) if other != joint])


def narrowed(folder, reach, speed):
    """The robot with each joint within `reach` of the start and slower, for the plan of the first motion."""
    text = (REPOSITORY / "config/robots/panda.toml").read_text()
    for key, sign in (("q-min", -1), ("q-max", 1)):
        values = iter(START)
        text = re.sub(rf"^{key} = .*$", lambda _: f"{key} = {next(values) + sign * (reach + 0.05)}", text, flags=re.M)
    text = re.sub(r"^dq = (.*)$", lambda found: f"dq = {float(found[1]) * speed}", text, flags=re.M)
    path = folder / "narrow.toml"
    path.write_text(text)
    return path


def run(command, log):
    with open(log, "w") as out:
        return subprocess.run([str(word) for word in command], stdout=out, stderr=subprocess.STDOUT, timeout=900).returncode


def job(program, folder, number, seed, effect, diagnosis, periods, first=None):
    """Writes and runs a job whose arm has an effect that nobody declared, and returns the diagnoses of its rounds."""
    kind, joint, keys = effect
    folder.mkdir(parents=True, exist_ok=True)
    arm = folder / "arm.toml"
    plain = (REPOSITORY / ARM).read_text()
    where = f"joint = {joint}\n" if joint else ""
    arm.write_text(f'{plain}\n[[effect]]\nid = "{kind}"\n{where}{keys}\n')
    plan = ""
    if first is not None:
        path = folder / "first.toml"
        reach, speed, period = first
        command = [program, "plan", "--robot", narrowed(folder, reach, speed), "--out", path, "--starts", 4, "--rounds", 0, "--seed", seed,
                   "--period", period]
        if run(command, folder / "plan.log") != 0:
            return f"{folder}/plan.log"
        plan = f'plan = "{path}"'
    path = folder / "job.toml"
    path.write_text(f"""
robot = "panda"
mounting = "upright"
[backend]
kind = "sim"
arm = "{arm}"
seed = {seed}
start = {[f"{q} rad" for q in START]}
[excitation]
{plan}
trajectories = 1
periods = {periods}
seed = {seed}
[validation]
trajectories = 0
[diagnosis]
{diagnosis}
[serve]
id = "deciding-{number}"
[output]
dir = "{folder / "out"}"
dataset = true
""")
    code = run([program, "run", path], folder / "run.log")
    told = []
    for report in sorted((folder / "out").glob("round-*")) + [folder / "out"]:
        try:
            told.append(json.loads((report / "report.json").read_text())["diagnosis"])
        except (OSError, ValueError) as error:
            return f"exit {code}, {error}"
    return told


def effects(diagnosis):
    return [(e["id"], e["joints"]) for e in diagnosis["effects"]]


def pair(program, number, folder, seed):
    """Verdicts and what was asked, round by round."""
    draw = Draw(seed)
    told = job(program, folder, number, seed, (draw.kind, draw.joint, draw.keys), f"rounds = {ROUNDS}", round(RECORDED_S / draw.first[2]), draw.first)
    name = f'{draw.kind} {draw.joint} {draw.first} {" ".join(draw.keys.split())}'
    if isinstance(told, str):
        return None, f"{name}: {told}"
    expected = [(draw.kind, [draw.joint] if draw.joint else [])]
    found = lambda one: [(id, joints[:1]) for id, joints in effects(one)] == expected
    right = [one["verdict"] == "diagnosed" and found(one) for one in told]
    words = [
        f'{one["verdict"]} {[e["id"] + str(e["joints"]) for e in one["effects"]]}'
        + "".join(f' ({o["question"]}: {o["now"]:.3g}, expected {o.get("expected", float("nan")):.3g})' for o in one.get("open", []))
        for one in told
    ]
    asked = {" / ".join(sorted(re.sub(r" in joint.*", "", effect) for effect in o["question"].split(", or ")))
             for one in told[:-1] for o in one.get("open", []) if o["kind"] == "rivals"}
    return (right, told[0]["verdict"], asked), f"{name}: {right} " + " -> ".join(words)


def pairs(found):
    known = [case for case in found if case]
    verdicts = {}
    for right, verdict, _ in known:
        verdicts.setdefault(verdict, []).append(right)
    print("\n| first verdict | cases | right at once | driven on | right after a round | after two |")
    print("|---|---|---|---|---|---|")
    for verdict, cases in verdicts.items():
        on = [right for right in cases if len(right) > 1]
        after = lambda rounds: sum(any(right[1 : rounds + 1]) for right in on)
        print(f"| {verdict} | {len(cases)} | {sum(right[0] for right in cases)} | {len(on)} | {after(1)} | {after(2)} |")
    kinds = {}
    for right, _, asked in known:
        for kind in asked:
            kinds.setdefault(kind, []).append(right[-1])
    print("\n| pair of rivals | cases in which it was open | right in the end |")
    print("|---|---|---|")
    for kind, cases in sorted(kinds.items(), key=lambda kind: -len(kind[1])):
        print(f"| {kind} | {len(cases)} | {sum(cases)} |")
    print(f"{len(found) - len(known)} cases without a report")


# Effects whose parameters a motion for base parameters tells more or less well.
INTERVALS = {
    "Stribeck friction": ("stribeck", 2, "excess = 0.2\nvelocity = 0.05"),
    "presliding": ("presliding", 4, "delta = 0.01"),
    "friction that rises over a range of speeds": ("coulomb-slope", 4, "size = 0.5\nvelocity = 0.03"),
    "ripple": ("position-ripple", 3, "order = 5\nsine = 0.2"),
    "spring": ("spring", 3, "stiffness = 0.3\nrest = 0.2"),
    "elasticity": ("joint-elasticity", 4, "stiffness = 5000"),
    "backlash": ("backlash", 4, "gap = 0.002"),
    "load-dependent friction": ("load-dependent-friction", 4, "coulomb = 0.03"),
    "gain": ("torque-gain", 4, "gain = 1.03"),
    "eccentric encoder": ("encoder-eccentricity", 4, "amplitude = 0.003"),
}


def widest(diagnosis):
    """Largest half width of a 95 % interval of an effect, as a share of what it is measured by: a setting by itself, parameters of the first one's unit by
    the norm of them all."""
    shares = []
    for effect in diagnosis["effects"]:
        values, units = effect["parameters"], effect["units"]
        linear = [name for name in values if any(character.isdigit() for character in name)]
        if not linear:
            continue
        alike = [name for name in linear if units[name] == units[linear[0]]]
        size = math.hypot(*(values[name] for name in alike))
        settings = [name for name in values if name not in linear]
        sizes = {name: size for name in alike} | {name: abs(values[name]) for name in settings}
        shares += [(1.96 * effect["std"][name] / of, name) for name, of in sizes.items() if of and effect["std"].get(name)]
    return max(shares, default=(math.nan, ""))


def interval(program, number, folder, seed):
    name = list(INTERVALS)[number % len(INTERVALS)]
    effect = INTERVALS[name]
    fixed = job(program, folder / "fixed", number, seed, effect, "rounds = 0", FIXED_PERIODS)
    if isinstance(fixed, str):
        return None, f"{name}: {fixed}"
    until = widest(fixed[-1])[0]
    if not until < 1.0:
        return None, f"{name}: found by the fixed motion: {effects(fixed[-1])}"
    planned = job(program, folder / "planned", number, seed, effect, f"rounds = 1\nuntil = {until}", FIXED_PERIODS // 4)
    if isinstance(planned, str):
        return None, f"{name}: {planned}"
    told = [widest(one) for one in (fixed[-1], planned[0], planned[-1])]
    words = " ".join(f"{share:.3g} {parameter}" for share, parameter in told)
    same = all([(id, joints) for id, joints in effects(one)] == [(effect[0], [effect[1]])] for one in (fixed[-1], planned[-1]))
    ratio = told[2][0] / told[0][0] if same and len(planned) == 2 else None
    return (name, ratio), f"{name}: fixed, first half of the planned, planned: {words} {ratio} {[effects(one) for one in (fixed[-1], planned[-1])]}"


def intervals(found):
    print("\n| effect | widest interval, planned in half the time over fixed |")
    print("|---|---|")
    every = {}
    for case in found:
        if case and case[1]:
            every.setdefault(case[0], []).append(case[1])
    for name, ratios in every.items():
        print(f"| {name} | {', '.join(f'{ratio:.2f}' for ratio in ratios)} |")
    ratios = [ratio for ratios in every.values() for ratio in ratios]
    print(f"at most as wide: {sum(ratio <= 1.0 for ratio in ratios)} of {len(ratios)} ({len(found)} cases), median {statistics.median(ratios):.2f}")


def main():
    study, program, out, first, count = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3]).resolve(), int(sys.argv[4]), int(sys.argv[5])
    of_one, table = {"pairs": (pair, pairs), "intervals": (interval, intervals)}[study]

    def told(number):
        result, words = of_one(program, number, out / str(first + number), first + number)
        print(first + number, words, flush=True)
        return result

    with ThreadPoolExecutor(JOBS) as pool:
        table(list(pool.map(told, range(count))))


if __name__ == "__main__":
    main()
