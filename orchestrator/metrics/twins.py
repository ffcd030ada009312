"""The twins of a run: the same network with the same w, x(0) and open edges, under other laws.

The oracle acts on the true a (8), the nominal controller on the nominal value. Neither needs an estimator.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hedgerow.agents.law import control
from hedgerow.plant.world import dynamics
from hedgerow.topologies.graph import Array, Gain, Graph, Mask


class Twins:
    """Both twins: first the oracle, then the nominal controller."""

    def __init__(self, b: Gain, graph: Graph, x0: Array, a: Array, nominal: Array) -> None:
        self._b, self._graph, self._nominal = b, graph, nominal
        self.x: Array = np.stack([x0, x0])
        """x(t) of both, (2, n)"""
        self._turn(a)

    def _turn(self, a: Array) -> None:
        """Change the true a of both twins; the oracle knows it."""
        self._a, self._models = a, np.stack([a, self._nominal])

    def run(self, w: Array, edge_open: Mask | None, turns: Mapping[int, Array]) -> tuple[Array, Array]:
        """Run both twins over B steps; return x and u, (2, B, n), from w (B, n), edges (B, E) and, by row, a new a."""
        x, u = np.empty((2, *w.shape)), np.empty((2, *w.shape))
        for k, w_t in enumerate(w):
            if k in turns:
                self._turn(turns[k])
            x[:, k] = self.x
            u[:, k] = now = control(self._b, self.x, self._models)
            on = None if edge_open is None else edge_open[k]
            self.x = dynamics(self._a, self._b, self._graph, self.x, now, w_t, on)
        return x, u
