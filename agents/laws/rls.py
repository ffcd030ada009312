"""Recursive least squares, clipped to the range of the candidates.

    R <- R + x^2,    a <- a + x (y - a x) / R,    ahat = clip(a, min A_i, max A_i),    R(0) = eps, a(0) = mid A_i

with y = x(t + 1) - b f(t). This is a = (Sxy + eps mid A_i) / (Sxx + eps), in a form with sums that do not cancel.
Goodwin and Sin, Adaptive Filtering, Prediction and Control, Prentice-Hall 1984, chapter 3. It is right if the truth may
lie between the candidates, and the disturbance is white. It fails as the paper's law does if the disturbance is
correlated with the state. Its estimate is a number, and no candidate of the list.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array, control
from hedgerow.topologies.graph import Gain


class RLS:
    """Certainty equivalence on a regularised least-squares estimate."""

    equation: ClassVar[str] = "ahat = clip((Sxy + eps mid A) / (Sxx + eps), min A, max A)"

    def __init__(self, b: Gain, candidates: Array, *, eps: float = 0.001) -> None:
        if not eps > 0:
            raise ValueError(f"eps {eps} is not above 0")
        self.b = b
        self.low, self.high = np.nanmin(candidates, axis=0), np.nanmax(candidates, axis=0)
        middle = 0.5 * (self.low + self.high)
        self._report = np.full((2, candidates.shape[1]), np.nan)
        self.memory = np.stack([np.full_like(middle, eps), middle])

    @property
    def memory(self) -> Array:
        """Return R = Sxx + eps and the estimate before it is clipped, (2, k)."""
        return self._memory

    @memory.setter
    def memory(self, memory: Array) -> None:
        self._memory = memory
        self._clip()

    def _clip(self) -> None:
        np.clip(self._memory[1], self.low, self.high, out=self._report[0])

    def act(self, x: Array) -> Array:
        """Return the inputs of equation (6)."""
        return control(self.b, x, self._report[0])

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        """Learn one sample; skip nodes with an unknown flow (NaN)."""
        R, a = self._memory
        known = np.isfinite(flow)
        if not known.any():
            return
        grown = R + x * x
        step = (x_next - self.b * flow - a * x) * x / grown
        np.copyto(R, grown, where=known)
        np.add(a, step, out=a, where=known)
        self._clip()

    def report(self) -> Array:
        """Return the clipped estimate; it has no margin."""
        return self._report
