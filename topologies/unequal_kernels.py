"""The compiled loops of `hedgerow.topologies.kernels` for gains and edge weights that differ.

They are separate modules. So a network with equal gains and weights neither compiles nor loads these loops. Each
returns, bit for bit, the value of the numpy expression in its docstring. `b` is (k,) and `weight` has one number per
incidence.
"""

from __future__ import annotations

import numpy as np
from numba import njit, void

from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.kernels import INDEX, READ, READ_ROWS, WRITE, WRITE_ROWS


@njit(WRITE(INDEX, INDEX, READ, READ), cache=True)
def flow(first: Index, other: Index, weight: Array, u: Array) -> Array:
    """Return the flow: bincount(node, weight * (u[node] - u[other])); node i has the incidences from first[i] on."""
    flows = np.empty(len(first) - 1)
    for i in range(len(flows)):
        total = 0.0
        for c in range(first[i], first[i + 1]):
            total += weight[c] * (u[i] - u[other[c]])
        flows[i] = total
    return flows


@njit(WRITE(INDEX, INDEX, READ, READ, READ, READ, READ, READ), cache=True)
def dynamics(first: Index, other: Index, weight: Array, a: Array, b: Array, x: Array, u: Array, w: Array) -> Array:
    """Return the state after x: a * x + b * flow(u) + w; equation (1)."""
    x_next = np.empty(len(x))
    for i in range(len(x)):
        total = 0.0
        for c in range(first[i], first[i + 1]):
            total += weight[c] * (u[i] - u[other[c]])
        x_next[i] = a[i] * x[i] + b[i] * total + w[i]
    return x_next


@njit(WRITE(READ, READ, READ), cache=True, error_model="numpy")
def control(b: Array, x: Array, ahat: Array) -> Array:
    """Return the inputs b * x / (ahat - 1); equation (6)."""
    u = np.empty(len(x))
    for i in range(len(x)):
        u[i] = b[i] * x[i] / (ahat[i] - 1.0)
    return u


@njit(void(WRITE_ROWS, READ_ROWS, READ, READ, READ, READ, WRITE, WRITE), cache=True)
def learn(
    J: Array, candidates: Array, b: Array, x: Array, flow: Array, x_next: Array, ahat: Array, margin: Array
) -> None:
    """Update J and choose the estimate again, as `kernels.learn` does."""
    M, k = J.shape
    for i in range(k):
        y = x_next[i] - b[i] * flow[i]
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
