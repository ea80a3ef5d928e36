"""The nearest consistent parameters by Clarabel's semidefinite programming: reads one JSON object, writes one.

    {"problems": [{"k": rows x 10 n, "beta", "covariance", "prior": n x 10}], "floor", "repeats"}
    ->  [{"distance", "seconds", "total", "iterations"}]   seconds: least time of the solver itself, total: with its set-up

min 1/2 (beta - K delta)' C^-1 (beta - K delta) with J_i(delta_i) - floor J0_i positive semi-definite, delta per link
[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m] about the link frame's origin.
"""

import json
import sys
import time

import clarabel
import numpy as np
from scipy import sparse


def pseudo_inertia(p):
    xx, xy, xz, yy, yz, zz, lx, ly, lz, m = p
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    first = np.array([[lx], [ly], [lz]])
    return np.block([[0.5 * np.trace(inertia) * np.eye(3) - inertia, first], [first.T, np.array([[m]])]])


def triangle(x):
    """Upper triangle column by column, off-diagonals times root 2, as the solver has it."""
    return np.array([x[r, c] * (1.0 if r == c else np.sqrt(2.0)) for c in range(4) for r in range(c + 1)])


def solve(problem, floor, repeats):
    k, beta, prior = (np.array(problem[key]) for key in ("k", "beta", "prior"))
    deviation = np.sqrt(np.diag(problem["covariance"]))
    correlation = np.array(problem["covariance"]) / np.outer(deviation, deviation)
    root = np.linalg.cholesky(np.linalg.inv(correlation)).T
    k, beta = root @ (k / deviation[:, None]), root @ (beta / deviation)
    links = len(prior)
    # The residual r = beta - K delta is a variable of its own: with P = K'K the distance would drown in the size of the objective.
    rows, columns = k.shape
    cone = sparse.block_diag([np.array([triangle(pseudo_inertia(unit)) for unit in np.eye(10)]).T for _ in range(links)])
    a = sparse.bmat([[sparse.csc_matrix(k), sparse.eye(rows)], [-cone, None]], format="csc")
    b = np.concatenate([beta] + [-floor * triangle(pseudo_inertia(p)) for p in prior])
    p = sparse.block_diag([sparse.csc_matrix((columns, columns)), sparse.eye(rows)], format="csc")
    cones = [clarabel.ZeroConeT(rows)] + [clarabel.PSDTriangleConeT(4)] * links
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    best = total = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        solution = clarabel.DefaultSolver(p, np.zeros(columns + rows), a, b, cones, settings).solve()
        total = min(total, time.perf_counter() - start)
        best = min(best, solution.solve_time)
    x = np.array(solution.x)[:columns]
    residual = beta - k @ x
    return {
        "distance": float(np.sqrt(residual @ residual)),
        "seconds": best,
        "total": total,
        "iterations": solution.iterations,
        "status": str(solution.status),
    }


request = json.load(sys.stdin)
json.dump([solve(p, request["floor"], request["repeats"]) for p in request["problems"]], sys.stdout)
