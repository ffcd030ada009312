"""The arithmetic of a step as compiled loops over the nodes, for large networks; `hedgerow.topologies.fast` says when.

Each gives, bit for bit, what the numpy expression in its docstring gives: the same operations on the same numbers, in
the same order. What they save is passes over memory, each of which costs as much as the arithmetic of several.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64, njit, types, void

from hedgerow.topologies.graph import Array, Index

READ = types.Array(float64, 1, "C", readonly=True)
"""what arrives in a message may not be written to"""
READ_ROWS = types.Array(float64, 2, "C", readonly=True)
INDEX = types.Array(int64, 1, "C", readonly=True)
WRITE, WRITE_ROWS = float64[::1], float64[:, ::1]


@njit(WRITE(INDEX, INDEX, READ), cache=True)
def flow(first: Index, other: Index, u: Array) -> Array:
    """The flow: bincount(node, u[node] - u[other]), where the incidences of node i are first[i] .. first[i + 1] - 1."""
    flows = np.empty(len(first) - 1)
    for i in range(len(flows)):
        total = 0.0
        for c in range(first[i], first[i + 1]):
            total += u[i] - u[other[c]]
        flows[i] = total
    return flows


@njit(WRITE(INDEX, INDEX, READ, float64, READ, READ, READ), cache=True)
def dynamics(first: Index, other: Index, a: Array, b: float, x: Array, u: Array, w: Array) -> Array:
    """The state after x: a * x + b * flow(u) + w; equation (1)."""
    x_next = np.empty(len(x))
    for i in range(len(x)):
        total = 0.0
        for c in range(first[i], first[i + 1]):
            total += u[i] - u[other[c]]
        x_next[i] = a[i] * x[i] + b * total + w[i]
    return x_next


@njit(WRITE(float64, READ, READ), cache=True, error_model="numpy")
def control(b: float, x: Array, ahat: Array) -> Array:
    """The inputs b * x / (ahat - 1); equation (6)."""
    u = np.empty(len(x))
    for i in range(len(x)):
        u[i] = b * x[i] / (ahat[i] - 1.0)
    return u


@njit(void(WRITE_ROWS, READ_ROWS, float64, READ, READ, READ, WRITE, WRITE), cache=True)
def learn(
    J: Array, candidates: Array, b: float, x: Array, flow: Array, x_next: Array, ahat: Array, margin: Array
) -> None:
    """Add (candidates * x - (x_next - b * flow)) ** 2, of which nothing is NaN, to J, equation (7), and choose anew.

    Fills ahat, the first candidate that minimises J, and the margin J_(2) - J_(1).
    """
    M, k = J.shape
    for i in range(k):
        y = x_next[i] - b * flow[i]
        least = second = np.inf
        estimate = candidates[0, i]
        for m in range(M):
            candidate = candidates[m, i]
            residual = candidate * x[i] - y
            total = J[m, i] + residual * residual
            J[m, i] = total
            # Without a branch: it goes either way, and would be guessed wrong.
            estimate = candidate if total < least else estimate
            second = min(second, max(total, least))
            least = min(least, total)
        ahat[i] = estimate
        margin[i] = second - least if M > 1 else np.inf
