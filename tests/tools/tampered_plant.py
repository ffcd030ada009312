"""Plants that break their world in one way each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hedgerow.agents.law import Array
from hedgerow.plant.disturbance import Disturbance
from hedgerow.plant.faults import Faults
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.effects import Effect
from hedgerow.wire.message import Telemetry
from tests.tools.watched_network import NODE


class _Changed(World):
    """A plant with a changed truth, changed faults or changed disturbances."""

    def __init__(self, truth: Truth) -> None:
        super().__init__(self.changed(truth))
        self.disturb(truth)
        effects = map(self.other, self.kept(self.faults.effects))
        self.faults = Faults(effects, self.graph, truth.ids, truth.seed)

    def kept(self, effects: Sequence[Effect]) -> Sequence[Effect]:
        return effects

    def changed(self, truth: Truth) -> Truth:
        return truth

    def other(self, effect: Effect) -> Effect:
        return effect

    def disturb(self, truth: Truth, /) -> None: ...

    def at_w(self, change: Callable[[Array, int], Array]) -> None:
        at = self._disturbance.at
        self._disturbance.at = lambda t, x=None, a=None: change(at(t, x, a), t)  # type: ignore[method-assign]


class StartOff(_Changed):
    """Begins 1 % off."""

    def changed(self, truth: Truth) -> Truth:
        return replace(truth, x0=truth.x0 * np.where(truth.ids == NODE, 1.01, 1.0))


class LargerW(_Changed):
    """Scales w by 1 + 1e-6."""

    def disturb(self, _: Truth, /) -> None:
        self.at_w(lambda w, _: w * (1 + 1e-6))


class OtherSeed(_Changed):
    """Draws w by another seed."""

    def disturb(self, truth: Truth, /) -> None:
        self._disturbance = Disturbance(truth.disturbance, truth.ids, truth.seed + 1)


class LateW(_Changed):
    """Applies w one step late."""

    def disturb(self, _: Truth, /) -> None:
        at = self._disturbance.at
        self._disturbance.at = lambda t, x=None, a=None: at(max(0, t - 1), x, a)  # type: ignore[method-assign]


class OneUlpMotion(_Changed):
    """Moves one node to the next float, once."""

    def advance(self, u: Array) -> None:
        super().advance(u)
        if self.t == 10:
            self.x = np.where(np.arange(self.graph.n) == NODE - 1, np.nextafter(self.x, np.inf), self.x)


class OtherA(_Changed):
    """Moves by an a that is off by 1e-12."""

    def changed(self, truth: Truth) -> Truth:
        return replace(truth, a=truth.a + np.where(truth.ids == NODE, 1e-12, 0.0))


class OtherB(_Changed):
    """Moves by another input gain b."""

    def changed(self, truth: Truth) -> Truth:
        return replace(truth, b=truth.b * (1 + 1e-9))


class ShorterDelay(_Changed):
    """Delays by 2 steps in place of 3."""

    def other(self, effect: Effect) -> Effect:
        return replace(effect, by=2) if effect.kind == "delay" else effect


class Without(_Changed):
    """Leaves out the faults of one kind."""

    def __init__(self, kind: str, truth: Truth) -> None:
        self._kind = kind
        super().__init__(truth)

    def kept(self, effects: Sequence[Effect]) -> Sequence[Effect]:
        return [one for one in effects if one.kind != self._kind]


class LateJump(_Changed):
    """Changes a one step late."""

    def other(self, effect: Effect) -> Effect:
        return replace(effect, start=effect.start + 1) if effect.kind == "jump" else effect


class LongerCrash(_Changed):
    """Lets the agent come back one step late."""

    def other(self, effect: Effect) -> Effect:
        return replace(effect, stop=effect.stop + 1) if effect.kind == "crash" else effect


class OtherLots(_Changed):
    """Drops a message without a fault in the file."""

    def kept(self, effects: Sequence[Effect]) -> Sequence[Effect]:
        return [*effects, Effect(len(effects), "drop", (int(self.graph.first[NODE - 1]),), 12, 13)]


class OneSidedCut(_Changed):
    """Cuts the edge at one of its ends."""

    def advance(self, u: Array) -> None:
        super().advance(u)
        if self.t == 18:
            one_sided = self.b * (self._made.u[0] - self._made.u[1])
            self.x = self.x + np.where(np.arange(self.graph.n) == NODE - 1, -one_sided, 0.0)


class HeldInput(_Changed):
    """Lets the last input act where one is lost."""

    def __init__(self, truth: Truth) -> None:
        super().__init__(truth)
        self._last = np.zeros(self.graph.n)

    def advance(self, u: Array) -> None:
        self._last = np.where(np.isfinite(u), u, self._last)
        super().advance(self._last)


class EdgeReportedOpen(_Changed):
    """Reports a closed edge as open."""

    def account(self, report: Array, used: Sequence[Any]) -> Telemetry:
        row = super().account(report, used)
        return row._replace(edge_open=np.ones_like(row.edge_open))


class ShortHistory(_Changed):
    """Keeps one past row in place of all."""

    def changed(self, truth: Truth) -> Truth:
        return replace(truth, history=1)
