"""The compiled loops of `hedgerow.topologies.kernels` for gains and edge weights that differ.

They are separate modules. So a network with equal gains and weights neither compiles nor loads these loops. Each
returns, bit for bit, the value of the numpy expression in its docstring. `b` is (k,) and `weight` has one number per
incidence.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64, njit, uint64, void

from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.kernels import BLOCK, INDEX, READ, READ_ROWS, WRITE, WRITE_ROWS


@njit(float64(INDEX, INDEX, READ, READ, int64), cache=True)
def _flow_of(first: Index, other: Index, weight: Array, u: Array, i: int) -> float:
    """Return the flow of node i."""
    total, own = 0.0, u[i]
    for c in range(uint64(first[i]), uint64(first[i + 1])):
        total += weight[c] * (own - u[uint64(other[c])])
    return total


@njit(WRITE(INDEX, INDEX, READ, READ), cache=True)
def flow(first: Index, other: Index, weight: Array, u: Array) -> Array:
    """Return the flow: bincount(node, weight * (u[node] - u[other])); node i has the incidences from first[i] on."""
    flows = np.empty(len(first) - 1)
    for i in range(len(flows)):
        flows[i] = _flow_of(first, other, weight, u, i)
    return flows


@njit(WRITE(INDEX, INDEX, READ, READ, READ, READ, READ, READ), cache=True)
def dynamics(first: Index, other: Index, weight: Array, a: Array, b: Array, x: Array, u: Array, w: Array) -> Array:
    """Return the state after x: a * x + b * flow(u) + w; equation (1)."""
    x_next = np.empty(len(x))
    for i in range(len(x)):
        x_next[i] = a[i] * x[i] + b[i] * _flow_of(first, other, weight, u, i) + w[i]
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
    """Update J and choose the estimate again, as `kernels.learn` does.

    The loops are those of `kernels.learn` once more: as one function for both, they took up to 1.5 times as long.
    """
    M, k = J.shape
    y, least = np.empty(BLOCK), np.empty(BLOCK)
    # The innermost loop runs over nodes that are side by side, so that one instruction handles several of them. Slices
    # have indices from 0 on, which need no check for negative ones.
    for start in range(0, k, BLOCK):
        stop = min(start + BLOCK, k)
        state, estimate, second = x[start:stop], ahat[start:stop], margin[start:stop]
        first, gain, flows, after = candidates[0, start:stop], b[start:stop], flow[start:stop], x_next[start:stop]
        for i in range(stop - start):
            y[i] = after[i] - gain[i] * flows[i]
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
