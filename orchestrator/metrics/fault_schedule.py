"""The schedule of the faults at some steps: a function of the file alone, independent of the run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hedgerow.plant.faults import Lots
from hedgerow.topologies.effects import FOREVER, Effect
from hedgerow.topologies.faults import effects
from hedgerow.topologies.graph import Graph, Index, Mask
from hedgerow.topologies.lots import Words
from hedgerow.topologies.schema import Topology


class Instances(NamedTuple):
    """The scheduled instances of faults, one (target, step) each: the fault, the index of the step, and the target,
    (K,).
    """

    fault: Index
    row: Index
    target: Index


class Schedule:
    """The effects of all faults of a resolved topology."""

    def __init__(self, topology: Topology) -> None:
        found = effects(topology.faults, topology) if topology.faults else []
        self._begin(topology.graph, topology.ids, topology.seed, len(topology.faults), found)

    @classmethod
    def of(cls, graph: Graph, ids: Any, seed: int | Words, faults: int, found: Sequence[Effect]) -> Schedule:
        """Return the schedule of some effects; `seed` is one, or one per node, (n,)."""
        schedule = cls.__new__(cls)
        schedule._begin(graph, ids, seed, faults, found)
        return schedule

    def _begin(self, graph: Graph, ids: Any, seed: int | Words, faults: int, found: Sequence[Effect]) -> None:
        self._n, self.faults, self.effects = graph.n, faults, list(found)
        self._lots = Lots(graph, ids, seed)
        self._lots.take(self.effects)

    def between(self, first: int, stop: int) -> list[Effect]:
        """Return the effects that are active at one of these steps or more."""
        return [one for one in self.effects if max(one.start, first) < min(one.stop, stop)]

    def instances(self, steps: Index, *struck: str) -> Instances:
        """Return the instances of effects that strike these things, at ascending steps.

        A crash and a jump count at their start.
        """
        found: list[Index] = [np.empty((3, 0), dtype=np.int64)]
        for effect in self.between(int(steps[0]), int(steps[-1]) + 1):
            if effect.strikes in struck:
                rows, targets = self._struck(effect, steps)
                found.append(np.stack([np.full(len(rows), effect.fault), rows, targets]))
        return Instances(*np.concatenate(found, axis=1))

    def _struck(self, effect: Effect, steps: Index) -> tuple[Index, Index]:
        """Return (row, target) of all instances of one effect."""
        if effect.table is not None:
            table = effect.table
            pairs = [(row, target) for row, t in enumerate(steps.tolist()) for target in table.get(t, ())]
            row, target = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
            return row, target
        if effect.counts_once:
            struck = np.repeat(steps[:, None] == effect.start, len(effect.targets), axis=1)
        else:
            struck = self._lots.strikes(effect, steps)
        row, column = struck.nonzero()
        return row, np.array(effect.targets, dtype=np.int64)[column]

    def absent(self, steps: Index) -> Mask:
        """Return a mask of the nodes without an agent at each of some ascending steps, (S, n)."""
        absent = np.zeros((len(steps), self._n), dtype=np.bool_)
        for one in self.between(int(steps[0]), int(steps[-1]) + 1):
            if one.removes_agents:
                within = (one.start <= steps) & (steps < one.stop)
                absent[np.ix_(within, np.array(one.targets, dtype=np.int64))] = True
        return absent

    def jumps(self, since: int) -> list[Effect]:
        """Return the jumps at step `since` and later, in the order of their steps."""
        return sorted((one for one in self.effects if one.changes_truth and one.start >= since), key=_start)

    def beyond(self, steps: int) -> list[int]:
        """Return, by fault, the number of (target, step) in its window at `steps` or later; 0 for an endless window."""
        beyond = [0] * self.faults
        for one in self.effects:
            if one.table is not None:
                beyond[one.fault] += sum(len(struck) for step, struck in one.table.items() if step >= steps)
            elif one.counts_once:
                beyond[one.fault] += len(one.targets) * (steps <= one.start < one.stop)
            elif one.stop < FOREVER:
                beyond[one.fault] += len(one.targets) * max(0, one.stop - max(one.start, steps))
        return beyond

    def idle(self, steps: int) -> dict[int, str]:
        """Return the faults that cannot strike before `steps` for any draw, with the reason; not those that were
        healed.
        """
        able = {one.fault for one in self.effects if one.start >= one.stop or _strikes_before(one, steps)}
        late = {one.fault for one in self.effects if _strikes_before(one, FOREVER)}
        return {
            fault: f"the run has {steps} steps" if fault in late else "there is nothing that it strikes"
            for fault in range(self.faults)
            if fault not in able
        }


def _strikes_before(effect: Effect, steps: int) -> bool:
    if effect.table is not None:
        return any(struck and step < steps for step, struck in effect.table.items())
    return bool(effect.targets) and effect.start < min(steps, effect.stop)


def _start(effect: Effect) -> int:
    return effect.start
