"""The law: every node estimates its own a and acts on the estimate, equations (6) and (7) of the paper.

    u_i(t)       = b x_i(t) / (ahat_i(t) - 1)                                    (6)
    ahat_i(t)    = the first candidate that minimises J_i,m(t)                   (7)
    J_i,m(t + 1) = J_i,m(t) + (a_m x_i(t) + b f_i(t) - x_i(t + 1))^2,  J_i,m(0) = 0

All is vectorised over the k nodes of a shard; rows never mix. The H-infinity controller (8) is this law with
the truth as its only candidate, the nominal one with the nominal value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Law(Protocol):
    """What a control law is to a shard; `Class(b, candidates)` makes one.

    `b` is the gain of (1), `candidates` one sequence of models a node.
    """

    def __init__(self, b: float, candidates: Sequence[Sequence[float]]) -> None: ...

    def act(self, x: Array) -> Array:
        """The inputs u(t) from the states x(t), both (k,)."""

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        """Take in the sample of one past step: x(t), f(t) and x(t + 1), (k,); where f is NaN there is none."""

    def report(self) -> Array:
        """What the nodes say of themselves, (k, 4): ahat, its index, J_(2) - J_(1), a_LS; NaN for what there is not."""


def control(b: float, x: Array, ahat: Array) -> Array:
    """The inputs u = b x / (ahat - 1), all (k,); equations (6) and (8)."""
    return b * x / (ahat - 1.0)


class Minimax:
    """The distributed minimax adaptive controller: memory of M numbers a node, no history."""

    def __init__(self, b: float, candidates: Sequence[Sequence[float]]) -> None:
        self.b = b
        k, longest = len(candidates), max(map(len, candidates))
        self.candidates = np.full((k, longest), 0.5)
        self.J = np.full((k, longest), np.inf)
        """J_i,m(t), (k, M); infinite where a node has fewer candidates than the longest list, so that it never wins."""
        for i, listed in enumerate(candidates):
            self.candidates[i, : len(listed)] = listed
            self.J[i, : len(listed)] = 0.0
        self._rows = np.arange(k)
        self._sxx = np.zeros(k)
        self._sxy = np.zeros(k)
        self._choose()

    def _choose(self) -> None:
        # argmin takes the first of equals: ties go to the candidate that is listed first.
        self.index = self.J.argmin(axis=1)
        self.ahat = self.candidates[self._rows, self.index]

    def act(self, x: Array) -> Array:
        """Equation (6)."""
        return control(self.b, x, self.ahat)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        """Equation (7), one sample further; a node whose flow is unknown (NaN) skips it."""
        y = x_next - self.b * flow
        residual = self.candidates * x[:, None] - y[:, None]
        if np.isfinite(np.add.reduce(flow)):  # all are known
            self.J += residual * residual
            self._sxx += x * x
            self._sxy += x * y
        else:
            known = np.isfinite(flow)
            self.J[known] += residual[known] ** 2
            self._sxx[known] += x[known] ** 2
            self._sxy[known] += x[known] * y[known]
        self._choose()

    def report(self) -> Array:
        """The estimate ahat, its index, the margin J_(2) - J_(1) (infinite without a rival), and a_LS = Sxy / Sxx."""
        report = np.empty((len(self.ahat), 4))
        report[:, 0] = self.ahat
        report[:, 1] = self.index
        report[:, 2] = np.inf
        if self.J.shape[1] > 1:
            least = np.partition(self.J, 1, axis=1)
            report[:, 2] = least[:, 1] - least[:, 0]
        report[:, 3] = np.nan
        np.divide(self._sxy, self._sxx, out=report[:, 3], where=self._sxx > 0)
        return report
