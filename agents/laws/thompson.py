"""Thompson sampling: every step acts on a candidate drawn from the posterior.

    ahat_i(t) = a_m with probability pi_m,    pi_m ~ exp(-J_i,m / (2 sigma^2))

Source: Thompson, "On the likelihood that one unknown probability exceeds another in view of the evidence of two
samples", Biometrika 25, 1933. See also: Abeille and Lazaric, "Improved Regret Bounds for Thompson Sampling in Linear
Quadratic Control Problems", ICML 2018. It is right if acting on an uncertain model teaches something. Here it does not,
because x_i excites J under any model: sampling only adds switches. It needs the sigma of white noise, and fails as
`bayes` does. The draw of a step is a function of (seed, node, step).
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hedgerow.agents.law import Array, control
from hedgerow.agents.laws.listed import Listed
from hedgerow.agents.laws.posterior import checked, weights
from hedgerow.agents.local import Local, Received
from hedgerow.topologies.graph import Gain


class Thompson(Listed):
    """Equation (6) on a candidate drawn from the posterior at every step."""

    equation: ClassVar[str] = "ahat = a_m with probability pi_m, drawn per (seed, node, step)"

    def __init__(self, b: Gain, candidates: Array, *, local: Local, sigma: float = 0.5) -> None:
        self.sigma, self.local = checked(sigma), local
        self._last = (~np.isnan(candidates)).sum(axis=0) - 1
        super().__init__(b, candidates)
        self.ahat[:], self.margin[:] = self.candidates[0], np.nan

    def _choose(self) -> None:
        """Sum up the weights; `act` draws."""
        pi = weights(self._memory, self.sigma)
        for m in range(1, self.m):  # row by row, in list order: no layout changes the sums
            pi[m] += pi[m - 1]
        self._sums = pi

    def act(self, x: Array, now: Received) -> Array:  # type: ignore[override]  # a law that asks
        """Return the inputs of equation (6) on the candidates drawn for this step."""
        drawn = self.local.draw(now.t, "thompson") * self._sums[-1]
        place = np.minimum((self._sums <= drawn).sum(axis=0), self._last)
        self.ahat[:] = self.candidates[place, self._nodes]
        return control(self.b, x, self.ahat)
