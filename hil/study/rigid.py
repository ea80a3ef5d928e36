"""Regressor of the rigid body by Newton and Euler's recursion, compiled: columns per link as Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m."""

import numpy as np
from numba import njit


@njit(cache=True)
def cross(a, b):
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True)
def regressor(dh, gravity, base, q, v, a, out):
    """Fills `out` [samples, joints, base columns] of the arm's torque along a motion."""
    n = len(dh)
    y = np.zeros((n, 10 * n))
    r = np.zeros((n, 3, 3))
    p = np.zeros((n, 3))
    wrench = np.zeros((6, 10))
    for k in range(len(q)):
        y[:] = 0.0
        w, dw, acc = np.zeros(3), np.zeros(3), -gravity
        for i in range(n):
            sa, ca = np.sin(dh[i, 1]), np.cos(dh[i, 1])
            st, ct = np.sin(dh[i, 3] + q[k, i]), np.cos(dh[i, 3] + q[k, i])
            r[i, 0] = np.array([ct, -st, 0.0])
            r[i, 1] = np.array([st * ca, ct * ca, -sa])
            r[i, 2] = np.array([st * sa, ct * sa, ca])
            p[i] = np.array([dh[i, 0], -sa * dh[i, 2], ca * dh[i, 2]])
            acc = r[i].T @ (acc + cross(dw, p[i]) + cross(w, cross(w, p[i])))
            w, dw = r[i].T @ w, r[i].T @ dw
            z = np.array([0.0, 0.0, 1.0])
            dw = dw + a[k, i] * z + v[k, i] * cross(w, z)
            w = w + v[k, i] * z
            # wrench of link i about its own origin per unit of each parameter
            wrench[:] = 0.0
            s = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
            spin = np.array([[0.0, -dw[2], dw[1]], [dw[2], 0.0, -dw[0]], [-dw[1], dw[0], 0.0]]) + s @ s
            for c in range(3):
                for b in range(3):
                    wrench[b, 6 + c] = spin[b, c]  # force = m acc + (spin) l
            wrench[0:3, 9] = acc
            wrench[3, 7], wrench[3, 8] = acc[2], -acc[1]  # moment = L dw + w x L w + l x acc
            wrench[4, 6], wrench[4, 8] = -acc[2], acc[0]
            wrench[5, 6], wrench[5, 7] = acc[1], -acc[0]
            column = 0
            for b in range(3):
                for c in range(b, 3):
                    unit = np.zeros((3, 3))
                    unit[b, c] = unit[c, b] = 1.0
                    wrench[3:6, column] = unit @ dw + cross(w, unit @ w)
                    column += 1
            for m in range(10):
                f, t = wrench[0:3, m].copy(), wrench[3:6, m].copy()
                for j in range(i, -1, -1):
                    y[j, 10 * i + m] = t[2]
                    f, t = r[j] @ f, r[j] @ t
                    t = t + cross(p[j], f)
        for m in range(len(base)):
            for j in range(n):
                out[k, j, m] = y[j, base[m]]
