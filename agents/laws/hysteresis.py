"""The paper's law with scale-independent hysteresis.

    keep m unless (1 + h) min_n J_i,n <= J_i,m;  then m is the first minimiser

Source: Morse, Mayne and Goodwin, "Applications of Hysteresis Switching in Parameter Adaptive Control", IEEE TAC 37(9),
1992. See also: Hespanha, Liberzon and Morse, "Hysteresis-based switching algorithms for supervisory control of
uncertain systems", Automatica 39(2), 2003. It is right if switching itself is harmful: it switches less often than the
paper's law. It fails if speed matters: a better model must first win by the factor 1 + h. A tie of all costs at 0
switches to the first candidate. With h = 0 it is the paper's law.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array
from hedgerow.agents.laws.listed import Listed
from hedgerow.topologies.graph import Gain


class Hysteresis(Listed):
    """The paper's law, which keeps its model until another one is better by a factor."""

    equation: ClassVar[str] = "keep m unless (1 + h) min J <= J_m"

    def __init__(self, b: Gain, candidates: Array, *, h: float = 0.5) -> None:
        if not h >= 0:
            raise ValueError(f"h {h} is below 0")
        self.h = h
        super().__init__(b, candidates, more=1)  # the index of the model that is kept

    def update(self, memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:
        """Add the squared residuals, and switch if another model is better by the factor."""
        J, kept = memory[:-1], memory[-1]
        super().update(J, candidates, x, y, t)
        best, nodes = J.argmin(axis=0), np.arange(len(kept))
        switch = (1.0 + self.h) * J[best, nodes] <= J[kept.astype(np.int64), nodes]
        kept[switch] = best[switch]

    def _choose(self) -> None:
        J, kept = self.scores(), self._memory[-1].astype(np.int64)
        self.ahat[:] = self.candidates[kept, self._nodes]
        if self.m > 1:
            own = J[kept, self._nodes]
            others = J.copy()
            others[kept, self._nodes] = np.inf
            np.subtract(others.min(axis=0), own, out=self.margin)
