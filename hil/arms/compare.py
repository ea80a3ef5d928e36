"""Compares an imported arm with Pinocchio's reading of the same URDF, along random states.

    compare.py ARM.urdf ROBOT.toml sim-ROBOT-arm.toml            kinematics, and torques of the simulated arm's bodies
    compare.py ARM.urdf ROBOT.toml EXPORTED.urdf model.toml      torques of the exported model, against the identified errors

The robot file is read here without any of plumbline's code. Pinocchio reads both URDFs itself; joints beside the arm are locked at zero.
"""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin

urdf, robot_file, other, *model_file = sys.argv[1:]
robot = tomllib.loads(Path(robot_file).read_text())
names = [line[2:].split(";")[0] for line in Path(robot_file).read_text().splitlines() if line.endswith("a URDF has none.")]
tool = robot_file and [line for line in Path(robot_file).read_text().splitlines() if line.startswith("# ") and "the flange is" in line][0].split("`")[1]
rng = np.random.default_rng(5)


def read(path):
    """A URDF's model, whatever prefixes it forgot to declare."""
    text = Path(path).read_text()
    for prefix in ("drake", "gazebo", "xacro"):
        if f"<{prefix}:" in text and f"xmlns:{prefix}" not in text:
            text = text.replace("<robot", f'<robot xmlns:{prefix}="{prefix}"', 1)
    return pin.buildModelFromXML(text)


def pose(table):
    table = table or {}
    rotation = pin.rpy.rpyToMatrix(np.array(table.get("rpy", [0.0] * 3), dtype=float))
    return pin.SE3(rotation, np.array(table.get("xyz", [0.0] * 3), dtype=float))


def row(joint):
    turn = lambda axis, angle: pin.SE3(pin.utils.rotate(axis, angle), np.zeros(3))
    shift = lambda x, z: pin.SE3(np.eye(3), np.array([x, 0.0, z]))
    return turn("x", joint["alpha"]) * shift(joint["a"], 0) * turn("z", joint["theta"]) * shift(0, joint["d"])


theirs = read(urdf)
locked = [theirs.getJointId(name) for name in theirs.names[1:] if name not in names]
theirs = pin.buildReducedModel(theirs, locked, pin.neutral(theirs))
assert list(theirs.names)[1:] == names, (list(theirs.names), names)
n = len(names)


def configuration(q):
    """Pinocchio holds a continuous joint as cosine and sine."""
    parts = []
    for joint, angle in zip(theirs.joints[1:], q):
        parts += [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
    return np.array(parts)


def ours():
    model = pin.Model()
    parent = 0
    for index, joint in enumerate(robot["joint"]):
        kind = pin.JointModelPZ() if joint.get("kind") == "prismatic" else pin.JointModelRZ()
        at = row(joint)
        parent = model.addJoint(parent, kind, (pose(robot.get("base")) * at) if index == 0 else at, names[index])
    return model


def states():
    low = np.array([joint["q-min"] for joint in robot["joint"]])
    high = np.array([joint["q-max"] for joint in robot["joint"]])
    speed = np.array([joint["dq"] for joint in robot["joint"]])
    for _ in range(200):
        yield rng.uniform(low, high), rng.uniform(-1, 1, n) * speed, rng.uniform(-3, 3, n)


their_data = theirs.createData()
scale = 0.0
worst_torque = np.zeros(n)
worst_end = 0.0
gravity = np.array([9.81 * 0.6, 0.0, -9.81 * 0.8])
theirs.gravity.linear = gravity
if not model_file:
    arm = tomllib.loads(Path(other).read_text())
    mine = ours()
    for index, link in enumerate(arm["link"]):
        xx, xy, xz, yy, yz, zz = link["inertia"]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        mine.appendBodyToJoint(index + 1, pin.Inertia(link["mass"], np.array(link["com"]), inertia), pin.SE3.Identity())
else:
    mine = read(other)
mine.gravity.linear = gravity
data = mine.createData()
frame = theirs.getFrameId(tool)
for q, dq, ddq in states():
    pin.framesForwardKinematics(theirs, their_data, configuration(q))
    wanted = pin.rnea(theirs, their_data, configuration(q), dq, ddq).copy()
    found = pin.rnea(mine, data, q, dq, ddq).copy()
    worst_torque = np.maximum(worst_torque, np.abs(found - wanted))
    scale = max(scale, np.abs(wanted).max())
    if not model_file:
        pin.forwardKinematics(mine, data, q)
        end = data.oMi[n] * pose(robot.get("flange"))
        worst_end = max(worst_end, np.abs(end.translation - their_data.oMf[frame].translation).max())

name = robot["name"]
if not model_file:
    # Right angles with four digits in the URDF are right angles here: up to 4e-6 rad each.
    print(f"{name}: Pinocchio {pin.__version__}: tool within {worst_end:.1e} m, torque within {worst_torque.max():.1e} Nm of up to {scale:.0f} Nm")
    sys.exit(not (worst_end < 2e-5 and worst_torque.max() < 1e-4 * scale))
noise = tomllib.loads(Path(model_file[0]).read_text())["noise-floor"]
print(f"{name}: exported model, torque within {np.round(worst_torque, 3).tolist()} Nm of the URDF's along random states (largest {scale:.0f} Nm)")
# The error of the parameters, at random states far beyond the motions: a few noise floors.
sys.exit(not np.all(worst_torque < 3.0 * np.array(noise) + 0.01 * scale))
