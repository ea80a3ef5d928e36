"""The arm in time: MuJoCo's step, the controller and the friction of every joint, in one compiled loop.

Friction is a generalised force that is applied to the joint. Steep laws are stepped linearly implicitly: the law's slope over the
speed becomes MuJoCo's joint damping for this one step (`M + h D`), so that torque and motion stay consistent at any steepness.
"""

import ctypes
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

import arms

mujoco.set_mju_user_warning(lambda text: None)  # a simulation that diverges ends with an error here, not in a log file

STEP = 0.0005  # s, of the simulation and the controller
IMPLICIT = 0.5  # share of the step's end in friction: that of its mean speed, which the positions before and after it have, too
HOLD = 0.6  # s at rest before the recording begins

# friction forms
TANH, ARCTAN, LUGRE, MAXWELL = 0.0, 1.0, 2.0, 3.0
# columns of the table of joint properties
NAMES = [
    "form", "fc", "fv", "steep", "delta", "s1", "peak", "vs", "sharp", "power", "asym_c", "asym_v", "load", "round_a", "round_p", "heat",
    "heat_tau", "heat_power", "spring", "spring_q0", "ripple", "ripple_n", "ripple_p", "stiff", "twist_damping", "gap", "hose", "hose_joint",
]
(FORM, FC, FV, STEEP, DELTA, S1, PEAK, VS, SHARP, POWER, ASYM_C, ASYM_V, LOAD, ROUND_A, ROUND_P, HEAT,
 HEAT_TAU, HEAT_POWER, SPRING, SPRING_Q0, RIPPLE, RIPPLE_N, RIPPLE_P, STIFF, TWIST_DAMPING, GAP, HOSE, HOSE_JOINT) = range(len(NAMES))
COLUMN = {name: k for k, name in enumerate(NAMES)}
SHARES = np.array([0.35, 0.3, 0.2, 0.15])  # of Maxwell's slip elements
REACHES = np.array([0.3, 0.8, 1.8, 4.0])


@intrinsic
def call_step(context, function, model, data):
    """Calls mj_step by its address; an address is a value, so that the compiled loop can be kept in a cache."""
    signature = types.void(types.int64, types.int64, types.int64)

    def generate(context, builder, signature, args):
        word = ir.IntType(64)
        pointer = builder.inttoptr(args[0], ir.FunctionType(ir.VoidType(), [word, word]).as_pointer())
        builder.call(pointer, [args[1], args[2]])
        return context.get_dummy_value()

    return signature, generate


@njit(cache=True)
def friction(p, v, q, factor, load, z, h):
    """Friction torque and its slope over the speed. `z` is the state of the bristle or the slip elements and is advanced by h."""
    fc = p[FC] * factor * (1 + p[ASYM_C] * (1.0 if v > 0 else -1.0)) * (1 + p[ROUND_A] * np.sin(q + p[ROUND_P])) + p[LOAD] * abs(load)
    fv = p[FV] * factor * (1 + p[ASYM_V] * (1.0 if v > 0 else -1.0))
    speed = abs(v)
    viscous = fv * v if p[POWER] == 1.0 else fv * np.sign(v) * speed ** p[POWER]
    slope = fv if p[POWER] == 1.0 else fv * p[POWER] * max(speed, 0.02) ** (p[POWER] - 1)
    level = fc * (1 + p[PEAK] * np.exp(-((speed / p[VS]) ** p[SHARP]))) if p[PEAK] != 0.0 else fc
    form = p[FORM]
    if form == TANH:
        x = np.tanh(p[STEEP] * v)
        return level * x + viscous, level * p[STEEP] * (1 - x * x) + slope
    if form == ARCTAN:
        return level * 2 / np.pi * np.arctan(p[STEEP] * v) + viscous, level * 2 / np.pi * p[STEEP] / (1 + (p[STEEP] * v) ** 2) + slope
    if form == LUGRE:
        s0 = fc / p[DELTA]
        rate = s0 * speed / level
        new = (z[0] + h * v) / (1 + h * rate)
        moving = (new - z[0]) / h
        z[0] = new
        damping = p[S1] * np.exp(-speed / 0.02)
        return s0 * new + damping * moving + viscous, (s0 * h + damping) / (1 + h * rate) ** 2 + slope
    total, stiffness = 0.0, 0.0
    for k in range(4):
        reach = p[DELTA] * REACHES[k]
        x = z[k] + h * v
        if x > reach:
            x = reach
        elif x < -reach:
            x = -reach
        else:
            stiffness += level * SHARES[k] / reach
        z[k] = x
        total += level * SHARES[k] * x / reach
    return total + viscous, stiffness * h + slope


@njit(cache=True)
def drive(step, model, data, h, every, q, v, applied, bias, damping, gravity, mass, inertia, force, origin, frame, centre, motor, twist,
          table, later, change, coupling, ratio, z, heat, reference, speed_reference, kp, kd, balance, tau_max, quantum, hold, tool, tool_load, tool_times,
          upright, tilt, tilt_times, shake, shake_f, touch_body, touch, touch_times, rotor, out):
    """Runs the controlled arm along a reference. `out` [5, samples, joints]: position, speed before and after the step, commanded torque,
    torque behind the gear."""
    n = table.shape[0]
    steps = reference.shape[0]
    load = np.zeros(n)
    before = np.zeros(n)
    rub = np.zeros(n)
    rub_slope = np.zeros(n)
    for k in range(-hold, steps):
        now = k * h
        at = k if k > 0 else 0
        on = now >= tool_times[0] and now < tool_times[1]
        mass[tool] = tool_load[0] if on else 1e-12
        for a in range(3):
            inertia[tool, a] = tool_load[1 + a] if on else 1e-14
        leaning = now >= tilt_times[0] and now < tilt_times[1]
        for a in range(3):
            gravity[a] = (tilt[a] if leaning else upright[a]) + shake[a] * np.sin(2 * np.pi * shake_f * (now + hold * h) + shake[3 + a])
        for a in range(6):
            force[touch_body, a] = 0.0
        if now > touch_times[0] and now < touch_times[1]:
            x = (now - touch_times[0]) / (touch_times[1] - touch_times[0])
            size = min(1.0, min(x, 1 - x) / 0.15)
            point = np.zeros(3)
            for a in range(3):
                force[touch_body, a] = size * touch[a]
                point[a] = origin[touch_body, a] - centre[touch_body, a]
                for b in range(3):
                    point[a] += frame[touch_body, 3 * a + b] * touch[3 + b]
            force[touch_body, 3] = point[1] * force[touch_body, 2] - point[2] * force[touch_body, 1]
            force[touch_body, 4] = point[2] * force[touch_body, 0] - point[0] * force[touch_body, 2]
            force[touch_body, 5] = point[0] * force[touch_body, 1] - point[1] * force[touch_body, 0]
        for i in range(n):
            rub[i] = 0.0
            rub_slope[i] = 0.0
        for i in range(n):
            for j in range(n):
                if coupling[i, j] != 0.0:
                    w = v[motor[i]] + ratio[i, j] * v[motor[j]]
                    x = np.tanh(100 * w)
                    steep = coupling[i, j] * 100 * (1 - x * x)
                    x *= coupling[i, j]
                    rub[i] += x
                    rub[j] += ratio[i, j] * x
                    rub_slope[i] += steep * (1 + abs(ratio[i, j]))
                    rub_slope[j] += steep * (ratio[i, j] ** 2 + abs(ratio[i, j]))
            if table[i, HOSE] != 0.0:
                j = int(table[i, HOSE_JOINT])
                x = table[i, HOSE] * np.sin(1.5 * (q[motor[i]] - 0.7 * q[motor[j]]))
                rub[i] += x
                rub[j] -= 0.7 * x
        for i in range(n):
            p = later[i] if now >= change[0] and now < change[1] else table[i]
            a = motor[i]
            angle, speed = q[a], v[a]
            soft = twist[i]
            if soft >= 0:
                angle += q[soft]
                speed += v[soft]
            command = kp[i] * (reference[at, i] - np.round(q[a] / quantum) * quantum) + balance[i] * bias[a]
            command += kd[i] * ((speed_reference[at, i] if k >= 0 else 0.0) - v[a])
            command = min(max(command, -tau_max[i]), tau_max[i])
            drag, slope = friction(p, speed, angle, 1 - p[HEAT] * heat[i], load[i], z[i], h)
            if p[HEAT] != 0.0:
                heat[i] += h / p[HEAT_TAU] * (abs(drag * speed) / p[HEAT_POWER] - heat[i])
            slope += rub_slope[i]
            drag += rub[i] + p[SPRING] * (angle - p[SPRING_Q0]) + p[RIPPLE] * np.sin(p[RIPPLE_N] * angle + p[RIPPLE_P])
            behind = command
            if soft >= 0:
                bend = q[soft]
                free = max(abs(bend) - p[GAP], 0.0)
                behind = -p[STIFF] * free * (1.0 if bend > 0 else -1.0)
                grip = p[TWIST_DAMPING] if free > 0 or p[GAP] == 0.0 else 0.02 * p[TWIST_DAMPING]
                behind -= grip * v[soft]
                damping[soft] = IMPLICIT * (grip + slope)
                applied[soft] = behind - drag + IMPLICIT * (grip + slope) * v[soft]
                damping[a] = 0.0
                applied[a] = command - drag
            else:
                damping[a] = IMPLICIT * slope
                applied[a] = command - drag + IMPLICIT * slope * v[a]
            load[i] = behind - drag
            before[i] = v[a]
            if k >= 0 and k % every == 0:
                row = k // every
                out[0, row, i] = q[a]
                out[1, row, i] = v[a]
                out[3, row, i] = command
                out[4, row, i] = behind
        call_step(step, model, data)
        for i in range(n):  # what the gear transmits: the rotor is accelerated before it
            if twist[i] < 0:
                load[i] -= rotor[motor[i]] * (v[motor[i]] - before[i]) / h
        if not abs(v[motor[0]]) + abs(v[motor[n - 1]]) < 200.0:
            out[1, 0, 0] = np.nan
            return
        if k >= 0 and k % every == 0:
            for i in range(n):
                out[2, k // every, i] = v[motor[i]]


def step_address():
    library = next(Path(mujoco.__file__).parent.glob("libmujoco.so*"))
    return ctypes.cast(ctypes.CDLL(str(library)).mj_step, ctypes.c_void_p).value


@dataclass
class Conditions:
    """What holds during one run beside the joints' own properties. Times in s since the run's first sample."""

    tool: np.ndarray = field(default_factory=lambda: np.zeros(4))  # mass, principal moments
    tool_at: np.ndarray = field(default_factory=lambda: np.zeros(3))  # of its centre of mass, from the flange
    tool_times: tuple = (1e9, 1e9)
    tilt: np.ndarray = field(default_factory=lambda: np.zeros(3))  # rotation vector, rad
    tilt_times: tuple = (1e9, 1e9)
    shake: np.ndarray = field(default_factory=lambda: np.zeros(6))  # m/s2 and phases
    shake_f: float = 0.0
    touch_link: int = 0
    touch: np.ndarray = field(default_factory=lambda: np.zeros(6))  # N in the base's axes; point in the link's frame
    touch_times: tuple = (1e9, 1e9)


class Plant:
    """One arm with its joints' properties and controller, ready to run."""

    def __init__(self, arm, table, controller, mounting, rotor=None, coupling=None, ratio=None):
        self.arm, self.table, self.controller = arm, table, controller
        self.gravity = arms.gravity_vector(*mounting)
        elastic = [i for i in range(arm.n) if table[i, STIFF] > 0]
        self.model = mujoco.MjModel.from_xml_string(arms.mjcf(arm, STEP, rotor, elastic))
        self.data = mujoco.MjData(self.model)
        dof = lambda name: self.model.joint(name).dofadr[0]
        self.motor = np.array([dof(f"joint{i + 1}") for i in range(arm.n)], np.int64)
        self.twist = np.array([dof(f"twist{i + 1}") if i in elastic else -1 for i in range(arm.n)], np.int64)
        self.coupling = np.zeros((arm.n, arm.n)) if coupling is None else coupling
        self.ratio = np.zeros((arm.n, arm.n)) if ratio is None else ratio
        self.heat = np.zeros(arm.n)
        self.change = None  # two times in s, and the joints' properties between them
        self.step = step_address()

    def run(self, reference, every, conditions):
        """Noise-free samples [5, samples, joints] along a reference that is given at every simulation step."""
        model, data, c, n = self.model, self.data, conditions, self.arm.n
        mujoco.mj_resetData(model, data)
        data.qpos[self.motor] = reference[0]
        model.opt.gravity[:] = self.gravity
        tool = model.body("tool").id
        model.body_ipos[tool] = c.tool_at
        mujoco.mj_forward(model, data)
        tilt = self.gravity
        if np.any(c.tilt):
            quat, tilt = np.zeros(4), np.zeros(3)
            angle = np.linalg.norm(c.tilt)
            mujoco.mju_axisAngle2Quat(quat, c.tilt / angle, angle)
            mujoco.mju_rotVecQuat(tilt, self.gravity, quat)
        speed = np.gradient(reference, STEP, axis=0)
        out = np.zeros((5, len(reference) // every, n))
        kp, kd, balance, quantum = self.controller
        change, later = self.change or ((1e9, 1e9), self.table)
        drive(self.step, model._address, data._address, STEP, every, data.qpos, data.qvel, data.qfrc_applied, data.qfrc_bias,
              model.dof_damping, model.opt.gravity, model.body_mass, model.body_inertia, data.xfrc_applied, data.xpos, data.xmat, data.xipos,
              self.motor, self.twist, self.table, later, np.array(change, float), self.coupling, self.ratio, np.zeros((n, 4)), self.heat, reference[: out.shape[1] * every],
              speed, kp, kd, balance, self.arm.tau_max * 1.5, quantum, int(HOLD / STEP), tool, c.tool, np.array(c.tool_times, float),
              self.gravity.copy(), tilt, np.array(c.tilt_times, float), c.shake, c.shake_f, model.body(f"link{c.touch_link + 1}").id, c.touch,
              np.array(c.touch_times, float), model.dof_armature, out)
        if not np.isfinite(out).all() or np.abs(out[1]).max() > 30:
            raise FloatingPointError("the simulated arm diverged")
        return out


def controller(rng, arm, quantum):
    """PD gains from the mean inertia, and a gravity compensation that is off by up to a sixth."""
    model = mujoco.MjModel.from_xml_string(arms.mjcf(arm, STEP))
    data = mujoco.MjData(model)
    full = np.zeros((arm.n, arm.n))
    seen = np.zeros((20, arm.n))
    for k in range(20):
        data.qpos[:] = rng.uniform(arm.q_min, arm.q_max)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        seen[k] = np.diag(full)
    inertia = seen.mean(axis=0)
    w = 2 * np.pi * rng.uniform(3.5, 7.0)
    return (inertia * w * w, 1.6 * inertia * w, rng.uniform(0.85, 1.1, arm.n), quantum), inertia
