"""Writes C code for the Panda's torque and base regressor with CasADi: python casadi_arm.py OUT.c

The parameters are constants of the code (45 base parameters in the slots of their names, as in a paper's table; their
values do not matter for speed), so that CasADi drops every product with a zero.
"""

import os
import sys

import casadi as ca

HALF_PI = 1.5707963267948966
# a, alpha, d of modified Denavit-Hartenberg rows.
ROWS = [
    (0.0, 0, 0.333),
    (0.0, -1, 0.0),
    (0.0, 1, 0.316),
    (0.0825, 1, 0.0),
    (-0.0825, -1, 0.384),
    (0.0, 1, 0.0),
    (0.088, 1, 0.0),
]
GRAVITY = [9.81, 0.0, 0.0]
KEPT = [[5, 6, 7]] + 6 * [[0, 1, 2, 4, 5, 6, 7]]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def add(a, b):
    return [x + y for x, y in zip(a, b)]


def untwist(sa, v):
    """Rx(alpha)' v for a right angle."""
    return v if sa == 0 else [v[0], sa * v[2], -sa * v[1]]


def twist(sa, v):
    return v if sa == 0 else [v[0], -sa * v[2], sa * v[1]]


def rnea(q, dq, ddq, links):
    zero = [ca.SX(0)] * 3
    w, dw, a = zero, zero, [-g + ca.SX(0) for g in GRAVITY]
    forces, moments, angles = [], [], []
    for i, (length, sa, d) in enumerate(ROWS):
        s, c = ca.sin(q[i]), ca.cos(q[i])
        p = [length, -sa * d, 0.0 if sa else d]
        angles.append((s, c, p))
        a = add(a, add(cross(dw, p), cross(w, cross(w, p))))
        turn = lambda v: [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]]
        w, dw, a = (turn(untwist(sa, v)) for v in (w, dw, a))
        dw = add(dw, [w[1] * dq[i], -w[0] * dq[i], ddq[i]])
        w = add(w, [0, 0, dq[i]])
        xx, xy, xz, yy, yz, zz, x, y, z, m = links[i]
        inertia = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        times = lambda v: [sum(inertia[r][k] * v[k] for k in range(3)) for r in range(3)]
        first = [x, y, z]
        forces.append(add([m * v for v in a], add(cross(dw, first), cross(w, cross(w, first)))))
        moments.append(add(add(times(dw), cross(w, times(w))), cross(first, a)))
    tau = [None] * 7
    for i in reversed(range(7)):
        tau[i] = moments[i][2]
        if i:
            s, c, p = angles[i]
            back = lambda v: twist(ROWS[i][1], [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])
            f, n = back(forces[i]), back(moments[i])
            forces[i - 1] = add(forces[i - 1], f)
            moments[i - 1] = add(moments[i - 1], add(n, cross(p, f)))
    return ca.vertcat(*tau)


q, dq, ddq = (ca.SX.sym(name, 7) for name in ("q", "dq", "ddq"))
constant = lambda i, slot: 0.01 * (1 + (7 * i + 3 * slot) % 13) if slot in KEPT[i] else 0.0
tau = rnea(q, dq, ddq, [[constant(i, slot) for slot in range(10)] for i in range(7)])
whole = ca.vertcat(*[tau[j] + 0.1 * (j + 1) * dq[j] + 0.2 * (j + 1) * ca.tanh(100 * dq[j]) for j in range(7)])
beta = ca.SX.sym("beta", sum(len(kept) for kept in KEPT))
names = iter(range(beta.shape[0]))
symbols = [[beta[next(names)] if slot in KEPT[i] else ca.SX(0) for slot in range(10)] for i in range(7)]
regressor = ca.densify(ca.jacobian(rnea(q, dq, ddq, symbols), beta))

out = os.path.abspath(sys.argv[1])
os.chdir(os.path.dirname(out))
code = ca.CodeGenerator(os.path.basename(out), {"with_header": True})
for name, value in (("rigid", tau), ("whole", whole), ("base_regressor", regressor)):
    function = ca.Function(name, [q, dq, ddq], [ca.cse(value)])
    print(f"{name}: {function.n_instructions()} instructions", file=sys.stderr)
    code.add(function)
code.generate()
