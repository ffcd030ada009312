"""The arithmetic of a step as compiled loops over the nodes; `hedgerow.topologies.fast` chooses when to use them.

Each returns, bit for bit, the value of the numpy expression in its docstring: the same operations on the same numbers,
in the same order. They need fewer passes over memory. Each pass costs as much as several operations.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64, njit, types, void

from hedgerow.topologies.graph import Array, Index

READ = types.Array(float64, 1, "C", readonly=True)
"""arrays from a message are read-only"""
READ_ROWS = types.Array(float64, 2, "C", readonly=True)
INDEX = types.Array(int64, 1, "C", readonly=True)
WRITE, WRITE_ROWS = float64[::1], float64[:, ::1]


@njit(WRITE(INDEX, INDEX, READ), cache=True)
def flow(first: Index, other: Index, u: Array) -> Array:
    """Return the flow: bincount(node, u[node] - u[other]); node i has the incidences first[i] to first[i + 1] - 1."""
    flows = np.empty(len(first) - 1)
    for i in range(len(flows)):
        total = 0.0
        for c in range(first[i], first[i + 1]):
            total += u[i] - u[other[c]]
        flows[i] = total
    return flows


@njit(WRITE(INDEX, INDEX, READ, float64, READ, READ, READ), cache=True)
def dynamics(first: Index, other: Index, a: Array, b: float, x: Array, u: Array, w: Array) -> Array:
    """Return the state after x: a * x + b * flow(u) + w; equation (1)."""
    x_next = np.empty(len(x))
    for i in range(len(x)):
        total = 0.0
        for c in range(first[i], first[i + 1]):
            total += u[i] - u[other[c]]
        x_next[i] = a[i] * x[i] + b * total + w[i]
    return x_next


@njit(WRITE(float64, READ, READ), cache=True, error_model="numpy")
def control(b: float, x: Array, ahat: Array) -> Array:
    """Return the inputs b * x / (ahat - 1); equation (6)."""
    u = np.empty(len(x))
    for i in range(len(x)):
        u[i] = b * x[i] / (ahat[i] - 1.0)
    return u


@njit(void(WRITE_ROWS, READ_ROWS, float64, READ, READ, READ, WRITE, WRITE), cache=True)
def learn(
    J: Array, candidates: Array, b: float, x: Array, flow: Array, x_next: Array, ahat: Array, margin: Array
) -> None:
    """Add (candidates * x - (x_next - b * flow)) ** 2, which has no NaN, to J, equation (7), and choose the estimate
    again.

    Fill ahat, the first candidate that minimises J, and the margin J_(2) - J_(1).
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
            # Avoid a branch: the processor would often predict it wrong.
            estimate = candidate if total < least else estimate
            second = min(second, max(total, least))
            least = min(least, total)
        ahat[i] = estimate
        margin[i] = second - least if M > 1 else np.inf
