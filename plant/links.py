"""The rows of link messages that are delivered at a step, and those that are still missing.

A link is an incidence: node i receives messages from neighbour j over it. In step t, a link that is up delivers the row
of t, and before it all rows that were missing while it was down. A link that is late by k delivers its rows up to t -
k.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hedgerow.plant.faults import LinkFaults
from hedgerow.topologies.graph import Graph, Index, Mask


class Deliveries(NamedTuple):
    """The deliveries of the links at one step, (2E,) each, or at S steps, (S, 2E): True if any row arrives, its delay,
    and the earlier rows with it.

    The newest row is that of t - late; `back` rows arrive before it.
    """

    some: Mask
    late: Index
    back: Index

    @property
    def fresh(self) -> Mask:
        """Return the links that deliver the row of the step itself."""
        return np.asarray(self.some & (self.late == 0))

    @property
    def alone(self) -> Deliveries:
        """Return the deliveries of one step in the shape of several, (1, 2E)."""
        return Deliveries(self.some[None], self.late[None], self.back[None])

    def at(self, k: int) -> Deliveries:
        """Return the deliveries of step k of several."""
        return Deliveries(self.some[k], self.late[k], self.back[k])

    def one_earlier(self, first: Deliveries) -> Deliveries:
        """Return the deliveries of the step before each of these, if those before the first are `first`."""
        return Deliveries(*(np.concatenate([one[None], own[:-1]]) for one, own in zip(first, self, strict=True)))


class Forecast(NamedTuple):
    """The links at some steps from t on, (S, 2E), if every node acts at all of them and only link messages fail."""

    deliveries: Deliveries
    missing: Index
    """the number of missing rows before each step, and after the last one, (S + 1, 2E)"""
    complete: Sequence[bool]
    """by step: True if no row is missing after it"""
    whole: Sequence[bool]
    """by step: True if every link delivers the row of that step alone"""
    forgotten: Sequence[int]
    """by step: the number of rows that came up again and were no longer stored"""


class Links:
    """The number of missing rows of every link, always its newest ones; both ends store at most `history` rows."""

    def __init__(self, graph: Graph, history: int) -> None:
        self._graph, self._history = graph, history
        self._missing: Index = np.zeros(len(graph.node), dtype=np.int64)
        self.complete = True
        """True if no link has missing rows"""
        self.forgotten = 0
        """the number of rows that were no longer stored when their link came up again"""
        nothing: Index = np.zeros(len(graph.node), dtype=np.int64)
        self.whole = Deliveries(np.ones(len(graph.node), dtype=bool), nothing, nothing)
        """The deliveries of a step in which every link delivers the row of that step."""

    def plan(self, down: Mask, late: Index | None) -> Deliveries:
        """Return the rows that cross at this step, given the links that are down and the delays of late links."""
        nothing = self.whole.late
        if not self._history:  # without a history, missing rows stay missing and late rows are dropped
            return Deliveries(~down & (late == 0) if late is not None else ~down, nothing, nothing)
        stored = np.minimum(self._missing, self._history - 1)
        if late is None:
            some = ~down
            return Deliveries(some, nothing, stored * some)
        some = ~down & (late <= stored)
        return Deliveries(some, late * some, (stored - late) * some)

    def forecast(self, faults: LinkFaults) -> Forecast:
        """Return the links of the next S steps under these faults, computed together.

        It ends before the first step in which nothing is missing.
        """
        most_stored, late = max(self._history - 1, 0), faults.late
        down: Mask = faults.lost if late is None else faults.lost | (late > most_stored)
        missing: Index = np.empty((len(down) + 1, down.shape[1]), dtype=np.int64)
        missing[0], steps = self._missing, len(down)
        idle = False
        for k in range(steps):
            before, after = missing[k], missing[k + 1]
            was_idle, idle = idle, not (faults.active[k] or before.any())
            if was_idle and idle:  # this step is quiet
                steps = k
                break
            if late is not None:
                down[k] |= late[k] > before
            np.multiply(before + 1, down[k], out=after)
            if late is not None:
                after += late[k] * ~down[k]
            if not self._history:
                after[:] = 0
        some, missing = ~down[:steps], missing[: steps + 1]
        stored = np.minimum(missing[:-1], most_stored)
        delays = np.zeros_like(stored) if late is None else late[:steps] * some
        back = stored * some - delays
        complete: Mask = ~np.asarray(missing[1:].any(axis=1))
        whole: Mask = np.asarray((some & ((delays | back) == 0)).all(axis=1))
        forgotten: Index = ((missing[:-1] - stored) * some).sum(axis=1)
        return Forecast(Deliveries(some, delays, back), missing, complete.tolist(), whole.tolist(), forgotten.tolist())

    def follow(self, forecast: Forecast, k: int) -> None:
        """Record step k of a forecast as done."""
        if self._history:
            self._missing, self.complete = forecast.missing[k + 1], forecast.complete[k]
            self.forgotten += forecast.forgotten[k]

    def commit(self, deliveries: Deliveries | None) -> None:
        """Record the deliveries of the step as done; None if every link delivers the row of the step alone."""
        if not self._history or (deliveries is None and self.complete):
            return
        deliveries = deliveries or self.whole
        if self._missing.max(initial=0) >= self._history:
            stored = np.minimum(self._missing, self._history - 1)
            self.forgotten += int((self._missing - stored)[deliveries.some].sum())
        self._missing = np.where(deliveries.some, deliveries.late, self._missing + 1)
        self.complete = not self._missing.any()

    def forget(self, nodes: Mask, t: int) -> None:
        """Mark every row of these nodes before step t as missing again, because their agents lost their memory."""
        if self._history:
            self._missing[nodes[self._graph.node]] = t
            self.complete = False
