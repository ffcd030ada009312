"""The notch if it explains the samples far better, otherwise the paper's law.

    ahat_i is notch's if min_m J_notch,m < ratio min_m J_m, else that of (7)

Narendra and Balakrishnan, "Adaptive Control Using Multiple Models", IEEE TAC 42(2), 1997, for the choice between
estimators by their residuals.
It is right if w is a sinusoid or white noise. It fails if w is the sum of both: the notch does not explain the noise,
and (7) is biased by the sinusoid. Both scores are at their smallest over the candidates. Until there is a triple of
samples both are 0, and (7) decides.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array
from hedgerow.agents.laws.listed import Listed
from hedgerow.agents.laws.notch import LAGS, notched
from hedgerow.agents.local import Received
from hedgerow.topologies.graph import Gain


class Either(Listed):
    """Two estimators; the one that explains the samples decides."""

    equation: ClassVar[str] = "notch if min J_notch < ratio min J, else (7)"

    def __init__(self, b: Gain, candidates: Array, *, ratio: float = 0.1) -> None:
        if not ratio >= 0:
            raise ValueError(f"ratio {ratio} is below 0")
        self.ratio = ratio
        m = len(candidates)
        # J of (7), then the memory of the notch.
        super().__init__(b, candidates, more=3 * m + LAGS)
        self._memory[m : 2 * m] = self._memory[:m]
        self._choose()

    def update(self, memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:
        """Add one sample to both."""
        m = len(candidates)
        super().update(memory[:m], candidates, x, y, t)
        notched(memory[m:], candidates, x, y, t)

    def scores(self) -> Array:
        """Return the scores of the estimator that decides, (M, k)."""
        J, notch = self._memory[: self.m], self._memory[self.m : 2 * self.m]
        trust = notch.min(axis=0) < self.ratio * J.min(axis=0)
        return np.where(trust, notch, J)

    def learn(self, x: Array, flow: Array, x_next: Array, sample: Received) -> None:  # type: ignore[override]  # it asks
        """Learn the sample of step `sample.t`; skip nodes with an unknown flow (NaN)."""
        self._learn(x, flow, x_next, sample.t)
