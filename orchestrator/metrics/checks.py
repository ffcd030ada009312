"""The checks of every step, with the smallest distance of each check from failure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hedgerow.topologies.graph import Array, Gain, Index, Mask

TINY = 1e-300
"""prevents 0 / 0"""
ROUNDING = 1e-9
"""The relative tolerance of inequalities that are exact only without rounding."""


@dataclass
class Worst:
    """One check over all steps: the largest excess, and its step; a positive excess is a violation."""

    excess: float = -np.inf
    step: int = -1
    steps: int = 0
    node: int = -1
    """the first node that breaks an exact claim at that step, -1 if no node is named"""
    why: str = ""
    """the problem of that node"""

    def see(self, excess: Array, steps: Index) -> None:
        """Record the excess at each of `steps`; NaN counts as a violation."""
        if len(excess):
            excess = np.where(np.isnan(excess), np.inf, excess)
            k = int(np.argmax(excess))
            if excess[k] > self.excess:
                self.excess, self.step = float(excess[k]), int(steps[k])
            self.steps += len(excess)

    def see_exact(self, holds: Mask, steps: Index) -> None:
        """Record if a claim holds at each step."""
        self.see(np.where(holds, -1.0, 1.0), steps)


class _Due(NamedTuple):
    """The prediction of some rows for the next state: the step, x (B, n) by equation (1), and the bound on its norm."""

    t: Index
    x: Array
    bound: Array

    def rows(self, some: slice | Mask) -> _Due:
        return _Due(self.t[some], self.x[some], self.bound[some])

    def then(self, later: _Due) -> _Due:
        return _Due(*(np.concatenate([getattr(one, name) for one in (self, later)]) for name in self._fields))


def norms(x: Array, b: Gain) -> Array:
    """Return |x| = sum |x_i| min(b) / b_i of B vectors, (B,); in this norm any estimates contract, and min(b) scales
    it.
    """
    if isinstance(b, np.ndarray):
        return np.asarray((np.abs(x) * (b.min() / b)).sum(axis=-1))
    return np.asarray(np.abs(x).sum(axis=-1))


class DynamicsCheck:
    """The check of equation (1), bit for bit, and of the contraction, from each row to the next state."""

    def __init__(self, b: Gain) -> None:
        self._b = b
        self.dynamics, self.contraction = Worst(), Worst()
        self._due: _Due | None = None
        """the prediction of the last row"""

    def take(self, t: Index, x: Array, x_next: Array, bound: Array) -> None:
        """Record x (B, n) at steps t (B,), the next state of each by equation (1), and the bound on its norm."""
        due = _Due(t, x_next, bound)
        if self._due is not None:
            due = self._due.then(due)
        self._due = due.rows(slice(-1, None))
        known = len(due.t) - 1
        self._compare(due.rows(slice(known)), t[len(t) - known :], x[len(t) - known :])

    def finish(self, t: int, x: Array) -> None:
        """Record the final state x (n,) at step t."""
        if self._due is not None:
            self._compare(self._due, np.array([t]), x[None])

    def _compare(self, due: _Due, t: Index, x: Array) -> None:
        """Compare predictions with states; after lost telemetry, successive rows are not successive steps."""
        follows = t == due.t + 1
        if not follows.all():
            due, x = due.rows(follows), x[follows]
        equal = due.x == x
        self.dynamics.see_exact(equal.all(axis=1), due.t)
        if self.dynamics.excess > 0 and self.dynamics.node < 0:
            k = int(np.searchsorted(due.t, self.dynamics.step))
            self.dynamics.node = node = int(equal[k].argmin())
            self.dynamics.why = (
                f"x({due.t[k] + 1}) is {float(x[k, node])!r}, and equation (1) gives {float(due.x[k, node])!r}"
            )
        self.contraction.see(norms(x, self._b) / (due.bound + TINY) - 1 - ROUNDING, due.t)
