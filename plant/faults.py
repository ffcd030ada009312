"""The faults that strike at a step: a function of (effects, seed, step), independent of earlier calls."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import lots
from hedgerow.topologies.effects import EDGES, INCIDENCES, NODES, Effect
from hedgerow.topologies.graph import Graph, Index, Mask

BLOCK, BLOCK_BYTES = 64, 2**24
"""The maximum number of steps for which faults are computed at once, and of bytes for one kind of target."""


class Lots:
    """The random draws of faults: they decide which targets an effect strikes at a step.

    A draw is a function of (seed, kind of fault, turn, ids of the target, step). The turn of an effect at a target is
    the number of effects of the same kind before it in the list that strike the same target by chance. So two of them
    strike independently, and a fault elsewhere changes nothing.
    """

    def __init__(self, graph: Graph, ids: Sequence[int | str] | NDArray[Any], seed: int | lots.Words) -> None:
        """`seed` is one, or one per node, (n,)."""
        self._graph, self._ids, self._seed = graph, ids, seed
        self._turns: Counter[tuple[str, int]] = Counter()
        self._keys: dict[tuple[int, str, Sequence[int]], lots.Words] = {}

    def take(self, effects: Iterable[Effect]) -> None:
        """Give these effects their turns, after all earlier effects."""
        for effect in effects:
            if not _drawn(effect):
                continue
            targets = np.array(effect.targets, dtype=np.int64)
            words = self._words(effect.of, targets)
            turns = np.array([self._turns[effect.kind, target] for target in effect.targets], dtype=np.int64)
            keys = np.empty(len(targets), dtype=np.uint64)
            for turn in np.unique(turns).tolist():
                here = turns == turn
                keys[here] = lots.keys(self._seeds(effect.of, targets[here]), f"{effect.kind}.{turn}", words[here])
            self._turns.update((effect.kind, target) for target in effect.targets)
            self._keys[_name(effect)] = keys

    def _words(self, of: str, targets: Index) -> lots.Words:
        graph = self._graph
        if of == INCIDENCES:  # the direction is from the sending neighbour to the node
            ends = graph.neighbour[targets], graph.node[targets]
            return lots.pairs_of(*(self._nodes(end) for end in ends))
        if of == EDGES:
            return lots.edges_of(*(self._nodes(end) for end in graph.edges[targets].T))
        return self._nodes(targets)

    def _seeds(self, of: str, targets: Index) -> int | lots.Words:
        """Return the seed of each target; both ends of an edge have the same."""
        if isinstance(self._seed, int):
            return self._seed
        ends = {INCIDENCES: self._graph.node, EDGES: self._graph.edges[:, 0]}
        return self._seed[ends[of][targets] if of in ends else targets]

    def _nodes(self, nodes: Index) -> lots.Words:
        if isinstance(self._ids, np.ndarray):
            return lots.words_of(self._ids[nodes])
        return lots.words_of([self._ids[k] for k in nodes.tolist()])

    def strikes(self, effect: Effect, steps: Index) -> Mask:
        """Return the targets that an effect strikes at each of the steps, (S, targets); call `take` first if it has a
        probability.
        """
        within = (effect.start <= steps) & (steps < effect.stop)
        if effect.probability >= 1:
            return np.repeat(within[:, None], len(effect.targets), axis=1)
        drawn = lots.uniforms(lots.at(self._keys[_name(effect)], steps[:, None]))
        return np.asarray((drawn < effect.probability) & within[:, None])


def _drawn(effect: Effect) -> bool:
    return effect.table is None and effect.probability < 1


def _name(effect: Effect) -> tuple[int, str, Sequence[int]]:
    """Return the identity of an effect, which stays the same when its window ends early."""
    return effect.fault, effect.kind, tuple(effect.targets)


class LinkFaults(NamedTuple):
    """The lost and late link messages of S steps."""

    lost: Mask
    """(S, 2E)"""
    late: Index | None
    """steps by which link messages are late, (S, 2E); None if none is"""
    active: Sequence[bool]
    """by step: True if any message is lost or late"""


@dataclass(frozen=True)
class ActiveFaults:
    """The faults active at one step; None for each kind without a fault."""

    lost: Mask | None = None
    """link messages, by incidence, (2E,)"""
    late: Index | None = None
    """steps by which link messages are late, by incidence, (2E,)"""
    cut: Mask | None = None
    """edges, (E,)"""
    blind: Mask | None = None
    """nodes without a reading, (n,)"""
    mute: Mask | None = None
    """nodes without an input, (n,)"""


def sizes(graph: Graph) -> dict[str, int]:
    """Return the numbers of possible targets, by their meaning."""
    return {INCIDENCES: len(graph.node), EDGES: len(graph.edges), NODES: graph.n}


class Faults:
    """The faults of a run; faults may be added and ended during the run."""

    def __init__(
        self, effects: Iterable[Effect], graph: Graph, ids: Sequence[int | str] | NDArray[Any], seed: int | lots.Words
    ) -> None:
        self._graph, self._chance = graph, Lots(graph, ids, seed)
        self._sizes = sizes(graph)
        self.effects = list(effects)
        self._chance.take(self.effects)
        self.changes = 0
        """number of times that the list of effects was changed"""
        self._changed()

    def _changed(self) -> None:
        self.changes += 1
        self._from = self._until = 0
        self._active: list[Effect] = []
        self._dead: list[Effect] = []
        self._jumps: list[Effect] = []
        self._first, self._block = 0, list[ActiveFaults | None]()
        """the faults of some steps from the first one on"""
        self._struck_in_block: dict[str, Any] = {}
        """of these steps, the targets by field of ActiveFaults, (S, targets)"""

    def add(self, effects: Sequence[Effect]) -> None:
        """Add effects that are valid from now on."""
        self.effects += effects
        self._chance.take(effects)
        self._changed()

    def end(self, fault: int, t: int) -> None:
        """Stop all effects of a fault at step t, unless they stopped earlier."""
        self.effects = [
            replace(one, stop=max(one.start, min(one.stop, t))) if one.fault == fault else one for one in self.effects
        ]
        self._changed()

    def _look(self, t: int) -> list[Effect]:
        """Return the effects with a window that contains t; search again only at the ends of windows."""
        if not self._from <= t < self._until:
            self._active = [one for one in self.effects if one.start <= t < one.stop]
            self._dead = [one for one in self._active if one.removes_agents]
            self._jumps = [one for one in self._active if one.changes_truth]
            edges = [step for one in self.effects for step in (one.start, one.stop)]
            self._until = min((step for step in edges if step > t), default=2**63)
            self._from = max((step for step in edges if step <= t), default=0)
            self._block = []
        return self._active

    def none_at(self, t: int) -> bool:
        """Return True if no effect is active at step t."""
        return not self._look(t)

    def at(self, t: int) -> ActiveFaults | None:
        """Return the faults active at step t, except crashes and jumps; None if there are none."""
        if not self._look(t):
            return None
        if not 0 <= t - self._first < len(self._block):
            self._first, self._block = t, self._faults_from(t)
        return self._block[t - self._first]

    def of_links(self, t: int, most: int) -> LinkFaults | None:
        """Return the faults of link messages from step t on, of at most `most` steps without any other fault.

        None if no effect is active at t, or another fault is.
        """
        self.at(t)
        if not self._active or self._dead:
            return None
        start, found = t - self._first, self._struck_in_block
        block, stop = self._block[start : start + most], 0
        for active in block:
            if active is not None and not (active.cut is None and active.blind is None and active.mute is None):
                break
            stop += 1
        if not stop:
            return None
        steps, links = slice(start, start + stop), self._sizes[INCIDENCES]
        lost = found["lost"][steps] if "lost" in found else np.zeros((stop, links), dtype=bool)
        late = found["late"][steps] if "late" in found else None
        return LinkFaults(lost, late, [active is not None for active in block[:stop]])

    def _faults_from(self, t: int) -> list[ActiveFaults | None]:
        """Return the faults at some steps from t on, computed at once, while the same effects are active."""
        most = max(1, min(BLOCK, BLOCK_BYTES // max(1, *self._sizes.values())))
        steps = np.arange(t, min(t + most, self._until))
        found: dict[str, Any] = {}
        for effect in self._active:
            if effect.counts_once:
                continue
            field = effect.strikes
            rows, targets = self._struck(effect, steps)
            if not len(rows):
                continue
            if field not in found:
                kind = np.int64 if field == "late" else np.bool_
                found[field] = np.zeros((len(steps), self._sizes[effect.of]), dtype=kind)
            by = effect.by if field == "late" else True
            found[field][rows, targets] = np.maximum(found[field][rows, targets], by)
        self._struck_in_block = found
        struck = {field: values.any(axis=1).tolist() for field, values in found.items()}
        return [
            ActiveFaults(**here) if (here := {field: found[field][k] for field in found if struck[field][k]}) else None
            for k in range(len(steps))
        ]

    def _struck(self, effect: Effect, steps: Index) -> tuple[Index, Index]:
        """Return the strikes of an effect: their places in `steps`, and their targets."""
        if effect.table is not None:
            pairs = [(k, one) for k, t in enumerate(steps.tolist()) for one in effect.table.get(t, ())]
            places: Index = np.array(pairs, dtype=np.int64).reshape(-1, 2)
            return places[:, 0], places[:, 1]
        rows, columns = np.nonzero(self._chance.strikes(effect, steps))
        return rows, np.array(effect.targets, dtype=np.int64)[columns]

    def absent(self, t: int) -> Mask | None:
        """Return a mask of the nodes that have no running agent at step t, (n,); None if there is none."""
        if not self._look(t) or not self._dead:
            return None
        absent = np.zeros(self._graph.n, dtype=bool)
        for effect in self._dead:
            absent[list(effect.targets)] = True
        return absent

    def jumps(self, t: int) -> list[tuple[int, float]]:
        """Return the nodes with a new true a from step t on, each with its new a."""
        return [(one.targets[0], one.a) for one in self._jumps if one.start == t] if self._look(t) else []
