"""Which rows of link messages cross at a step, and which are still to come.

A link is an incidence: node i hears neighbour j over it. In step t, one that is up brings the row of t, and before it
all rows that did not cross while it was down. One that is late by k brings what it has up to the row of t - k.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hedgerow.topologies.graph import Graph, Index, Mask


class Deliveries(NamedTuple):
    """What crosses the links at one step, (2E,) each: whether any row does, row t - late, and `back` before it."""

    some: Mask
    late: Index
    back: Index

    @property
    def fresh(self) -> Mask:
        """Return the links that deliver the row of the step itself."""
        return np.asarray(self.some & (self.late == 0))


class Links:
    """Keeps, for every link, the first row that has not crossed; at most `history` rows are kept at its ends."""

    def __init__(self, graph: Graph, history: int) -> None:
        self._graph, self._history = graph, history
        self._lacks: Index = np.full(len(graph.node), -1)
        """the first row that has not crossed, -1 for that of the step to come"""
        self.complete = True
        """no link has rows to make up for"""
        self.forgotten = 0
        """rows that were no longer kept when their link came up again"""
        nothing: Index = np.zeros(len(graph.node), dtype=np.int64)
        self.whole = Deliveries(np.ones(len(graph.node), dtype=bool), nothing, nothing)
        """Every link brings the row of its step."""

    def plan(self, t: int, down: Mask, late: Index | None) -> Deliveries:
        """Return the rows that cross at step t, given the links that are down and the delays of late links."""
        nothing = self.whole.late
        if not self._history:  # nothing is made up for, and what is late comes too late
            return Deliveries(~down & (late == 0) if late is not None else ~down, nothing, nothing)
        late = nothing if late is None else late
        first = np.where(self._lacks < 0, t, self._lacks)
        kept = np.maximum(first, t - self._history + 1)
        some = ~down & (kept <= t - late)
        back = np.where(some, np.maximum(t - late - kept, 0), 0)
        return Deliveries(some, np.where(some, late, 0), back)

    def commit(self, t: int, deliveries: Deliveries) -> None:
        """It has crossed."""
        if not self._history or (deliveries is self.whole and self.complete):
            return
        first = np.where(self._lacks < 0, t, self._lacks)
        self.forgotten += int(np.maximum(t - self._history + 1 - first, 0)[deliveries.some].sum())
        after = np.where(deliveries.some, t + 1 - deliveries.late, first)
        self._lacks = np.where(after > t, -1, after)
        self.complete = bool((self._lacks < 0).all())

    def forget(self, nodes: Mask) -> None:
        """These nodes lost their memory: every row must come to them again."""
        if self._history:
            self._lacks[nodes[self._graph.node]] = 0
            self.complete = False
