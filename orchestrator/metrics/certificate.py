"""The oracle's certificate: sum cost* <= sum w'Q^-1 w + V(x(0)) - V(x*(t+1)), docs/theory.md.

It is proved for one a and for open edges, and claimed until the first step at which this does not hold. In a large
network, w'Q^-1 w is known by a lower and an upper bound (topologies.hinf.supply_rate), and a violation must hold for
both.
"""

from __future__ import annotations

import numpy as np

from hedgerow.orchestrator.metrics.checks import ROUNDING, TINY, Worst
from hedgerow.topologies.graph import Array, Gain, Graph, Index, Mask
from hedgerow.topologies.hinf import supply_rate


def running(before: Array | np.float64, increments: Array) -> Array:
    """Return the sums up to each row, added in order, so that they do not depend on the batches."""
    if len(increments) == 1:
        return np.asarray(before + increments)
    return np.asarray(np.cumsum(np.concatenate([np.asarray(before)[None], increments]), axis=0)[1:])


def storage(x: Array, a: Array) -> Array:
    """Return V(x) = sum x_i^2 / (1 - a_i) of B states, (B,): the maximum contribution of a state to the cost."""
    return np.asarray((x * x / (1 - a)).sum(axis=1))


class Certificate:
    """The slack of the inequality, step by step."""

    def __init__(self, a: Array, b: Gain, graph: Graph, x0: Array) -> None:
        self._a, self._rate = a, supply_rate(a, b, graph)
        self.v0 = float(storage(x0[None, :], a)[0])
        """V(x(0)) = sum x_i(0)^2 / (1 - a_i): the maximum contribution of x(0) to the cost."""
        self._supply = self._more = np.float64(0)
        self._holds = True
        self.check = Worst()

    def take(self, t: Index, w: Array, x_next: Array, cost_sum: Array, changed: Mask) -> Array:
        """Return a lower bound of the slack at B steps, (B,); NaN from the first step on that is `changed`.

        w and x*(t + 1) are (B, n), the sum of cost* up to each step (B,).
        """
        rows = int(changed.argmax()) if changed.any() else len(t)
        rows *= self._holds
        self._holds = rows == len(t)
        slack = np.full(len(t), np.nan)
        if rows:
            # Compute row by row: the bits of a product with many columns depend on their number.
            rates = np.array([self._rate(w_t) for w_t in w[:rows]])
            supply, more = running(self._supply, rates[:, 0]), running(self._more, rates[:, 1])
            self._supply, self._more = supply[-1], more[-1]
            slack[:rows] = supply + self.v0 - storage(x_next[:rows], self._a) - cost_sum[:rows]
            self.check.see(-(slack[:rows] + more) / (supply + self.v0 + TINY) - ROUNDING, t[:rows])
        return slack
