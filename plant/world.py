"""The dynamics (1): x_i(t+1) = a_i x_i(t) + b sum_j (u_i(t) - u_j(t)) + w_i(t), over the edges that are open."""

from __future__ import annotations

import numpy as np

from plant.disturbance import Disturbance
from plant.truth import Truth
from topologies.graph import Array, Graph, Mask


def dynamics(a: Array, b: float, graph: Graph, x: Array, u: Array, w: Array, edge_open: Mask | None = None) -> Array:
    """x(t+1) from x(t), u(t), w(t) and the edges open at t (None: all); equation (1).

    Shapes: (n,) and (E,); or (B, n) and (B, E) for B networks at once.
    """
    return a * x + b * graph.flow(u, edge_open) + w


class World:
    """The true network in motion: its state x(t), and the step to the next."""

    def __init__(self, truth: Truth) -> None:
        self.graph = Graph(len(truth.ids), np.array(truth.edges, dtype=np.int64).reshape(-1, 2))
        self.a = np.array(truth.a)
        self.b = truth.b
        self.t = 0
        self.x = np.array(truth.x0, dtype=float)
        self._disturbance = Disturbance(truth.disturbance, truth.seed)

    def step(self, u: Array, edge_open: Mask | None = None) -> Array:
        """Advance from t to t + 1 under the inputs u(t), (n,); return w(t), (n,)."""
        w = self._disturbance.at(self.t)
        self.x = dynamics(self.a, self.b, self.graph, self.x, u, w, edge_open)
        self.t += 1
        return w
