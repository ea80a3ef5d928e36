"""Arms of the study: kinematics from a robot file, random physical inertias, and the MuJoCo model written from both.

Link frames are modified-DH frames (Craig); a standard-DH table is rewritten as the equivalent modified one, so that the inertial
parameters of a link mean what `report.json` calls `Lxx3` or `m5`.
"""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

ROBOTS = Path(__file__).resolve().parents[2] / "config" / "robots"
GRAVITY = 9.81
MOUNTINGS = {"upright": (np.pi, 0.0), "wall": (np.pi / 2, 0.0), "ceiling": (0.0, 0.0)}


@dataclass
class Arm:
    """Kinematics, limits and the bodies of one arm. Row i of `dh`: a, alpha, d, theta of modified DH."""

    name: str
    kind: str
    dh: np.ndarray
    flange: np.ndarray
    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray
    ddq_max: np.ndarray
    tau_max: np.ndarray
    sensing: str
    description: str | None = None  # text of the robot file where the robot does not ship
    mass: np.ndarray = field(default=None)
    com: np.ndarray = field(default=None)  # [n, 3] m, in the link's frame
    inertia: np.ndarray = field(default=None)  # [n, 3, 3] kg m2, about the centre of mass
    rotor: np.ndarray = field(default=None)  # kg m2, reflected to the joint; part of the measured torque where motors sense it

    @property
    def n(self):
        return len(self.dh)

    def next_origin(self, i):
        """Origin of the frame after frame i, in frame i: where the body of link i leads to."""
        if i + 1 == self.n:
            return self.flange
        a, alpha, d, _ = self.dh[i + 1]
        return np.array([a, -np.sin(alpha) * d, np.cos(alpha) * d])

    def standard_parameters(self):
        """Inertial parameters by name, about the origin of each link's frame, and rotor inertias."""
        names = {}
        for i in range(self.n):
            m, c = self.mass[i], self.com[i]
            about = self.inertia[i] + m * (c @ c * np.eye(3) - np.outer(c, c))
            k = i + 1
            for a, x in enumerate("xyz"):
                names[f"l{x}{k}"] = m * c[a]
                for b in range(a, 3):
                    names[f"L{x}{'xyz'[b]}{k}"] = about[a, b]
            names[f"m{k}"] = m
            names[f"ia{k}"] = names[f"Ia{k}"] = self.rotor[i]
        return names


def rotation(alpha, theta):
    """Rx(alpha) Rz(theta)."""
    sa, ca, st, ct = np.sin(alpha), np.cos(alpha), np.sin(theta), np.cos(theta)
    return np.array([[ct, -st, 0], [st * ca, ct * ca, -sa], [st * sa, ct * sa, ca]])


def forward(arm, q):
    """Origins of the link frames by the DH formula alone: the check of the MuJoCo model."""
    r, p, origins = np.eye(3), np.zeros(3), []
    for (a, alpha, d, theta), angle in zip(arm.dh, q):
        p = p + r @ np.array([a, -np.sin(alpha) * d, np.cos(alpha) * d])
        r = r @ rotation(alpha, theta + angle)
        origins.append(p)
    return np.array(origins), r


def shipped(name, kind):
    return load(ROBOTS / f"{name}.toml", kind)


def load(path, kind):
    data = tomllib.loads(path.read_text())
    name = data["name"]
    joints = data["joint"]
    rows = np.array([[j["a"], j["alpha"], j["d"], j.get("theta", 0.0)] for j in joints])
    flange = np.array(data.get("flange", {}).get("xyz", [0.0, 0.0, 0.0]))
    if data["convention"] == "standard-dh":
        last_a, last_alpha = rows[-1, 0], rows[-1, 1]
        rows[1:, :2] = rows[:-1, :2].copy()
        rows[0, :2] = 0.0
        flange = rotation(last_alpha, 0.0) @ flange + np.array([last_a, 0.0, 0.0])
    column = lambda key: np.array([float(j[key]) for j in joints])
    q_min, q_max = np.maximum(column("q-min"), -3.0), np.minimum(column("q-max"), 3.9)
    return Arm(name, kind, rows, flange, q_min, q_max, column("dq"), column("ddq"), column("tau"), data["torque-sensing"])


def random_chain(rng, n):
    """A serial arm of random right-angled geometry, without neighbouring axes that coincide."""
    rows = np.zeros((n, 4))
    rows[0, 2] = rng.uniform(0.2, 0.4)
    reach = 1.0
    for i in range(1, n):
        twist = rng.choice([0.0, 1.5707963267948966, -1.5707963267948966], p=[0.2, 0.4, 0.4])
        if i > 1 and twist == 0.0 and rows[i - 1, 1] == 0.0:
            twist = 1.5707963267948966
        rows[i, 1] = twist
        rows[i, 0] = rng.uniform(0.2, 0.45) * reach if twist == 0.0 else rng.choice([0.0, rng.uniform(0.04, 0.3) * reach])
        rows[i, 2] = 0.0 if rng.random() < 0.5 else rng.uniform(0.1, 0.35) * reach
        reach *= 0.85
    half = rng.uniform(1.6, 2.9, n)
    middle = rng.uniform(-0.3, 0.3, n)
    size = np.linspace(1.0, 0.25, n)
    arm = Arm(
        f"random-{n}r", "random", rows.round(4), np.array([0.0, 0.0, 0.1]), (middle - half).round(3), (middle + half).round(3),
        rng.uniform(1.5, 2.8, n).round(2), np.full(n, 12.0), (120 * size**1.5).round(1), rng.choice(["link", "motor"], p=[0.6, 0.4]),
    )
    arm.dh[:, 1] = rows[:, 1]  # right angles keep all digits
    text = [f'name = "{arm.name}"', 'full-name = "Random arm of the study"', 'source = "hil/study, drawn from a seed"',
            'convention = "modified-dh"', f'torque-sensing = "{arm.sensing}"']
    for i in range(n):
        a, alpha, d, _ = arm.dh[i]
        text += ["", "[[joint]]", f"a = {a!r}", f"alpha = {alpha!r}", f"d = {d!r}", f"q-min = {arm.q_min[i]!r}", f"q-max = {arm.q_max[i]!r}",
                 f"dq = {arm.dq_max[i]!r}", "ddq = 12.0", "jerk = 5000.0", f"tau = {arm.tau_max[i]!r}", "dtau = 2000.0"]
    text += ["", "[flange]", "xyz = [0.0, 0.0, 0.1]", ""]
    arm.description = "\n".join(text).replace("np.float64(", "").replace(")", "")
    return arm


MASSES = {  # of the heaviest version, kg
    "panda": [4.9, 3.6, 3.2, 3.4, 3.0, 1.8, 0.8],
    "ur10e": [7.4, 13.0, 4.0, 2.1, 2.0, 0.6],
    "paper-2dof": [3.0, 4.0],
}


def draw(rng, kind):
    """An arm of a kind ("7r", "6r", "2r", "random") with bodies of its own."""
    if kind == "7r":
        arm = shipped("panda", kind)
    elif kind == "6r":
        arm = shipped("ur10e", kind)
    elif kind == "2r":
        arm = shipped("paper-2dof", kind)
    else:
        arm = random_chain(rng, int(rng.integers(4, 8)))
    n = arm.n
    masses = np.array(MASSES.get(arm.name, np.geomspace(6.0, 0.8, n)))
    arm.mass = masses * rng.uniform(0.75, 1.15, n)
    arm.com, arm.inertia = np.zeros((n, 3)), np.zeros((n, 3, 3))
    for i in range(n):
        along = arm.next_origin(i)
        length = np.linalg.norm(along)
        arm.com[i] = rng.uniform(0.3, 0.6) * along + rng.normal(0, 0.02, 3)
        # a box of uniform density, turned at random: its principal moments satisfy the triangle inequalities
        width = rng.uniform(0.06, 0.14, 3)
        axis = along / length if length > 0.02 else np.array([0.0, 0.0, 1.0])
        frame = np.linalg.qr(np.column_stack([axis + 0.1 * rng.normal(size=3), rng.normal(size=(3, 2))]))[0]
        side = np.array([length + width[0], width[1], width[2]])
        moments = arm.mass[i] / 12 * (np.sum(side**2) - side**2)
        arm.inertia[i] = frame @ np.diag(moments) @ frame.T
    arm.rotor = rng.uniform(0.2, 0.8, n) * arm.tau_max / 100.0
    return arm


def quaternion(matrix):
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(matrix).ravel())
    return " ".join(repr(float(x)) for x in out)


def mjcf(arm, timestep, rotor=None, elastic=()):
    """The MuJoCo model. An `elastic` joint is two hinges about one axis: the motor's, which holds the rotor, and the gear's twist."""
    rotor = arm.rotor if rotor is None else rotor
    text = lambda values: " ".join(repr(float(x)) for x in values)
    xml = [f'<mujoco><compiler angle="radian" balanceinertia="false"/><option timestep="{timestep!r}" integrator="Euler">'
           '<flag contact="disable" constraint="disable"/></option><worldbody>']
    for i in range(arm.n):
        a, alpha, d, theta = arm.dh[i]
        position = np.array([a, -np.sin(alpha) * d, np.cos(alpha) * d])
        xml.append(f'<body name="link{i + 1}" pos="{text(position)}" quat="{quaternion(rotation(alpha, theta))}">')
        xml.append(f'<joint name="joint{i + 1}" type="hinge" axis="0 0 1" limited="false" armature="{float(rotor[i])!r}"/>')
        if i in elastic:
            xml.append(f'<joint name="twist{i + 1}" type="hinge" axis="0 0 1" limited="false"/>')
        full = arm.inertia[i]
        xml.append(f'<inertial mass="{float(arm.mass[i])!r}" pos="{text(arm.com[i])}" '
                   f'fullinertia="{text([full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]])}"/>')
    xml.append(f'<body name="tool" pos="{text(arm.flange)}"><inertial mass="1e-12" pos="0 0 0" diaginertia="1e-14 1e-14 1e-14"/></body>')
    xml.append("</body>" * arm.n + "</worldbody></mujoco>")
    return "".join(xml)


def gravity_vector(rho, phi):
    return GRAVITY * np.array([np.sin(rho) * np.cos(phi), np.sin(rho) * np.sin(phi), np.cos(rho)])
