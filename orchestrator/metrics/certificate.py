"""The oracle's certificate: sum cost* <= sum w'Q^-1 w + V(x(0)) - V(x*(t+1)), docs/theory.md.

It is proved for one a and for edges that are all open, and claimed until the first step at which it is not so. Of large
networks w'Q^-1 w is known from below and from above (topologies.hinf.supply_rate), and a violation is one for both.
"""

from __future__ import annotations

import numpy as np

from hedgerow.orchestrator.metrics.checks import ROUNDING, TINY, Worst
from hedgerow.topologies.graph import Array, Gain, Graph, Index, Mask
from hedgerow.topologies.hinf import supply_rate


def running(before: Array | np.float64, increments: Array) -> Array:
    """Sums up to each row, added one after the other, so that they do not depend on how the rows were batched."""
    if len(increments) == 1:
        return np.asarray(before + increments)
    return np.asarray(np.cumsum(np.concatenate([np.asarray(before)[None], increments]), axis=0)[1:])


def storage(x: Array, a: Array) -> Array:
    """V(x) = sum x_i^2 / (1 - a_i) of B states, (B,): what the cost may owe to a state at most."""
    return np.asarray((x * x / (1 - a)).sum(axis=1))


class Certificate:
    """What is left of the inequality, step by step."""

    def __init__(self, a: Array, b: Gain, graph: Graph, x0: Array) -> None:
        self._a, self._rate = a, supply_rate(a, b, graph)
        self.v0 = float(storage(x0[None, :], a)[0])
        """V(x(0)) = sum x_i(0)^2 / (1 - a_i): what the cost owes to x(0) at most."""
        self._supply = self._more = np.float64(0)
        self._holds = True
        self.check = Worst()

    def take(self, t: Index, w: Array, x_next: Array, cost_sum: Array, changed: Mask) -> Array:
        """How far it is from being violated at B steps, at least, (B,); NaN from the first that is `changed`.

        w and x*(t + 1) are (B, n), the sum of cost* up to each step (B,).
        """
        rows = int(changed.argmax()) if changed.any() else len(t)
        rows *= self._holds
        self._holds = rows == len(t)
        slack = np.full(len(t), np.nan)
        if rows:
            # Row by row: the bits of a product with many columns depend on how many there are.
            rates = np.array([self._rate(w_t) for w_t in w[:rows]])
            supply, more = running(self._supply, rates[:, 0]), running(self._more, rates[:, 1])
            self._supply, self._more = supply[-1], more[-1]
            slack[:rows] = supply + self.v0 - storage(x_next[:rows], self._a) - cost_sum[:rows]
            self.check.see(-(slack[:rows] + more) / (supply + self.v0 + TINY) - ROUNDING, t[:rows])
        return slack
