"""One fixed model for every node: the one with the smallest worst-case gain over the candidates.

    u_i = b x_i / (theta - 1),    theta = argmin over theta of max over a in the lists of the gain from w

Zhou, Doyle and Glover, Robust and Optimal Control, Prentice-Hall 1996, for the worst case over a set of plants. It
shows the price of not learning: it is right if nothing can be learned in time; otherwise, a learning law is better.
`theta` is a number of the whole network, so the operator computes it and gives it as a parameter. If a file leaves it
out, the operator computes it at the start of the run.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array, control
from hedgerow.topologies.graph import Gain


class Robust:
    """Equation (6) with one fixed number."""

    equation: ClassVar[str] = "ahat = theta, of the least worst gain over the lists"

    def __init__(self, b: Gain, candidates: Array, *, theta: float | None = None) -> None:
        if theta is None:
            raise ValueError("theta is not given, and the operator did not compute it")
        if not theta < 1:
            raise ValueError(f"theta {theta} is not below 1")
        self.b = b
        k = candidates.shape[1]
        self._report = np.stack([np.full(k, float(theta)), np.full(k, np.nan)])
        self.memory = np.empty((0, k))

    @classmethod
    def of_nodes(cls, b: Gain, thetas: Array) -> Robust:
        """Return the law of networks side by side, with the theta of each node's own network, (k,)."""
        law = cls(b, thetas[None], theta=float(thetas[0]))
        law._report[0] = thetas
        return law

    def act(self, x: Array) -> Array:
        """Return the inputs of equation (6)."""
        return control(self.b, x, self._report[0])

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        """Learn nothing."""

    def report(self) -> Array:
        """Return theta; it has no margin."""
        return self._report
