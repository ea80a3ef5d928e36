"""Cases: what an arm, its runs, its sensors and its undeclared effects are, drawn from a seed; their datasets and their truth.

An effect acts inside the simulation or on a sensor, and never through a formula of plumbline. Its size is set from its
*ratio*: the torque RMS that the plain model (rigid bodies, viscous and Coulomb friction, offsets; the best fit to noise-free data, below
8 Hz) leaves in the worst joint, over the noise floor there. A ratio of 1 or more counts as detectable.
"""

import json
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from scipy.linalg import qr
from scipy.signal import butter, sosfiltfilt

import arms
import motions
import plant
import rigid
from plant import COLUMN, STEP, Conditions

BAND = 8.0  # Hz, of the floor and of what is left unmodelled
RATE = 125  # Hz, of the truth's fit
ALIAS_BAND = 50.0  # Hz, of what the truth's fit is sampled from: an elastic joint swings at 200 Hz, and may not fold into the band
TRIM = 0.4  # s at both ends of a run that the truth's fit leaves out
DETECTABLE = 1.0
FORMS = ["tanh", "arctan", "lugre", "maxwell", "stribeck", "power"]

# kind: families that name it right. None: nothing in the library does.
KINDS = {
    "offset": {"torque-offset"}, "offset-run": {"torque-offset"}, "offset-step": {"torque-offset"}, "gain": {"torque-gain"},
    "zero": {"encoder-offset"}, "eccentric": {"encoder-eccentricity"}, "friction-session": {"friction-change"},
    "friction-step": {"friction-change"}, "warm": {"friction-drift"}, "backlash": {"backlash"}, "elastic": {"joint-elasticity"},
    "stribeck": {"stribeck"}, "presliding": {"presliding"}, "load": {"load-dependent-friction"}, "ripple": {"position-ripple"},
    "out-of-round": {"position-dependent-friction"}, "coupling": {"transmission-coupling"}, "spring": {"spring"},
    "rotor": {"rotor-inertia"}, "vibration": {"base-motion"}, "contact": {"contact"}, "tilt": {"mounting"}, "tilt-run": {"mounting"},
    "payload-session": {"payload"}, "payload-step": {"payload"}, "delay": {"delay"}, "crosstalk": {"torque-crosstalk"},
    "asymmetric": {"asymmetric-coulomb"}, "arctan": {"coulomb-slope", "nonlinear-viscous"}, "power": {"nonlinear-viscous"}, "hose": None,
    "spikes": None, "zeros": None,
}
FAULTS = {"spikes", "zeros"}  # to be masked, not named
WHOLE_ARM = {"mounting", "payload", "base-motion", "delay"}
SESSIONS = {"friction-session", "payload-session"}
STEPS = ["payload-step", "tilt-run", "offset-step", "friction-step"]  # while a model is served
SERVED = 96.0  # s
PARTS = {"offset-run", "offset-step", "friction-step", "payload-step", "tilt-run", "contact"}
SENSOR_SIDE = {"offset", "offset-run", "offset-step", "gain", "zero", "eccentric", "delay", "crosstalk", "spikes", "zeros"}


@dataclass
class Run:
    file: str
    role: str
    reference: np.ndarray
    seconds: float
    period: float | None
    session: int = 1
    lead: float = 0.0  # s that are driven and not recorded


@dataclass
class Case:
    seed: int
    clean: bool
    arm: arms.Arm
    mounting: tuple
    rate: int
    form: str
    table: np.ndarray
    controller: tuple
    inertia: np.ndarray
    runs: list
    quantum: float
    white: np.ndarray
    slow: np.ndarray
    slow_time: float
    torque_step: np.ndarray
    lost: float
    with_speeds: bool
    effects: list = field(default_factory=list)
    conditions: dict = field(default_factory=dict)


def draw(seed, clean, kinds=None, quick=False, settled=False):
    rng = np.random.default_rng([seed, 77])
    kind = str(rng.choice(["7r", "6r", "2r", "random"], p=[0.5, 0.2, 0.08, 0.22]))
    count = 0 if clean else int(rng.choice([1, 2], p=[0.72, 0.28]))
    pool = [k for k in KINDS if k not in FAULTS]
    chosen = list(kinds) if kinds else [str(k) for k in rng.choice(pool, count, replace=False)]
    if len(chosen) == 2 and KINDS[chosen[0]] and KINDS[chosen[0]] == KINDS[chosen[1]]:
        chosen.pop()  # one effect of a family is enough to be found
    if "coupling" in chosen and kind in ("7r", "2r"):
        kind = "6r"
    arm = arms.draw(rng, kind)
    n = arm.n
    where = str(rng.choice(["upright", "wall", "ceiling", "tilted"], p=[0.4, 0.3, 0.1, 0.2]))
    mounting = arms.MOUNTINGS.get(where) or (float(rng.uniform(0.3, 2.8)), float(rng.uniform(-3, 3)))
    rate = int(rng.choice([250, 500, 1000], p=[0.2, 0.25, 0.55]))
    bits = int(rng.integers(16, 25))
    quantum = 2 * np.pi / 2**bits
    controls, inertia = plant.controller(rng, arm, quantum)

    table = np.zeros((n, len(plant.NAMES)))
    put = lambda name, value: table.__setitem__((slice(None), COLUMN[name]), value)
    put("fc", arm.tau_max * rng.uniform(0.004, 0.015, n))
    put("fv", arm.tau_max * rng.uniform(0.002, 0.012, n))
    for name, value in (("steep", 100.0), ("power", 1.0), ("vs", 0.1), ("sharp", 1.0), ("delta", 1e-3), ("heat_tau", 30.0), ("heat_power", 1.0)):
        put(name, value)
    form = str(rng.choice(FORMS, p=[0.4, 0.12, 0.12, 0.12, 0.12, 0.12]))
    shape(rng, table, form)

    style = str(rng.choice(["fourier", "points", "taught"], p=[0.6, 0.2, 0.2]))
    leave = str(rng.choice(["at-once", "drawn-in"]))
    repeating = rng.random() < 0.75
    budget = 30.0 if quick else rng.uniform(50, 90)
    runs = []
    if repeating:
        period = 5.0 if quick else float(rng.choice([5.0, 6.0, 8.0, 10.0]))
        trajectories = 2 if quick else int(rng.integers(2, 5))
        periods = 3 if quick else int(np.clip(rng.integers(2, 11), 2, max(2, budget // (period * trajectories))))
        lead = int(settled)
        for k in range(trajectories):
            q = motions.start(rng, np.tile(motions.periodic(rng, arm, period, STEP, style), (periods + lead, 1)), STEP, leave)
            runs.append(Run(f"run_{k + 1}.csv", "identify", q, len(q) * STEP, period, lead=period * lead))
        unseen = int(rng.integers(1, 3))
        twice = 2 if rng.random() < 0.5 else 1
        for k in range(unseen):
            q = motions.start(rng, np.tile(motions.periodic(rng, arm, period, STEP, style), (twice + lead, 1)), STEP, leave)
            runs.append(Run(f"validate_{k + 1}.csv", "validate", q, len(q) * STEP, period if twice > 1 else None, lead=period * lead))
    else:
        for k in range(int(rng.integers(2, 4))):
            q = motions.start(rng, motions.free(rng, arm, budget / 4, STEP, style), STEP, leave)
            runs.append(Run(f"run_{k + 1}.csv", "identify", q, len(q) * STEP, None))
        q = motions.start(rng, motions.free(rng, arm, budget / 5, STEP, style), STEP, leave)
        runs.append(Run("validate_1.csv", "validate", q, len(q) * STEP, None))
    if SESSIONS & set(chosen):
        # the same motions again, later, and a new unseen one
        for k, run in enumerate([r for r in runs if r.role == "identify"][:2]):
            runs.append(Run(f"later_{k + 1}.csv", "identify", run.reference, run.seconds, run.period, 2, run.lead))
        runs.append(Run("later_validate.csv", "validate", runs[-1].reference[: int(len(runs[-1].reference) * 0.8)], 0.0, None, 2))
        runs[-1].seconds = len(runs[-1].reference) * STEP

    white = arm.tau_max * rng.uniform(0.0005, 0.002, n)
    usual = white * 0.3
    slow = usual * (6.0 if rng.random() < 0.12 else rng.uniform(0.2, 1.0))
    step = white * (rng.uniform(0.2, 0.6) if rng.random() < 0.3 else 0.0)
    lost = float(rng.uniform(0.0005, 0.01)) if rng.random() < 0.3 else 0.0
    case = Case(seed, clean, arm, mounting, rate, form, table, controls, inertia, runs, quantum, white, slow, 1 / (2 * np.pi * 0.3), step, lost,
                bool(rng.random() < 0.4))
    case.conditions = {"arm": arm.name, "kind": kind, "mounting": where, "rate": rate, "form": form, "style": style, "start": leave,
                       "repeating": repeating, "settled": settled, "periods": periods if repeating else 1, "unseen_periods": twice if repeating else 1, "bits": bits, "slow_noise": float(slow[0] / white[0])}
    case.rng = rng
    case.effects = [effect(rng, case, k) for k in chosen]
    if clean and rng.random() < 0.15:
        case.effects = [effect(rng, case, str(rng.choice(sorted(FAULTS))))]
    return case


def serve(case):
    """Lets a live watch see an unseen motion, with a step in it, and then its end, another step on top, or nothing."""
    rng = np.random.default_rng([case.seed, 78])
    period = float(rng.choice([5.0, 6.0, 8.0, 10.0]))
    one = motions.periodic(rng, case.arm, period, STEP, str(rng.choice(["fourier", "points", "taught"])))
    q = motions.start(rng, np.tile(one, (int(SERVED // period) + 1, 1)), STEP, "drawn-in")
    case.runs.append(Run("live.csv", "live", q, len(q) * STEP, period, lead=period))
    case.with_speeds = True  # a controller has them
    case.effects = []
    if case.clean:
        return
    first, then = rng.choice(STEPS, 2, replace=False)
    at = float(rng.uniform(25.0, 35.0))
    later = at + float(rng.uniform(28.0, 32.0))
    what = str(rng.choice(["gone", "second", "nothing"]))
    for kind, begin, end in [(first, at, later if what == "gone" else 1e9)] + [(then, later, 1e9)] * (what == "second"):
        e = effect(rng, case, str(kind))
        e["target"] = float(np.exp(rng.uniform(np.log(4.0), np.log(40.0))))
        e["when"] = [[len(case.runs) - 1, begin, end]]
        case.effects.append(e)


def shape(rng, table, form, strength=1.0):
    """Friction of the plain arm in one of several laws, near the plain model; calibrate() draws it nearer where it is not."""
    n = len(table)
    put = lambda name, value: table.__setitem__((slice(None), COLUMN[name]), value)
    if form == "tanh":
        put("steep", 100.0 * rng.uniform(0.7, 1.5, n) ** strength)
    elif form == "arctan":
        put("form", plant.ARCTAN)
        put("steep", rng.uniform(50, 200, n) / strength**2)
    elif form == "lugre":
        put("form", plant.LUGRE)
        put("delta", rng.uniform(2e-5, 2e-4, n) * strength)
        put("s1", table[:, COLUMN["fc"]] * rng.uniform(2, 10, n))
    elif form == "maxwell":
        put("form", plant.MAXWELL)
        put("delta", rng.uniform(2e-5, 2e-4, n) * strength)
    elif form == "stribeck":
        put("peak", rng.uniform(0.05, 0.3, n) * strength)
        put("vs", rng.uniform(0.01, 0.1, n))
        put("sharp", rng.choice([0.5, 1.0, 2.0], n))
    else:
        put("power", 1 + rng.uniform(-0.3, 0.2, n) * strength)


def effect(rng, case, kind):
    """An effect of a kind, with a size to start from; `calibrate` scales it."""
    n, arm = case.arm.n, case.arm
    j = int(rng.integers(n))
    e = {"kind": kind, "joint": j, "target": float(np.exp(rng.uniform(np.log(0.7), np.log(12.0)))), "phase": float(rng.uniform(0, 6.28))}
    if kind == "coupling":
        j = n - 1
    level = float(arm.tau_max[j] * 0.01)
    sizes = {  # start, least, most
        "offset": (0.3 * level, 0, 5 * level), "gain": (0.02, 0, 0.08), "zero": (3e-3, 0, 0.02), "eccentric": (1e-3, 0, 5e-3),
        "friction-session": (0.4, 0, 1.5), "friction-step": (0.4, 0, 1.5), "warm": (0.4, 0, 0.7), "backlash": (1e-3, 1e-4, 4e-3),
        "elastic": (0.05, 1e-3, 0.4), "stribeck": (0.4, 0, 1.0), "presliding": (5e-3, 5e-4, 0.05), "load": (0.02, 0, 0.1),
        "ripple": (0.15 * level, 0, 2 * level), "out-of-round": (0.3, 0, 0.8), "coupling": (0.5 * level, 0, 3 * level),
        "spring": (0.5 * level, 0, 5 * level), "rotor": (0.3 * level, 0, 2 * level), "vibration": (0.1, 0, 1.0), "contact": (8.0, 0.3, 80),
        "tilt": (0.01, 0, 0.06), "payload-session": (0.5, 0.003, 4.0), "payload-step": (0.5, 0.003, 4.0), "delay": (1.0, 1, 4),
        "crosstalk": (0.02, 0, 0.08), "asymmetric": (0.2, 0, 0.6), "arctan": (1.0, 0.3, 6.0), "power": (1.0, 0.3, 3.0), "hose": (0.3 * level, 0, 3 * level),
        "spikes": (1, 1, 1), "zeros": (1, 1, 1),
    }
    base = {"offset-run": "offset", "offset-step": "offset", "tilt-run": "tilt"}.get(kind, kind)
    e["size"], e["least"], e["most"] = (float(x) for x in sizes[base])
    sign = float(rng.choice([-1, 1]))
    identify = [k for k, r in enumerate(case.runs) if r.role == "identify" and r.session == 1]
    unseen = [k for k, r in enumerate(case.runs) if r.role == "validate"]
    if kind == "rotor" and arm.sensing == "motor":
        e["kind"] = kind = "spring"
        e["size"], e["least"], e["most"] = 0.5 * level, 0, 5 * level
    if kind in ("offset", "offset-run", "offset-step", "gain", "zero", "asymmetric", "crosstalk"):
        e["sign"] = sign
    if kind in ("offset-run", "tilt-run"):
        some = unseen if rng.random() < 0.5 else [int(rng.choice(identify))]
        e["when"] = [[k, 0.0, case.runs[k].seconds] for k in some]
    if kind in ("offset-step", "friction-step", "payload-step"):
        k = int(rng.choice(identify))
        begin = float(rng.uniform(0.25, 0.7) * case.runs[k].seconds)
        e["when"] = [[k, begin, case.runs[k].seconds]]
        # it stays for all the runs after
        e["when"] += [[i, 0.0, r.seconds] for i, r in enumerate(case.runs) if i > k]
    if kind == "contact":
        k = int(rng.choice(identify))
        begin = float(rng.uniform(0.15, 0.8) * case.runs[k].seconds)
        e["when"] = [[k, begin, begin + float(rng.uniform(0.4, 2.0))]]
        e["joint"] = int(rng.integers(max(n - 3, 0), n))
        direction = rng.normal(size=3)
        e["direction"] = (direction / np.linalg.norm(direction)).tolist()
        e["point"] = rng.uniform(-0.1, 0.1, 3).tolist()
    if kind in SESSIONS:
        e["when"] = [[i, 0.0, r.seconds] for i, r in enumerate(case.runs) if r.session == 2]
    if kind in ("payload-session", "payload-step"):
        e["at"] = (np.array([0, 0, 0.05]) + rng.normal(0, 0.03, 3)).tolist()
    if kind in ("tilt", "tilt-run"):
        g = arms.gravity_vector(*case.mounting)
        axis = np.cross(g, rng.normal(size=3))
        e["axis"] = (axis / np.linalg.norm(axis)).tolist()
    if kind == "vibration":
        e["direction"] = rng.normal(size=3).tolist()
        e["frequency"] = float(rng.uniform(1.5, 9.0))
    if kind == "ripple":
        e["order"] = float(rng.choice([1, 2, 3, 4, 6, 8, 12, 20, 40]))
    if kind == "coupling":
        e["joint"], e["cause"] = (n - 1, n - 2) if rng.random() < 0.8 else (n - 2, n - 1)
        e["turns"] = float(rng.choice([-1, 1]) * rng.uniform(0.4, 1.0))
    if kind in ("hose", "crosstalk"):
        e["cause"] = int((e["joint"] + rng.choice([-1, 1])) % n)
    if kind == "presliding":
        e["law"] = str(rng.choice(["lugre", "maxwell"]))
    if kind == "stribeck":
        e["vs"], e["sharp"] = float(rng.uniform(0.03, 0.15)), float(rng.choice([1.0, 2.0]))
    if kind == "warm":
        e["tau"] = float(rng.uniform(20, 80))
    return e


def active(e, k, t=None):
    """Whether an effect acts in run k, and from when to when."""
    if "when" not in e:
        return (-1e9, 1e9)
    for run, begin, end in e["when"]:
        if run == k:
            return (begin if begin > 0 else -1e9, end if end < 1e8 else 1e9)
    return None


def simulate(case, effects):
    """All steps of all runs with some effects: list of (t, q, v, a, tau), as the sensors see them but for noise and rate."""
    rotor = case.arm.rotor.copy()
    n = case.arm.n
    table = case.table.copy()
    coupling, ratio = np.zeros((n, n)), np.zeros((n, n))
    base = Conditions()
    for e in effects:
        j, size, kind = e["joint"], e["size"], e["kind"]
        row = table[j]
        if kind == "backlash":
            swing = 0.5 * case.inertia[j]
            row[COLUMN["stiff"]] = swing * (2 * np.pi * 60) ** 2
            row[COLUMN["twist_damping"]] = 0.4 * np.sqrt(row[COLUMN["stiff"]] * swing)
            row[COLUMN["gap"]] = size
        elif kind == "elastic":  # size: static frequency ratio; compliance = size^2 / (inertia w^2)
            row[COLUMN["stiff"]] = case.inertia[j] * (2 * np.pi * 4.0) ** 2 / size
            row[COLUMN["twist_damping"]] = 0.1 * np.sqrt(row[COLUMN["stiff"]] * case.inertia[j])
        elif kind == "stribeck":
            row[COLUMN["peak"]], row[COLUMN["vs"]], row[COLUMN["sharp"]] = size, e["vs"], e["sharp"]
        elif kind == "presliding":
            row[COLUMN["form"]] = plant.LUGRE if e["law"] == "lugre" else plant.MAXWELL
            row[COLUMN["delta"]], row[COLUMN["s1"]] = size, row[COLUMN["fc"]] * 2
        elif kind == "load":
            row[COLUMN["load"]] = size
        elif kind == "ripple":
            row[COLUMN["ripple"]], row[COLUMN["ripple_n"]], row[COLUMN["ripple_p"]] = size, e["order"], e["phase"]
        elif kind == "out-of-round":
            row[COLUMN["round_a"]], row[COLUMN["round_p"]] = size, e["phase"]
        elif kind == "spring":
            row[COLUMN["spring"]], row[COLUMN["spring_q0"]] = size, 0.3 * np.sin(e["phase"])
        elif kind == "asymmetric":
            row[COLUMN["asym_c"]] = e["sign"] * size
        elif kind == "warm":
            row[COLUMN["heat"]], row[COLUMN["heat_tau"]] = size, e["tau"]
            row[COLUMN["heat_power"]] = 0.35 * (row[COLUMN["fc"]] + 0.35 * row[COLUMN["fv"]])
        elif kind == "arctan":
            table[:, COLUMN["form"]] = plant.ARCTAN
            table[:, COLUMN["steep"]] = np.clip(80 / size, 8, 200)
        elif kind == "power":
            table[:, COLUMN["power"]] = np.clip(1 - 0.25 * size, 0.35, 1)
        elif kind == "coupling":
            coupling[j, e["cause"]], ratio[j, e["cause"]] = size, e["turns"]
        elif kind == "hose":
            row[COLUMN["hose"]], row[COLUMN["hose_joint"]] = size, e["cause"]
        elif kind == "rotor":
            rotor[j] = max(rotor[j], size)
        elif kind == "vibration":
            d = np.array(e["direction"])
            base.shake = np.concatenate([size * d / np.linalg.norm(d), e["phase"] + np.arange(3)])
            base.shake_f = e["frequency"]
    arm = plant.Plant(case.arm, table, case.controller, case.mounting, rotor, coupling, ratio)
    seen = []
    for k, run in enumerate(case.runs):
        c = Conditions(**vars(base))
        arm.table = table.copy()
        for e in effects:
            when, size, kind = active(e, k), e["size"], e["kind"]
            if when is None:
                continue
            if kind in ("tilt", "tilt-run"):
                c.tilt, c.tilt_times = size * np.array(e["axis"]), when
            elif kind in ("payload-session", "payload-step"):
                c.tool = np.array([size, *(size * np.array([1.2e-3, 1.5e-3, 0.8e-3]))])
                c.tool_at, c.tool_times = np.array(e["at"]), when
            elif kind == "contact":
                c.touch, c.touch_link = np.array([*(-size * np.array(e["direction"])), *e["point"]]), e["joint"]
                c.touch_times = when
        # a step of friction inside a run: two tables, one after the other
        out = None
        steps = [e for e in effects if e["kind"] in ("friction-step", "friction-session") and active(e, k)]
        if steps and steps[0]["kind"] == "friction-session":
            for name in ("fc", "fv"):
                arm.table[steps[0]["joint"], COLUMN[name]] *= 1 + steps[0]["size"]
        elif steps:
            changed = arm.table.copy()
            for name in ("fc", "fv"):
                changed[steps[0]["joint"], COLUMN[name]] *= 1 + steps[0]["size"]
            arm.change = (active(steps[0], k), changed)
        out = arm.run(run.reference, 1, c)
        arm.change = None
        arm.heat *= 0.9  # a pause between the runs
        q, before, after, command, behind = out
        acceleration, speed = (after - before) / STEP, 0.5 * (after + before)
        tau = command.copy()
        if case.arm.sensing == "link":
            rotors = [e["joint"] for e in effects if e["kind"] == "rotor"]
            behind = behind - np.where(arm.twist < 0, arm_rotor(case, rotor, rotors), 0.0) * acceleration
            tau = behind
        t = np.arange(len(q)) * STEP
        for e in effects:
            when, size, j = active(e, k), e["size"], e["joint"]
            if when is None:
                continue
            now = (t >= when[0]) & (t < when[1])
            if e["kind"] in ("offset", "offset-run", "offset-step"):
                tau[now, j] += e["sign"] * size
            elif e["kind"] == "gain":
                tau[:, j] *= 1 + e["sign"] * size
            elif e["kind"] == "crosstalk":
                tau[:, j] += e["sign"] * size * tau[:, e["cause"]]
            elif e["kind"] == "zero":
                q[:, j] += e["sign"] * size
            elif e["kind"] == "eccentric":
                wave = q[:, j] + e["phase"]
                q[:, j] += size * np.sin(wave)
                acceleration[:, j] += size * (np.cos(wave) * acceleration[:, j] - np.sin(wave) * speed[:, j] ** 2)
                speed[:, j] *= 1 + size * np.cos(wave)
            elif e["kind"] == "delay":
                shift = int(round(size)) * per_sample(case)
                tau = np.concatenate([np.repeat(tau[:1], shift, axis=0), tau[: len(tau) - shift]])
        seen.append((t, q, speed, acceleration, tau))
    return seen


def per_sample(case):
    """Steps of the simulation for each sample of the recording."""
    return int(round(1 / (case.rate * STEP)))


def arm_rotor(case, rotor, sensed):
    """Rotor inertias that a link-side sensor does not see: all but those whose torque is sensed before the gear."""
    hidden = rotor.copy()
    hidden[sensed] = 0.0
    return hidden


class Plain:
    """The best plain model of noise-free data, fitted here and not by plumbline."""

    def __init__(self, case):
        self.case = case
        arm = case.arm
        self.gravity = arms.gravity_vector(*case.mounting)
        rng = np.random.default_rng(0)
        n = arm.n
        rows = self.rigid(*rng.normal(size=(3, 60, n)), np.arange(10 * n))
        _, r, order = qr(rows.reshape(60 * n, -1), mode="economic", pivoting=True)
        rank = int((np.abs(np.diag(r)) > 1e-8 * abs(r[0, 0])).sum())
        self.base = np.sort(order[:rank])
        self.filter = butter(4, BAND, fs=RATE, output="sos")

    def rigid(self, q, v, a, columns):
        out = np.empty((len(q), self.case.arm.n, len(columns)))
        wanted = np.full(10 * self.case.arm.n, -1)
        wanted[columns] = np.arange(len(columns))
        rigid.regressor(self.case.arm.dh, self.gravity, wanted, *(np.ascontiguousarray(x) for x in (q, v, a)), out)
        return out

    def floor(self, run):
        """Noise of a run's mean period per joint below the band [Nm]."""
        case = self.case
        white = case.white * np.sqrt(2 * BAND / case.rate)
        encoder = case.quantum / np.sqrt(12) * np.sqrt(2 * BAND / case.rate) * (2 * np.pi * BAND) ** 2 / np.sqrt(5) * case.inertia
        return np.sqrt(white**2 + case.slow**2 + encoder**2)

    def unmodelled(self, seen, offsets=True):
        """What the plain model leaves: per run, time [s] and low-passed residual [samples, joints]."""
        case, n = self.case, self.case.arm.n
        skip = int(round(1 / (RATE * STEP)))
        alias = butter(4, ALIAS_BAND, fs=1 / STEP, output="sos")
        blocks, targets, times = [], [], []
        for t, q, v, a, tau in seen:
            own = [np.tanh(100 * v), v] + ([np.ones_like(v)] if offsets else []) + ([a] if case.arm.sensing == "motor" else [])
            q, v, a, tau, *own = (sosfiltfilt(alias, x, axis=0)[::skip] for x in (q, v, a, tau, *own))
            t = t[::skip]
            keep = slice(int(TRIM * RATE), len(t) - int(TRIM * RATE), 5)
            columns = self.rigid(q, v, a, self.base)
            full = np.zeros((len(range(len(t))[keep]), n, len(self.base) + n * len(own)))
            full[:, :, : len(self.base)] = sosfiltfilt(self.filter, columns, axis=0)[keep]
            for m, x in enumerate(own):
                x = sosfiltfilt(self.filter, x, axis=0)[keep]
                for i in range(n):
                    full[:, i, len(self.base) + m * n + i] = x[:, i]
            y = sosfiltfilt(self.filter, tau, axis=0)
            blocks.append(full)
            targets.append(y[keep])
            times.append(t[keep])
        weight = 1 / self.floor(None)
        w = np.concatenate([(b * weight[:, None]).reshape(-1, b.shape[-1]) for b in blocks])
        y = np.concatenate([(x * weight).ravel() for x in targets])
        size = np.linalg.norm(w, axis=0) + 1e-12
        beta = np.linalg.lstsq(w / size, y, rcond=1e-9)[0] / size
        return [(t, y - b @ beta) for t, b, y in zip(times, blocks, targets)]

    def ratios(self, left, e=None):
        """Unmodelled torque over the floor, per joint: the worst of the runs or the parts of them where an effect acts."""
        worst = np.zeros(self.case.arm.n)
        for k, (t, r) in enumerate(left):
            run = self.case.runs[k]
            part = np.ones(len(t), bool)
            periods = (run.seconds - run.lead) / run.period if run.period else 1.0
            if e is not None and "when" in e:
                when = active(e, k)
                if when is None:
                    continue
                part = (t >= when[0]) & (t < when[1])
                if when[0] > 0:
                    periods = 1.0
            if part.sum() > 5:
                worst = np.maximum(worst, np.sqrt((r[part] ** 2).mean(axis=0)) / self.floor(run) * np.sqrt(periods))
        return worst


def calibrate(case):
    """Draws the friction near the plain model where the case says so, and gives every effect the size of its ratio."""
    plain = Plain(case)
    start = case.table.copy()
    for strength in (1.0, 0.5, 0.25, 0.1, 0.0):  # 0.1: the plain law itself comes next
        base = plain.ratios(plain.unmodelled(simulate(case, [])))
        if base.max() < 0.5 or strength == 0.0:
            break
        case.table = start.copy()
        if strength == 0.1:
            case.form = case.conditions["form"] = "tanh"
            plain_law(case.table)
        else:
            nearer(case.table, start, 0.5 * strength)
    for e in case.effects:
        if e["kind"] in FAULTS:
            e["ratio"], e["ratios"] = 0.0, []
            continue
        for attempt in range(3):
            left = plain.unmodelled(simulate(case, [e]), offsets=e["kind"] != "offset")
            own = np.sqrt(np.maximum(plain.ratios(left, e) ** 2 - base**2, 0))
            ratio = float(own.max())
            e["ratio"], e["ratios"] = round(ratio, 3), own.round(3).tolist()
            if 0.75 < ratio / e["target"] < 1.33:
                break
            if attempt < 2:
                power = {"arctan": 1.5, "presliding": 1.0}.get(e["kind"], 1.0)
                new = float(np.clip(e["size"] * np.clip(e["target"] / max(ratio, 1e-3), 0.1, 10) ** (1 / power), e["least"], e["most"]))
                if abs(new / e["size"] - 1) < 0.02:
                    break
                e["size"] = new
    case.conditions["plain_ratio"] = round(float(base.max()), 3)
    return plain


def plain_law(table):
    table[:, COLUMN["form"]] = plant.TANH
    for name, value in (("steep", 100.0), ("peak", 0.0), ("power", 1.0)):
        table[:, COLUMN[name]] = value


def nearer(table, start, strength):
    c = COLUMN
    for name in ("delta", "s1", "peak"):
        table[:, c[name]] = start[:, c[name]] * strength
    table[:, c["power"]] = 1 + (start[:, c["power"]] - 1) * strength
    if start[0, c["form"]] == plant.ARCTAN:
        table[:, c["steep"]] = start[:, c["steep"]] / strength
    else:
        table[:, c["steep"]] = 100 * (start[:, c["steep"]] / 100) ** strength


@njit(cache=True)
def first_order(white, decay):
    out = np.empty_like(white)
    state = white[0].copy()
    gain = np.sqrt(1 - decay * decay)
    for k in range(len(white)):
        state = decay * state + gain * white[k]
        out[k] = state
    return out


def measure(case, rng, seen):
    """Sensors: quantised positions, noisy torques, lost rows; faults where the case has them."""
    n = case.arm.n
    every = per_sample(case)
    for run, steps in zip(case.runs, seen):
        t, q, v, _, tau = (x[: len(x) // every * every : every] for x in steps)
        tau = tau + case.white * rng.normal(size=tau.shape)
        tau = tau + case.slow * first_order(rng.normal(size=tau.shape), np.exp(-1 / (case.rate * case.slow_time)))
        quantised = np.where(case.torque_step > 0, np.round(tau / np.maximum(case.torque_step, 1e-9)) * case.torque_step, tau)
        tau = quantised
        for e in case.effects:
            if e["kind"] == "spikes":
                for k in rng.integers(0, len(t), max(2, len(t) // 15000)):
                    tau[k, e["joint"]] += rng.choice([-1, 1]) * case.arm.tau_max[e["joint"]] * rng.uniform(0.2, 0.8)
            elif e["kind"] == "zeros" and run.role == "identify":
                k = int(rng.integers(0, len(t) - case.rate))
                length = int(rng.uniform(0.05, 0.3) * case.rate)
                tau[k : k + length, :] = 0.0
        q = np.round(q / case.quantum) * case.quantum
        speeds = v + 2e-4 * rng.normal(size=v.shape) if case.with_speeds else None
        keep = np.ones(len(t), bool)
        if case.lost:
            keep = rng.random(len(t)) >= case.lost
            for k in rng.integers(0, len(t), 2):
                keep[k : k + int(rng.integers(2, 12))] = False
            keep[0] = keep[-1] = True
        keep &= t >= run.lead - 1e-9
        yield run, t[keep], q[keep], None if speeds is None else speeds[keep], tau[keep]


@njit(cache=True)
def text_of(values, digits):
    """Rows of fixed-point numbers as CSV text: many times as fast as numpy's own."""
    rows, columns = values.shape
    out = np.empty(rows * columns * 22, np.uint8)
    at = 0
    work = np.empty(24, np.uint8)
    for i in range(rows):
        for j in range(columns):
            scale = 10.0 ** digits[j]
            x = int(np.round(values[i, j] * scale))
            if x < 0:
                out[at] = 45
                at += 1
                x = -x
            k = 0
            while x > 0 or k <= digits[j] + (1 if digits[j] > 0 else 0):
                if k == digits[j] and digits[j] > 0:
                    work[23 - k] = 46
                    k += 1
                    continue
                work[23 - k] = 48 + x % 10
                x //= 10
                k += 1
            for b in range(24 - k, 24):
                out[at] = work[b]
                at += 1
            out[at] = 10 if j == columns - 1 else 44
            at += 1
    return out[:at]


def write_csv(path, t, q, speeds, tau):
    n = q.shape[1]
    names = ["t"] + [f"q{i + 1}" for i in range(n)] + ([f"dq{i + 1}" for i in range(n)] if speeds is not None else []) + [f"tau{i + 1}" for i in range(n)]
    parts = [t[:, None], q] + ([speeds] if speeds is not None else []) + [tau]
    digits = np.array([6] + [8] * n + ([6] * n if speeds is not None else []) + [5] * n, np.int64)
    with open(path, "wb") as file:
        file.write((",".join(names) + "\n").encode())
        file.write(text_of(np.ascontiguousarray(np.hstack(parts)), digits).tobytes())


def make(seed, clean, folder, kinds=None, quick=False, settled=False, served=False):
    """Writes one case: a dataset folder with truth.json. Without the first period of repeating runs where `settled`. Where `served`, steps come
    after the identification only, in the run of a dataset of its own, `live`."""
    case = draw(seed, clean or served, kinds, quick, settled or served)
    if served:
        case.clean = clean
        serve(case)
    plain = calibrate(case)
    folder.mkdir(parents=True, exist_ok=True)
    seen = simulate(case, case.effects)
    left = plain.ratios(plain.unmodelled(seen, offsets=not any(e["kind"] == "offset" for e in case.effects)))
    robot = case.arm.name
    if case.arm.description:
        (folder / "robot.toml").write_text(case.arm.description)
        robot = "robot.toml"
    lines = [f'name = "study-{seed}"', f'robot = "{robot}"', "", "[mounting]", f"rho = {case.mounting[0]!r}", f"phi = {case.mounting[1]!r}"]
    for run, t, q, speeds, tau in measure(case, case.rng, seen):
        if run.role == "live":
            (folder / "live").mkdir(exist_ok=True)
            write_csv(folder / "live" / run.file, t, q, speeds, tau)
            (folder / "live" / "dataset.toml").write_text("\n".join(lines[:6] + ["", "[[run]]", f'file = "{run.file}"', 'role = "identify"']) + "\n")
            continue
        write_csv(folder / run.file, t, q, speeds, tau)
        lines += ["", "[[run]]", f'file = "{run.file}"', f'role = "{run.role}"', f"session = {run.session}"]
        if run.period:
            lines.append(f"period = {run.period!r}")
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n")
    steep = case.table[:, COLUMN["steep"]]
    friction = {}
    if case.form == "tanh" and np.allclose(steep, 100):
        friction = {f"fc{i + 1}": case.table[i, COLUMN["fc"]] for i in range(case.arm.n)}
    truth = {
        "seed": seed, "clean": clean, "conditions": case.conditions, "unmodelled": left.round(3).tolist(),
        "floor": plain.floor(None).tolist(), "effects": [describe(case, e) for e in case.effects],
        "seconds": sum(r.seconds for r in case.runs), "rows": sum(int(r.seconds * case.rate) for r in case.runs),
        "parameters": {**case.arm.standard_parameters(), **friction},
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1, default=float))
    return truth


def describe(case, e):
    """An effect as truth.json has it: joints count from 1, and parameters are in the report's terms."""
    kind, j, size = e["kind"], e["joint"], e["size"]
    # the zero of the first encoder and a turn of the base about the first axis are the same
    families = KINDS[kind] | {"mounting"} if kind == "zero" and j == 0 else KINDS[kind]
    whole = bool(KINDS[kind]) and bool(KINDS[kind] & WHOLE_ARM)
    all_joints = kind in ("arctan", "power")
    joints = [i + 1 for i, r in enumerate(e["ratios"]) if r >= DETECTABLE] if all_joints else [] if whole else [j + 1]
    optional = [i + 1 for i in range(case.arm.n)] if all_joints else []
    sign = e.get("sign", 1.0)
    parameters = {
        "offset": {"offset": sign * size}, "offset-run": {"offset": sign * size}, "offset-step": {"offset": sign * size},
        "gain": {"gain": sign * size}, "zero": {"zero": -sign * size}, "backlash": {"gap": size}, "delay": {"delay": round(size) / case.rate},
        "payload-session": {"mass": size}, "payload-step": {"mass": size}, "load": {"fl": size},
        "crosstalk": {"cross": sign * size}, "rotor": {"ia": max(case.arm.rotor[j], size)}, "spring": {"spring": size},
        "elastic": {"compliance": 1 / (case.inertia[j] * (2 * np.pi * 4.0) ** 2 / size)},
    }.get(kind, {})
    return {
        "kind": kind, "families": sorted(families) if families else None, "joints": joints, "optional_joints": optional,
        "cause": e["cause"] + 1 if "cause" in e else None, "size": size, "ratio": e["ratio"], "target": e["target"],
        "when": [[case.runs[k].file, max(begin, 0.0), end] for k, begin, end in e["when"]] if "when" in e else None, "parameters": parameters,
    }
