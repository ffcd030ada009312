"""Bayesian blending of the candidates' inputs.

    u_i = sum_m pi_m b x_i / (a_m - 1),    pi_m ~ exp(-J_i,m / (2 sigma^2))

Source: Athans et al., "The Stochastic Control of the F-8C Aircraft Using a Multiple Model Adaptive Control (MMAC)
Method", IEEE TAC 22(5), 1977. See also: Lainiotis, "Partitioning: A Unifying Framework for Adaptive Systems",
Proceedings of the IEEE 64(8), 1976. It is right if w is white with the standard deviation sigma: pi is then the
posterior of a uniform prior. It fails if sigma is wrong (too small: it is the paper's law; too large: it never decides)
or w is not white. The reported estimate is the posterior mean, which is not a candidate while two candidates have
weight. The input is not (6) of that estimate.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array
from hedgerow.agents.laws.listed import Listed
from hedgerow.agents.laws.posterior import checked, total, weights
from hedgerow.topologies.graph import Gain


class Bayes(Listed):
    """The mean of the candidates' inputs under the posterior."""

    equation: ClassVar[str] = "u = sum pi_m u_m, pi ~ exp(-J / (2 sigma^2))"

    def __init__(self, b: Gain, candidates: Array, *, sigma: float = 0.5) -> None:
        self.sigma = checked(sigma)
        super().__init__(b, candidates)
        self.margin[:] = np.nan

    def _choose(self) -> None:
        pi = weights(self._memory, self.sigma)
        whole = total(pi)
        self._gain = total(pi / (self.candidates - 1.0)) / whole
        self.ahat[:] = total(pi * self.candidates) / whole

    def act(self, x: Array) -> Array:
        """Return the blended inputs."""
        return self.b * x * self._gain
