# ruff: noqa: ARG002
"""Laws that break the contract, each in one way; `BROKEN` names the method that does."""

from __future__ import annotations

from typing import Any

import numpy as np

from hedgerow.agents.law import Array, Minimax, control
from hedgerow.agents.local import Received


class IntegratesWithoutFlow(Minimax):
    """Finding M: learns x although the flow is missing."""

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        self.J = self.J + np.nan_to_num(x) ** 2
        self._choose()


class MixesRows(Minimax):
    def act(self, x: Array) -> Array:
        apart: Array = x - np.nanmean(x)
        return super().act(x) + 0.01 * apart


class MixesWhatItLearns(Minimax):
    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        super().learn(x, np.where(np.isnan(flow), np.nan, flow + 1e-3 * np.nansum(flow)), x_next)


class LearnsInAct(Minimax):
    def act(self, x: Array) -> Array:
        self.memory = self.J + np.where(np.isinf(self.J), 0, 1.0)
        return super().act(x)


class LearnsInReport(Minimax):
    def report(self) -> Array:
        self.memory = self.J * 1.5 + 1.0
        return super().report()


class HidesItsMemory:
    """Acts on a state that is not in `memory`."""

    def __init__(self, b: float, candidates: Array) -> None:
        self.b, self.a = b, candidates[0].copy()
        self.memory = np.empty((0, candidates.shape[1]))

    def act(self, x: Array) -> Array:
        return control(self.b, x, self.a)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        known = np.isfinite(flow)
        self.a = np.where(known, 0.99 * self.a, self.a)

    def report(self) -> Array:
        return np.stack([self.a, np.full(len(self.a), np.nan)])


class CountsItsObjects(Minimax):
    """Depends on more than its calls: on how many objects of its class there are."""

    made = 0

    def __init__(self, b: float, candidates: Array) -> None:
        super().__init__(b, candidates)
        type(self).made += 1
        self.gain = 1.0 + 0.01 * type(self).made

    def act(self, x: Array) -> Array:
        return self.gain * super().act(x)


class DrawsWithoutSeed(Minimax):
    def act(self, x: Array) -> Array:
        return super().act(x) + np.random.default_rng().normal(size=len(x))


class DividesByZero(Minimax):
    def act(self, x: Array) -> Array:
        return super().act(x) / np.where(x == 0, 0.0, 1.0)


class ReturnsOne(Minimax):
    def act(self, x: Array) -> Array:
        return super().act(x)[:1]


class ReportsOneRow(Minimax):
    def report(self) -> Array:
        return super().report()[:1]


class ChangesItsArguments(Minimax):
    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        super().learn(x, flow, x_next)
        x *= 2


class HasAListForMemory(Minimax):
    memory: Any = [0.0]  # noqa: RUF012


class ForgetsWhatIsAssigned(Minimax):
    @property
    def memory(self) -> Array:
        return self.J

    @memory.setter
    def memory(self, J: Array) -> None:
        pass


class Raises(Minimax):
    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        if np.isnan(flow).any():
            raise ZeroDivisionError("of my own")
        super().learn(x, flow, x_next)


class CannotBegin(Minimax):
    def __init__(self, b: float, candidates: Array) -> None:
        raise ValueError("no candidates for me")


class LearnsForOtherNodes(Minimax):
    """Asks for the sample, and learns in columns that the call is not for."""

    def learn(self, x: Array, flow: Array, x_next: Array, sample: Received) -> None:  # type: ignore[override]
        super().learn(x, flow, x_next)
        self.memory = self.J + np.where(sample.nodes, 0.0, 1.0)


BROKEN: dict[type[Any], str] = {
    IntegratesWithoutFlow: "learn",
    MixesRows: "act",
    MixesWhatItLearns: "learn",
    LearnsInAct: "act",
    LearnsInReport: "report",
    HidesItsMemory: "act",
    CountsItsObjects: "act",
    DrawsWithoutSeed: "act",
    DividesByZero: "act",
    ReturnsOne: "act",
    ReportsOneRow: "report",
    ChangesItsArguments: "learn",
    HasAListForMemory: "memory",
    ForgetsWhatIsAssigned: "memory",
    Raises: "learn",
    CannotBegin: "__init__",
    LearnsForOtherNodes: "learn",
}
