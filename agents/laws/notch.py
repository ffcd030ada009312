"""The candidate with residuals nearest to a sinusoid of any frequency.

    J_i,m = min over c of sum (r_t - c r_{t-1} + r_{t-2})^2 = S2 - S1^2 / S0,    c = 2 cos omega
    S0 = sum r_{t-1}^2,    S1 = sum (r_t + r_{t-2}) r_{t-1},    S2 = sum (r_t + r_{t-2})^2

over triples of consecutive complete samples, r = a_m x_i + b f_i - x_i(t + 1).
Francis and Wonham, "The internal model principle of control theory", Automatica 12(5), 1976: the filter 1 - c q^-1 +
q^-2 is zero on every sinusoid of one frequency.
It is right if w is one sinusoid: the true model then has J = 0. It fails if white noise is added, because the filter
amplifies noise by up to 6. J is the recursive residual sum of squares of the regression of r_t + r_{t-2} on r_{t-1}:
S2 - S1^2 / S0 would cancel. With S0 = 0 the sample adds (r_t + r_{t-2})^2. Without a triple, all J are 0.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array
from hedgerow.agents.laws.listed import Listed
from hedgerow.agents.local import Received
from hedgerow.topologies.graph import Gain, Mask

TINY = 1e-290
"""a smaller square counts as 0, so that no quotient overflows"""
LAGS = 6
"""rows for x and y of the last two samples, the step of the last one, and how many of them are consecutive"""


def notched(memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:
    """Add the sample of step t to a memory (3 M + 6, k): J, c and S0 by candidate, and the lags."""
    m = len(candidates)
    J, c, S0 = memory[:m], memory[m : 2 * m], memory[2 * m : 3 * m]
    x_1, y_1, x_2, y_2, step, run = memory[3 * m :]
    run *= step == t - 1
    whole = run >= 2
    if whole.any():
        _regress(J, c, S0, candidates * x - y + (candidates * x_2 - y_2), candidates * x_1 - y_1, whole)
    x_2[:], y_2[:] = x_1, y_1
    x_1[:], y_1[:], step[:] = x, y, t
    run += 1.0


def _regress(J: Array, c: Array, S0: Array, v: Array, z: Array, whole: Mask) -> None:
    """Add v and z to the regression v = c z, in the columns that are `whole`; all arrays are (M, k)."""
    squared = z * z
    none = squared < TINY
    if none.any():
        z, squared = np.where(none, 0.0, z), np.where(none, 0.0, squared)
    sums = S0 + squared
    some = sums > 0
    by = np.where(some, sums, 1.0)
    v -= c * z
    # A sample of a regression without data yet has no residual; one without z has all of v.
    added = v * v * np.where(some, S0 / by, 1.0)
    v *= z / by
    if whole.all():
        J += added
        c += v
        S0[:] = sums
    else:
        np.add(J, added, out=J, where=whole)
        np.add(c, v, out=c, where=whole)
        np.copyto(S0, sums, where=whole)


class Notch(Listed):
    """The candidate with the smallest residual after a notch filter of the best frequency."""

    equation: ClassVar[str] = "J = min_c sum (r_t - c r_{t-1} + r_{t-2})^2"

    def __init__(self, b: Gain, candidates: Array) -> None:
        super().__init__(b, candidates, more=2 * len(candidates) + LAGS)

    def update(self, memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:
        """Add one sample; it counts if the two steps before it have complete samples too."""
        notched(memory, candidates, x, y, t)

    def learn(self, x: Array, flow: Array, x_next: Array, sample: Received) -> None:  # type: ignore[override]  # it asks
        """Learn the sample of step `sample.t`; skip nodes with an unknown flow (NaN)."""
        self._learn(x, flow, x_next, sample.t)
