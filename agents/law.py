"""The law: every node estimates its own a and acts on the estimate, equations (6) and (7) of the paper.

    u_i(t)       = b_i x_i(t) / (ahat_i(t) - 1)                                  (6)
    ahat_i(t)    = the first candidate that minimises J_i,m(t)                   (7)
    J_i,m(t + 1) = J_i,m(t) + (a_m x_i(t) + b_i f_i(t) - x_i(t + 1))^2,  J_i,m(0) = 0

All operations are vectorised over the k nodes of a shard; nodes never mix. The H-infinity controller (8) is this law
with the true a as its only candidate. The nominal controller has the nominal value as its only candidate.
"""

from __future__ import annotations

from types import ModuleType
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import fast
from hedgerow.topologies.fast import kernels_for, unequal_kernels_for
from hedgerow.topologies.graph import FEW, Gain, all_finite

Array = NDArray[np.float64]


class Law(Protocol):
    """The interface of a control law; a shard constructs it as `Class(b, candidates)`.

    `b` is the gain of (1): one number, or that of each node, (k,). `candidates` (M, k) has one column per node with its
    models in list order. Shorter lists are padded with NaN.
    """

    def __init__(self, b: Gain, candidates: Array) -> None: ...

    def act(self, x: Array) -> Array:
        """Return the inputs u(t) for the states x(t), both (k,)."""

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        """Learn the sample of one past step: x(t), f(t) and x(t + 1), each (k,).

        If f is NaN, the node has no sample.
        """

    def report(self) -> Array:
        """Return the report of the nodes, (2, k): ahat and J_(2) - J_(1), NaN where a value does not exist."""

    memory: Array
    """Everything learned, (..., k), one column per node. Assigning a saved copy discards everything learned since.
    The shard does this to learn a late sample, and to reset a node that lost its memory."""


def control(b: Gain, x: Array, ahat: Array) -> Array:
    """Return the inputs u = b x / (ahat - 1), all (k,); equations (6) and (8). `b` is one number or (k,)."""
    if x.ndim == 1 and len(x) >= fast.LARGE and (kernels := _kernels_for(b, len(x))) is not None:
        return kernels.control(b, x, ahat)  # type: ignore[no-any-return]
    return b * x / (ahat - 1.0)


def _kernels_for(b: Gain, nodes: int) -> ModuleType | None:
    return kernels_for(nodes) if isinstance(b, float) else unequal_kernels_for(nodes)


def two_smallest(rows: Array) -> tuple[Array, Array]:
    """Return the smallest and the second smallest number of each column; `rows` has at least two rows."""
    if rows.size <= FEW:
        ordered = rows.copy()
        ordered.sort(axis=0)
        return ordered[0], ordered[1]
    least, second = np.minimum(rows[0], rows[1]), np.maximum(rows[0], rows[1])
    for row in rows[2:]:
        np.minimum(second, np.maximum(least, row), out=second)
        np.minimum(least, row, out=least)
    return least, second


class Minimax:
    """The distributed minimax adaptive controller; it remembers M numbers per node and no history."""

    equation: ClassVar[str] = "J <- J + r^2, r = a x + b f - x(t + 1) (7)"

    def __init__(self, b: Gain, candidates: Array) -> None:
        self.b = b
        none, k = np.isnan(candidates), candidates.shape[1]
        self.candidates = np.where(none, 0.5, candidates)
        self.J = np.where(none, np.inf, 0.0)
        """J_m,i(t), (M, k), infinite for the padding of shorter candidate lists, so that padding is never chosen."""
        self._nodes = np.arange(k)
        self._report = np.full((2, k), np.inf)
        self.ahat, self.margin = self._report
        self._choose()

    @property
    def memory(self) -> Array:
        """Return the costs J, (M, k)."""
        return self.J

    @memory.setter
    def memory(self, J: Array) -> None:
        self.J = J
        self._choose()

    def _choose(self) -> None:
        # argmin returns the first of equal values, so a tie goes to the candidate listed first.
        self.ahat[:] = self.candidates[self.J.argmin(axis=0), self._nodes]
        if len(self.J) > 1:
            least, second = two_smallest(self.J)
            np.subtract(second, least, out=self.margin)

    def act(self, x: Array) -> Array:
        """Return the inputs of equation (6)."""
        return control(self.b, x, self.ahat)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        """Update J by one sample, equation (7); skip nodes with an unknown flow (NaN)."""
        whole = all_finite(flow)
        if whole and (kernels := _kernels_for(self.b, len(flow))) is not None:
            kernels.learn(self.J, self.candidates, self.b, x, flow, x_next, self.ahat, self.margin)
            return
        residual = self.candidates * x
        residual -= x_next - self.b * flow
        residual *= residual
        if whole:
            self.J += residual
        elif (known := np.isfinite(flow)).any():
            self.J[:, known] += residual[:, known]
        else:
            return
        self._choose()

    def report(self) -> Array:
        """Return the estimate ahat and the margin J_(2) - J_(1), infinite if there is only one candidate."""
        return self._report
