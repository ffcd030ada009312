"""The arithmetic of a step as compiled loops over the nodes; `hedgerow.topologies.fast` chooses when to use them.

Each returns, bit for bit, the value of the numpy expression in its docstring: the same operations on the same numbers,
in the same order. They need fewer passes over memory. Each pass costs as much as several operations.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64, njit, types, uint64, void

from hedgerow.topologies.graph import Array, Index

READ = types.Array(float64, 1, "C", readonly=True)
"""arrays from a message are read-only"""
READ_ROWS = types.Array(float64, 2, "C", readonly=True)
INDEX = types.Array(int64, 1, "C", readonly=True)
WRITE, WRITE_ROWS = float64[::1], float64[:, ::1]
BLOCK = 256
"""the number of nodes that `learn` handles together"""


@njit(float64(INDEX, INDEX, READ, int64), cache=True)
def _flow_of(first: Index, other: Index, u: Array, i: int) -> float:
    """Return the flow of node i."""
    # numba checks a signed index for a negative value at every access, and an unsigned one for nothing.
    total, own = 0.0, u[i]
    for c in range(uint64(first[i]), uint64(first[i + 1])):
        total += own - u[uint64(other[c])]
    return total


@njit(WRITE(INDEX, INDEX, READ), cache=True)
def flow(first: Index, other: Index, u: Array) -> Array:
    """Return the flow: bincount(node, u[node] - u[other]); node i has the incidences first[i] to first[i + 1] - 1."""
    flows = np.empty(len(first) - 1)
    for i in range(len(flows)):
        flows[i] = _flow_of(first, other, u, i)
    return flows


@njit(WRITE(INDEX, INDEX, READ, float64, READ, READ, READ), cache=True)
def dynamics(first: Index, other: Index, a: Array, b: float, x: Array, u: Array, w: Array) -> Array:
    """Return the state after x: a * x + b * flow(u) + w; equation (1)."""
    x_next = np.empty(len(x))
    for i in range(len(x)):
        x_next[i] = a[i] * x[i] + b * _flow_of(first, other, u, i) + w[i]
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
    y, least = np.empty(BLOCK), np.empty(BLOCK)
    # The innermost loop runs over nodes that are side by side, so that one instruction handles several of them. Slices
    # have indices from 0 on, which need no check for negative ones.
    for start in range(0, k, BLOCK):
        stop = min(start + BLOCK, k)
        state, estimate, second = x[start:stop], ahat[start:stop], margin[start:stop]
        first, flows, after = candidates[0, start:stop], flow[start:stop], x_next[start:stop]
        for i in range(stop - start):
            y[i] = after[i] - b * flows[i]
            estimate[i] = first[i]
            least[i] = second[i] = np.inf
        for m in range(M):
            cost, candidate = J[m, start:stop], candidates[m, start:stop]
            for i in range(stop - start):
                before, model = least[i], candidate[i]
                residual = model * state[i] - y[i]
                total = cost[i] + residual * residual
                cost[i] = total
                estimate[i] = model if total < before else estimate[i]
                larger = total if total > before else before
                second[i] = larger if larger < second[i] else second[i]
                least[i] = total if total < before else before
        for i in range(stop - start):
            second[i] = second[i] - least[i] if M > 1 else np.inf
