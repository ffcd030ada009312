"""The one fixed model with the smallest worst-case gain, for the law `robust`: one number for the whole network.

Let u = theta_b x, theta_b = b / (theta - 1) at every node. The loop is then x+ = M x + w with the cost x' W x. Here M =
A - B B' / (1 - theta), W = I + B B' / (1 - theta)^2 and B B' = diag(b) L diag(b). Its gain at z is the largest singular
value of W^(1/2) (z I - M)^-1. The search for the worst truth uses the smallest and the largest candidate of every node,
one node at a time, from the largest of all. It is a lower bound on the worst case, found by search and not proved.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import cholesky
from scipy.optimize import minimize_scalar

from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Array
from hedgerow.topologies.network import Network

MOST = 200
"""the maximum number of nodes; the search makes a dense matrix of each truth"""
GRID = 25
"""the number of initial values"""
DIGITS = 4
"""digits of theta: fewer than the difference between two machines"""


def theta_of(network: Network) -> float:
    """Return theta; raise UserError if the network is too large to compute it."""
    if (n := len(network.ids)) > MOST:
        what = f"law robust: theta is computed for up to {MOST} nodes, and there are {n}"
        raise UserError(f"{what}. Give it: robust(theta=0.5).", code=Code.LAW)
    low, high = np.nanmin(network.candidates, axis=0), np.nanmax(network.candidates, axis=0)
    coupling = _coupling(network)

    def worst(theta: float) -> float:
        return worst_gain(float(theta), low, high, coupling)

    # The worst gain has several local minima: start with a grid.
    grid = np.linspace(low.min(), high.max(), GRID)
    best = int(np.argmin([worst(theta) for theta in grid]))
    around = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, GRID - 1)])
    if around[0] == around[1]:
        return round(around[0], DIGITS)
    found = minimize_scalar(worst, bounds=around, method="bounded", options={"xatol": 1e-4})
    return round(float(min(found.x, grid[best], key=worst)), DIGITS)


def _coupling(network: Network) -> Array:
    """Return B B' = diag(b) L diag(b), (n, n)."""
    graph, n = network.graph, len(network.ids)
    laplacian = np.zeros((n, n))
    weights = np.ones(len(graph.edges)) if graph.weights is None else graph.weights
    for (i, j), weight in zip(graph.edges.tolist(), weights.tolist(), strict=True):
        laplacian[[i, j], [i, j]] += weight
        laplacian[[i, j], [j, i]] -= weight
    b = np.broadcast_to(network.b, n)
    return np.asarray(b[:, None] * laplacian * b)


def worst_gain(theta: float, low: Array, high: Array, coupling: Array) -> float:
    """Return the largest gain found over truths between `low` and `high`, (n,), for one theta."""
    a, best = high.copy(), gain(theta, high, coupling)
    improved = True
    while improved and math.isfinite(best):
        improved = False
        for i in range(len(a)):
            other = a.copy()
            other[i] = low[i] if a[i] == high[i] else high[i]
            if (found := gain(theta, other, coupling)) > best * (1 + 1e-12):
                a, best, improved = other, found, True
    return best


def gain(theta: float, a: Array, coupling: Array) -> float:
    """Return the gain at z = 1 or z = -1, the larger one; infinite if the loop is not stable."""
    eye = np.eye(len(a))
    M = np.diag(a) - coupling / (1.0 - theta)
    if np.abs(np.linalg.eigvalsh(M)).max() >= 1:
        return math.inf
    root = cholesky(eye + coupling / (1.0 - theta) ** 2)
    return max(float(np.linalg.norm(root @ np.linalg.inv(z * eye - M), 2)) for z in (1.0, -1.0))
