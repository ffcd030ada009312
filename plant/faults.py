"""Which faults strike at a step: a function of (effects, seed, step), whatever came before."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.effects import Effect
from hedgerow.topologies.graph import Graph, Index, Mask

Words = NDArray[np.uint64]

BLOCK = 64
"""steps whose lots are drawn at once"""


def strikes(effect: Effect, seed: int, steps: Index) -> Mask:
    """Which of an effect's targets it strikes at each of some steps, (S, targets).

    The lot of a target at a step is a hash of (seed, fault, target, step): no stream is shared, so that neither a
    stop nor another fault changes it.
    """
    targets = np.array(effect.targets, dtype=np.uint64)
    within = (effect.start <= steps) & (steps < effect.stop)
    if effect.probability >= 1:
        return np.repeat(within[:, None], len(targets), axis=1)
    root = _mixed(_mixed(np.array([seed], dtype=np.uint64)) + np.uint64(effect.fault))
    rows = _mixed(root + steps.astype(np.uint64))
    lots = (_mixed(rows[:, None] + targets) >> np.uint64(11)) * 2.0**-53
    return np.asarray((lots < effect.probability) & within[:, None])


def _mixed(words: Words) -> Words:
    """SplitMix64: a bijection of 64-bit words that leaves no trace of their order."""
    words = words + np.uint64(0x9E3779B97F4A7C15)
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


@dataclass(frozen=True)
class Wrong:
    """What goes wrong at one step; None where nothing of the kind does."""

    lost: Mask | None = None
    """link messages, by incidence, (2E,)"""
    late: Index | None = None
    """steps by which link messages are late, by incidence, (2E,)"""
    cut: Mask | None = None
    """edges, (E,)"""
    blind: Mask | None = None
    """nodes whose reading is lost, (n,)"""
    mute: Mask | None = None
    """nodes whose input is lost, (n,)"""


NOTHING = Wrong()
_FIELD = {"drop": "lost", "cut": "cut", "sensor": "blind", "actuator": "mute"}


class Faults:
    """The faults of a run, which may be added to and ended while it goes on."""

    def __init__(self, effects: Iterable[Effect], graph: Graph, seed: int) -> None:
        self._graph, self._seed = graph, seed
        self._sizes = {"lost": len(graph.node), "cut": len(graph.edges), "blind": graph.n, "mute": graph.n}
        self.effects = list(effects)
        self._changed()

    def _changed(self) -> None:
        self._from = self._until = 0
        self._active: list[Effect] = []
        self._lots: dict[int, tuple[int, Mask]] = {}

    def add(self, effects: Sequence[Effect]) -> None:
        """More of them, from now on."""
        self.effects += effects
        self._changed()

    def end(self, fault: int, t: int) -> None:
        """All effects of a fault stop at step t, if they have not yet."""
        self.effects = [
            replace(one, stop=max(one.start, min(one.stop, t))) if one.fault == fault else one for one in self.effects
        ]
        self._changed()

    def _look(self, t: int) -> list[Effect]:
        """The effects whose window holds t; they are looked for again only where a window begins or ends."""
        if not self._from <= t < self._until:
            self._active = [one for one in self.effects if one.start <= t < one.stop]
            edges = [step for one in self.effects for step in (one.start, one.stop)]
            self._until = min((step for step in edges if step > t), default=2**63)
            self._from = max((step for step in edges if step <= t), default=0)
        return self._active

    def none_at(self, t: int) -> bool:
        """Whether no effect is at work at step t."""
        return not self._look(t)

    def at(self, t: int) -> Wrong:
        """What goes wrong at step t, but for crashes and jumps."""
        if not self._look(t):
            return NOTHING
        found: dict[str, Mask] = {}
        late: Index | None = None
        for effect in self._active:
            if effect.kind == "delay":
                struck = self._struck(effect, t)
                if late is None:
                    late = np.zeros(len(self._graph.node), dtype=np.int64)
                late[struck] = np.maximum(late[struck], effect.by)
            elif (field := _FIELD.get(effect.kind)) is not None and len(struck := self._struck(effect, t)):
                if field not in found:
                    found[field] = np.zeros(self._sizes[field], dtype=bool)
                found[field][struck] = True
        return Wrong(late=late, **found) if found or late is not None else NOTHING

    def _struck(self, effect: Effect, t: int) -> Index:
        if effect.table is not None:
            return np.array(effect.table.get(t, ()), dtype=np.int64)
        targets = np.array(effect.targets, dtype=np.int64)
        if effect.probability >= 1:
            return targets
        first, lots = self._lots.get(id(effect), (t + 1, np.empty((0, 0), dtype=bool)))
        if not first <= t < first + BLOCK:
            first, lots = t, strikes(effect, self._seed, np.arange(t, t + BLOCK))
            self._lots[id(effect)] = first, lots
        return np.asarray(targets[lots[t - first]])

    def absent(self, t: int) -> Mask | None:
        """Nodes whose agent is dead at step t, (n,); None when none is."""
        if not self._look(t):
            return None
        dead = [one.targets for one in self._look(t) if one.kind == "crash"]
        if not dead:
            return None
        absent = np.zeros(self._graph.n, dtype=bool)
        for targets in dead:
            absent[list(targets)] = True
        return absent

    def jumps(self, t: int) -> list[tuple[int, float]]:
        """Nodes whose true a is another from step t on, and which."""
        return [(one.targets[0], one.a) for one in self._look(t) if one.kind == "jump" and one.start == t]
