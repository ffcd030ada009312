"""The candidate that needs the smallest bound on the disturbance.

    ahat_i = first candidate that minimises J_i,m = max over samples of |a_m x_i + b f_i - x_i(t + 1)|

Source: Fogel and Huang, "On the value of information in system identification: bounded noise case", Automatica 18(2),
1982. See also: Milanese and Vicino, "Optimal estimation theory for dynamic systems with set membership uncertainty: an
overview", Automatica 27(6), 1991. It is right if w is bounded and its bound is often reached. It fails if w has
outliers: one large residual of the true model counts forever. If w reaches its bound again and again, as a constant w
does, the scores of several candidates differ by rounding only. So scores within a share of 1e-9 of the least one tie,
and the first candidate wins.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array, two_smallest
from hedgerow.agents.laws.listed import Listed

TIE = 1.0 + 1e-9
"""scores up to this multiple of the least one tie with it"""


class SetMembership(Listed):
    """The candidate with the smallest maximum residual."""

    equation: ClassVar[str] = "J = max |r|"

    def update(self, memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:  # noqa: ARG002
        """Keep the larger residual."""
        residual = candidates * x
        residual -= y
        np.maximum(memory, np.abs(residual), out=memory)

    def _choose(self) -> None:
        scores = self._memory
        place = (scores <= TIE * scores.min(axis=0)).argmax(axis=0)
        self.ahat[:] = self.candidates[place, self._nodes]
        if self.m > 1:
            least, second = two_smallest(scores)
            np.subtract(second, least, out=self.margin)
