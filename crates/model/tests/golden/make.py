"""Golden values from Pinocchio: joint torques, regressors and end-effector positions of random states.

    python -m venv venv && venv/bin/pip install -r crates/model/tests/golden/requirements.txt
    venv/bin/python crates/model/tests/golden/make.py          (writes crates/model/tests/golden/dynamics.json)

Kinematics come from config/robots/*.toml and crates/model/tests/golden/robots/*.toml, read here without any of plumbline's code. Inertial
parameters, states and mountings are random, from a fixed seed.

Conventions. A link frame has the joint's axis as z and moves with the link. Pinocchio orders a body's parameters
[m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] with the inertia about the body frame's origin; plumbline orders them
[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m] (paper eq. 5), about the same point.
"""

import json
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]
CASES = 5
# Column of Pinocchio's parameter vector for each of plumbline's.
ORDER = [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]


def rot_x(angle):
    return pin.SE3(pin.utils.rotate("x", angle), np.zeros(3))


def rot_z(angle):
    return pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))


def shift(x, y, z):
    return pin.SE3(np.eye(3), np.array([x, y, z], dtype=float))


def kinematics(robot):
    """Placement of each joint in the frame of the link before it, and of the flange in the last link's frame."""
    flange = robot.get("flange", {})
    tool = pin.SE3(pin.rpy.rpyToMatrix(np.array(flange.get("rpy", [0.0] * 3), dtype=float)), np.array(flange.get("xyz", [0.0] * 3)))
    placements = []
    if robot["convention"] == "modified-dh":
        for row in robot["joint"]:
            before = rot_x(row["alpha"]) * shift(row["a"], 0, 0)
            placements.append(before * rot_z(row.get("theta", 0.0)) * shift(0, 0, row["d"]))
        return placements, tool
    before = pin.SE3.Identity()
    for row in robot["joint"]:
        placements.append(before * rot_z(row.get("theta", 0.0)) * shift(0, 0, row["d"]))
        before = shift(row["a"], 0, 0) * rot_x(row["alpha"])
    return placements, before * tool


def random_inertia(rng):
    mass = rng.uniform(0.5, 8.0)
    com = rng.uniform(-0.2, 0.2, 3)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    second = axes @ np.diag(rng.uniform(0.001, 0.05, 3)) @ axes.T
    about_com = np.trace(second) * np.eye(3) - second
    return pin.Inertia(mass, com, about_com)


def standard_parameters(inertia):
    """plumbline's ten numbers, by the parallel axis theorem; checked against Pinocchio's own."""
    m, c = inertia.mass, inertia.lever
    about_origin = inertia.inertia + m * (c @ c * np.eye(3) - np.outer(c, c))
    i = about_origin
    own = np.array([i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2], *(m * c), m])
    assert np.allclose(own, inertia.toDynamicParameters()[ORDER], rtol=0, atol=1e-14)
    return own


def build(robot, rng):
    model = pin.Model()
    placements, flange = kinematics(robot)
    parent, links = 0, []
    for index, (row, placement) in enumerate(zip(robot["joint"], placements)):
        slides = row.get("kind", "revolute") == "prismatic"
        joint = pin.JointModelPZ() if slides else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, placement, f"joint{index + 1}")
        inertia = random_inertia(rng)
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        links.append(standard_parameters(inertia).tolist())
    return model, flange, links


def golden(path, rng):
    robot = tomllib.loads(path.read_text())
    model, flange, links = build(robot, rng)
    data, n, cases = model.createData(), model.nq, []
    for case in range(CASES):
        # Upright, on a wall, hanging, then anywhere (paper eq. 3).
        rho, phi = [(np.pi, 0.0), (np.pi / 2, 0.0), (0.0, 0.0)][case] if case < 3 else (rng.uniform(0, np.pi), rng.uniform(-np.pi, np.pi))
        gravity = 9.81 * np.array([np.sin(rho) * np.cos(phi), np.sin(rho) * np.sin(phi), np.cos(rho)])
        model.gravity.linear = gravity
        q, dq, ddq = rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(-5, 5, n)
        tau = pin.rnea(model, data, q, dq, ddq).copy()
        regressor = pin.computeJointTorqueRegressor(model, data, q, dq, ddq)
        regressor = np.hstack([regressor[:, 10 * link : 10 * link + 10][:, ORDER] for link in range(n)])
        assert np.allclose(regressor @ np.ravel(links), tau, rtol=0, atol=1e-10)
        # A link loads only the joints up to its own, so the rest is not written.
        rows = [regressor[joint, 10 * joint :].tolist() for joint in range(n)]
        assert all(not regressor[joint, : 10 * joint].any() for joint in range(n))
        pin.forwardKinematics(model, data, q)
        end = (data.oMi[n] * flange).translation
        cases.append({"gravity": gravity.tolist(), "q": q.tolist(), "dq": dq.tolist(), "ddq": ddq.tolist(), "tau": tau.tolist(),
                      "regressor": rows, "end_effector": end.tolist()})
    return {"file": str(path.relative_to(ROOT)), "links": links, "cases": cases}


def main():
    rng = np.random.default_rng(20240607)
    files = sorted((ROOT / "config" / "robots").glob("*.toml")) + sorted((HERE / "robots").glob("*.toml"))
    robots = [golden(path, rng) for path in files]
    versions = {"pin": pin.__version__, "numpy": np.__version__}
    text = json.dumps({"made_by": "crates/model/tests/golden/make.py", "versions": versions, "robots": robots}, separators=(",", ":"))
    (HERE / "dynamics.json").write_text(text.replace('{"file"', '\n{"file"') + "\n")


if __name__ == "__main__":
    main()
