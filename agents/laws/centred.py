"""The paper's law for a disturbance of unknown mean.

    J_i,m = sum r^2 - (sum r)^2 / n,    r = a_m x_i + b f_i - x_i(t + 1),    n samples

This is least squares with an intercept. The sums are updated as Welford does, because the two terms cancel: Welford,
"Note on a Method for Calculating Corrected Sums of Squares and Products", Technometrics 4(3), 1962. It is right if w is
a constant plus white noise. It fails if x is as constant as w: then all candidates explain the samples, and J does not
separate them. With n = 0 or 1 sample all J are 0, and the first candidate wins.
"""

from __future__ import annotations

from typing import ClassVar

from hedgerow.agents.law import Array
from hedgerow.agents.laws.listed import Listed
from hedgerow.topologies.graph import Gain


class Centred(Listed):
    """The least sum of squares about the mean of the residuals."""

    equation: ClassVar[str] = "J = sum r^2 - (sum r)^2 / n"

    def __init__(self, b: Gain, candidates: Array) -> None:
        super().__init__(b, candidates, more=len(candidates) + 1)  # the mean of each residual, and n

    def update(self, memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:  # noqa: ARG002
        """Add one sample to J, to the means and to n."""
        m = len(candidates)
        J, mean, n = memory[:m], memory[m:-1], memory[-1]
        n += 1.0
        apart = candidates * x
        apart -= y
        apart -= mean
        mean += apart / n
        apart *= apart
        apart *= (n - 1.0) / n
        J += apart
