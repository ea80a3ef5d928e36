"""Reference motions: Fourier series with pauses, quintic point-to-point, random splines as a person teaches them."""

import numpy as np
from scipy.interpolate import CubicSpline


def within_limits(arm, t, q, reach, speed):
    """Centres and scales a motion [samples, joints] inside the ranges, speeds and accelerations of the arm."""
    low, high = arm.q_min + 0.05, arm.q_max - 0.05
    span = np.ptp(q, axis=0) + 1e-9
    scale = reach * (high - low) / span
    for order, limit in ((1, arm.dq_max), (2, arm.ddq_max)):
        slope = np.gradient(q, t, axis=0) if order == 1 else np.gradient(np.gradient(q, t, axis=0), t, axis=0)[3:-3]
        scale = np.minimum(scale, speed * limit / (np.abs(slope).max(axis=0) + 1e-9))
    return scale, low, high


def place(rng, arm, q, scale, low, high):
    q = (q - q.min(axis=0)) * scale
    room = np.maximum(high - low - np.ptp(q, axis=0), 0.0)
    return q + low + room * rng.uniform(0.2, 0.8, arm.n)


def warp(rng, t, period, pauses):
    """Phase with smooth pauses: its rate falls to zero around each pause."""
    rate = np.ones_like(t)
    for centre in rng.uniform(0.15, 0.85, pauses) * period:
        width = rng.uniform(0.15, 0.35)
        x = np.abs(t - centre) / width
        rate *= np.where(x < 1, 0.0, np.where(x < 2.5, 0.5 - 0.5 * np.cos(np.pi * (x - 1) / 1.5), 1.0))
    phase = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    return phase / phase[-1] * period


def periodic(rng, arm, period, step, style):
    """One period, sampled at every step; the sample after the last equals the first."""
    count = int(round(period / step))
    t = np.arange(count + 1) * step
    if style == "fourier":
        phase = warp(rng, t, period, int(rng.integers(0, 3)))
        w = 2 * np.pi / period
        q = np.zeros((count + 1, arm.n))
        for k in range(1, int(rng.integers(4, 8))):
            a, b = rng.normal(size=(2, arm.n)) / k**0.5
            q += a * np.sin(k * w * phase)[:, None] + b * np.cos(k * w * phase)[:, None]
    elif style == "points":
        q = quintic(rng, arm.n, t, closed=True)
    else:
        knots = np.concatenate([[0], np.sort(rng.uniform(0.05, 0.95, int(period / 0.8))), [1]]) * period
        knots = knots[np.concatenate([[True], np.diff(knots) > 0.25])]
        knots[-1] = period
        values = rng.normal(size=(len(knots), arm.n))
        values[-1] = values[0]
        q = CubicSpline(knots, values, bc_type="periodic")(t)
    scale, low, high = within_limits(arm, t, q, rng.uniform(0.45, 0.85), rng.uniform(0.35, 0.65))
    return place(rng, arm, q, scale, low, high)[:-1]


def quintic(rng, n, t, closed):
    ends, pauses, at = [], [], 0.0
    while at < t[-1]:
        move, pause = rng.uniform(0.6, 1.4), rng.choice([0.0, rng.uniform(0.1, 0.5)])
        ends.append((at, at + move))
        pauses.append(pause)
        at += move + pause
    stretch = t[-1] / at
    points = rng.uniform(-1, 1, (len(ends) + 1, n))
    if closed:
        points[-1] = points[0]
    q = np.repeat(points[:1], len(t), axis=0)
    for k, (begin, end) in enumerate(ends):
        x = np.clip((t - begin * stretch) / ((end - begin) * stretch), 0, 1)
        q += (10 * x**3 - 15 * x**4 + 6 * x**5)[:, None] * (points[k + 1] - points[k])
    return q


def free(rng, arm, seconds, step, style):
    """A motion that does not repeat."""
    t = np.arange(int(round(seconds / step)) + 1) * step
    if style == "points":
        q = quintic(rng, arm.n, t, closed=False)
    elif style == "fourier":
        q = np.zeros((len(t), arm.n))
        for f in rng.uniform(0.03, 0.7, (7, arm.n)):
            q += rng.normal(size=arm.n) / (0.3 + f) * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6.28, arm.n))
    else:
        knots = np.concatenate([[0], np.cumsum(rng.uniform(0.4, 1.5, int(seconds / 0.4)))])
        knots = knots[: np.searchsorted(knots, seconds) + 1]
        q = CubicSpline(knots, rng.normal(size=(len(knots), arm.n)), bc_type="clamped")(t)
    scale, low, high = within_limits(arm, t, q, rng.uniform(0.5, 0.9), rng.uniform(0.35, 0.65))
    return place(rng, arm, q, scale, low, high)[:-1]


def start(rng, q, step, style):
    """How the arm leaves standstill: the motion is drawn in at once (a fifth of a second) or over some time."""
    ramp = rng.uniform(0.15, 0.3) if style == "at-once" else rng.uniform(0.5, 1.5)
    x = np.clip(np.arange(len(q)) * step / ramp, 0, 1)
    w = (10 * x**3 - 15 * x**4 + 6 * x**5)[:, None]
    return q[0] + w * (q - q[0])
