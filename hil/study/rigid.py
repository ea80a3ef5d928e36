"""Regressor of the rigid body by Newton and Euler's recursion, compiled: columns per link as Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m."""

import numpy as np
from numba import njit


@njit(cache=True)
def turn(r, x, y, z):
    return (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z, r[1, 0] * x + r[1, 1] * y + r[1, 2] * z, r[2, 0] * x + r[2, 1] * y + r[2, 2] * z)


@njit(cache=True)
def back(r, x, y, z):
    return (r[0, 0] * x + r[1, 0] * y + r[2, 0] * z, r[0, 1] * x + r[1, 1] * y + r[2, 1] * z, r[0, 2] * x + r[1, 2] * y + r[2, 2] * z)


@njit(cache=True)
def cross(ax, ay, az, bx, by, bz):
    return (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


@njit(cache=True)
def regressor(dh, gravity, wanted, q, v, a, out):
    """Fills `out` [samples, joints, columns] of the arm's torque along a motion; `wanted` [10 n] is a column's place in it, or -1."""
    n = len(dh)
    r = np.zeros((n, 3, 3))
    p = np.zeros((n, 3))
    f = np.zeros((10, 6))  # force and moment of one link about its origin, per unit of each parameter
    pairs = np.array([[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]])
    w, dw, s = np.zeros(3), np.zeros(3), np.zeros(3)
    out[:] = 0.0
    for k in range(len(q)):
        w[:], dw[:] = 0.0, 0.0
        s[:] = -gravity
        for i in range(n):
            sa, ca = np.sin(dh[i, 1]), np.cos(dh[i, 1])
            st, ct = np.sin(dh[i, 3] + q[k, i]), np.cos(dh[i, 3] + q[k, i])
            r[i, 0, 0], r[i, 0, 1], r[i, 0, 2] = ct, -st, 0.0
            r[i, 1, 0], r[i, 1, 1], r[i, 1, 2] = st * ca, ct * ca, -sa
            r[i, 2, 0], r[i, 2, 1], r[i, 2, 2] = st * sa, ct * sa, ca
            p[i, 0], p[i, 1], p[i, 2] = dh[i, 0], -sa * dh[i, 2], ca * dh[i, 2]
            e = cross(dw[0], dw[1], dw[2], p[i, 0], p[i, 1], p[i, 2])
            c = cross(w[0], w[1], w[2], p[i, 0], p[i, 1], p[i, 2])
            c = cross(w[0], w[1], w[2], c[0], c[1], c[2])
            s[0], s[1], s[2] = back(r[i], s[0] + e[0] + c[0], s[1] + e[1] + c[1], s[2] + e[2] + c[2])
            w[0], w[1], w[2] = back(r[i], w[0], w[1], w[2])
            dw[0], dw[1], dw[2] = back(r[i], dw[0], dw[1], dw[2])
            dw[0] += v[k, i] * w[1]
            dw[1] -= v[k, i] * w[0]
            dw[2] += a[k, i]
            w[2] += v[k, i]
            f[:] = 0.0
            for m in range(6):
                b, c2 = pairs[m]
                l0, l1, l2, u0, u1, u2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for x, y in ((b, c2), (c2, b)):
                    if b == c2 and x == b and l0 + l1 + l2 + u0 + u1 + u2 != 0.0:
                        continue
                    if x == 0:
                        l0, u0 = dw[y], w[y]
                    elif x == 1:
                        l1, u1 = dw[y], w[y]
                    else:
                        l2, u2 = dw[y], w[y]
                g = cross(w[0], w[1], w[2], u0, u1, u2)
                f[m, 3], f[m, 4], f[m, 5] = l0 + g[0], l1 + g[1], l2 + g[2]
            ww = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
            for c3 in range(3):
                for b3 in range(3):
                    f[6 + c3, b3] = w[b3] * w[c3]
                f[6 + c3, c3] -= ww
            f[6, 1] += dw[2]
            f[6, 2] -= dw[1]
            f[7, 0] -= dw[2]
            f[7, 2] += dw[0]
            f[8, 0] += dw[1]
            f[8, 1] -= dw[0]
            f[9, 0], f[9, 1], f[9, 2] = s[0], s[1], s[2]
            f[6, 4], f[6, 5] = -s[2], s[1]
            f[7, 3], f[7, 5] = s[2], -s[0]
            f[8, 3], f[8, 4] = -s[1], s[0]
            for m in range(10):
                place = wanted[10 * i + m]
                if place < 0:
                    continue
                x, y, z, tx, ty, tz = f[m]
                for j in range(i, -1, -1):
                    out[k, j, place] = tz
                    x, y, z = turn(r[j], x, y, z)
                    tx, ty, tz = turn(r[j], tx, ty, tz)
                    e = cross(p[j, 0], p[j, 1], p[j, 2], x, y, z)
                    tx, ty, tz = tx + e[0], ty + e[1], tz + e[2]
