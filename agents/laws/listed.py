"""The part that laws with scores share: they act by (6) on the first candidate of the least score."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array, control, two_smallest
from hedgerow.topologies.graph import Gain, all_finite


class Listed:
    """A law that keeps a score of every candidate, and acts on the first candidate of the least score.

    A subclass has `update`, which changes the rows of a memory by one sample, and `scores`, which reads them. The rows
    of a score begin at 0, and at infinity for the padding of shorter lists, so that padding is never chosen.
    """

    equation: ClassVar[str]
    """the equation in one line, for display"""

    def __init__(self, b: Gain, candidates: Array, more: int = 0) -> None:
        """Take `more` rows of memory beside the score of every candidate; they begin at 0."""
        self.b = b
        none, k = np.isnan(candidates), candidates.shape[1]
        self.candidates = np.where(none, 0.5, candidates)
        self.m = len(candidates)
        self._memory = np.vstack([np.where(none, np.inf, 0.0), np.zeros((more, k))])
        self._nodes = np.arange(k)
        self._report = np.full((2, k), np.inf)
        self.ahat, self.margin = self._report
        self._choose()

    @property
    def memory(self) -> Array:
        """Return all that was learned, (rows, k)."""
        return self._memory

    @memory.setter
    def memory(self, memory: Array) -> None:
        self._memory = memory
        self._choose()

    def update(self, memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:  # noqa: ARG002
        """Change `memory` (rows, k) in place by the sample of step t: x(t) and y = x(t + 1) - b f(t), both (k,).

        This adds the squared residuals to J, as (7) does, for a memory that is J alone; other laws override it.
        """
        residual = candidates * x
        residual -= y
        residual *= residual
        memory += residual

    def scores(self) -> Array:
        """Return the score of every candidate, (M, k)."""
        return self._memory[: self.m]

    def _choose(self) -> None:
        scores = self.scores()
        # argmin returns the first of equal values, so a tie goes to the candidate listed first.
        self.ahat[:] = self.candidates[scores.argmin(axis=0), self._nodes]
        if self.m > 1:
            least, second = two_smallest(scores)
            np.subtract(second, least, out=self.margin)

    def act(self, x: Array) -> Array:
        """Return the inputs of equation (6)."""
        return control(self.b, x, self.ahat)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        """Learn one sample; skip nodes with an unknown flow (NaN)."""
        self._learn(x, flow, x_next, 0)

    def _learn(self, x: Array, flow: Array, x_next: Array, t: int) -> None:
        if all_finite(flow):
            self.update(self._memory, self.candidates, x, x_next - self.b * flow, t)
        elif (known := np.isfinite(flow)).any():
            part = self._memory[:, known]
            y = x_next - self.b * flow
            self.update(part, self.candidates[:, known], x[known], y[known], t)
            self._memory[:, known] = part
        else:
            return
        self._choose()

    def report(self) -> Array:
        """Return the estimate and its margin over the second-best score, infinite if there is only one candidate."""
        return self._report
