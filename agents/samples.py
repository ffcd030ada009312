"""Samples learned in the order of their steps, even if their inputs arrive in another order.

A sample of node i at step t is x_i(t), f_i(t) and x_i(t + 1). The law learns each sample when it is closed. It
skips a sample that lacks an input. If that input arrives late, the law returns to an earlier memory and learns all
samples since then again, in the order of the steps. Its memory is then bit for bit the same as without the gap.

A law that asks for its neighbours' states and inputs gets those of the sample's own step. So the states of neighbours
are stored beside their inputs, for such a law alone, and a sample has all of them when it is learned again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hedgerow.agents.law import Array, Law
from hedgerow.agents.local import Received, asks
from hedgerow.topologies.fast import kernels_for, unequal_kernels_for
from hedgerow.topologies.graph import Index, all_finite, starts
from hedgerow.wire.history import History
from hedgerow.wire.message import TAKEN, Flag, Flags, Mask, Record

_OPEN, _RECEIVE = np.uint8(Flag.OPEN), np.uint8(Flag.RECEIVE)
MARK_EVERY = 64
"""steps between copies of the law's memory while a sample is incomplete; this bounds how much is learned again"""


class LateRows(NamedTuple):
    """The rows of steps first .. stop - 1 that arrived over an incidence; samples may have waited for them."""

    incidence: int
    first: int
    stop: int
    inputs: Array | None = None
    """the inputs of the neighbour, (stop - first,); None for one of our own nodes"""
    states: Array | None = None
    """the states of the neighbour, in the same way"""


class _Mark(NamedTuple):
    """A copy of the law's memory before the sample of step t, to return to."""

    t: int
    memory: Array
    of: Mask
    """the nodes for which the copy is valid"""


class Samples:
    """The samples of k nodes. `row` (m,): the node of each incidence; `ends` (2, m): its ends in `width` inputs.

    `weights` (m,): the weight of the edge of each incidence, None if all are 1. At most `most` past steps are kept.
    With 0, no late input is learned.
    """

    def __init__(self, law: Law, most: int, row: Index, ends: Index, width: int, weights: Array | None) -> None:
        self._law, self._row, self._most, self._weights = law, row, most, weights
        self._own, self._other = ends
        self._blank = law.memory.copy()
        self.k, m = self._blank.shape[-1], len(row)
        self.asks = asks(law.learn, "sample")
        """the law learns from its neighbours' states and inputs, so their states are kept too"""
        self._history = History(most, width if self.asks else self.k, width, m)
        self._all = np.full(m, TAKEN, dtype=np.uint8)
        self._behind: set[int] = set()
        """incidences with a wanted row that has not arrived"""
        self._everybody = np.ones(self.k, dtype=bool)
        self._learned: Index = np.full(self.k, -1)
        """by node: no later sample than this step's is in the law's memory; up to date while a sample is incomplete"""
        self._marks: list[_Mark] = []
        """the marks by step, while a sample is incomplete; all are valid for all nodes, except possibly the first mark,
        at the oldest row, which may cover only returned nodes
        """
        self._read_at = -1
        """the step t + 1 of the last sample taken, -1 if a reading of that step is missing"""

    @property
    def complete(self) -> bool:
        """Return True if no sample waits for an input."""
        return not self._marks

    def take(self, t: int, x: Array, u: Array, x_next: Array, states: Array | None = None) -> None:
        """Learn the sample of step t; this and all earlier samples may lack readings of x, but no inputs.

        `states` (width,) are x and the neighbours' states, for a law that asks.
        """
        flow = self._whole_flow(u)
        if self.asks and states is not None:
            self._history.append(states, u, self._all)
            self._learn(x, flow, x_next, self._received(t, self._everybody, states, u, self._all))
            return
        self._history.append(x, u, self._all)
        known, self._read_at = self._read_at == t, t + 1 if all_finite(x_next) else -1
        if known and self._read_at > 0:  # both states are complete, and were checked once each
            self._law.learn(x, flow, x_next)
        else:
            self._learn(x, flow, x_next)

    def append_learned(self, x: Sequence[float], u: Sequence[float]) -> None:
        """Store the row of a step with a sample that is complete and learned: x (k,) and u (width,)."""
        self._history.append(x, u, self._all)
        self._read_at = -1

    @property
    def unlearned(self) -> list[int]:
        """Return the number of steps since the last learned sample, by node; call it while a sample waits."""
        counts: list[int] = (self._history.next - 1 - self._learned).tolist()
        return counts

    def last(self, most: int) -> list[tuple[list[float], list[float], bytes]]:
        """Return the last rows, at most `most`, the newest last: states, inputs, and the Flag bits of those used."""
        history, start, stop = self._history, self._history.next - most, self._history.next
        x, u = history.x(start, stop).tolist(), history.u(start, stop).tolist()
        return list(zip(x, u, map(bytes, history.bits(start, stop)), strict=True))

    def forget_last(self, count: int) -> None:
        """Forget this number of last rows: another owner has them, and all samples that wait."""
        self._history.drop_last(count)
        self._marks.clear()
        self._behind.clear()

    def wait(
        self, rows: Sequence[tuple[tuple[Sequence[float], Sequence[float]], bytes]], counts: Sequence[int]
    ) -> None:
        """Store the rows of steps with samples that wait: states and inputs, and the Flag bits of the inputs used.

        `counts` (k,) are the numbers of samples that wait, by node: its newest ones. The law has learned none of them.
        """
        waits = np.array(counts)
        for (x, u), bits in rows:
            self._history.append(x, u, np.frombuffer(bits, np.uint8))
        after = self._history.next
        for count in sorted(set(counts) - {0}, reverse=True):
            self._marks.append(_Mark(after - count, self._law.memory.copy(), waits == count))
        self._learned = after - 1 - waits
        self._behind = {c for c, bits in enumerate(rows[-1][1]) if bits == _OPEN}

    def take_late(
        self,
        t: int,
        x: Array,
        u: Array,
        used: bytes,
        x_next: Array,
        late_rows: Sequence[LateRows],
        returning: Mask | None,
        states: Array | None = None,
    ) -> None:
        """Learn the sample of t under these Flag bits, after the earlier samples that are now complete.

        `late_rows` are the rows of earlier steps that arrived; `returning` are nodes that learn again from the oldest
        row. `states` are as in `take`.
        """
        row = states if self.asks and states is not None else x
        bits = np.frombuffer(used, np.uint8)
        if not self._marks:
            self._learned.fill(t - 1)
        if self._most:
            if (wants := Flag.OPEN in used) and not (self._marks and self._marks[-1].of.all()):
                self._mark(t)
            self._append(x, row, u, bits)
            since = self._completed(late_rows)
            if returning is not None:
                self._forget(returning)
                since |= dict.fromkeys(np.flatnonzero(returning).tolist(), self._history.first)
            self._learn_again(since, t)
            # A row of t itself closes a gap, because all earlier rows arrive with it.
            self._behind = {c for c in self._behind if not used[c] & Flag.RECEIVE}
            if wants:
                self._behind.update(np.flatnonzero(bits == _OPEN).tolist())
        elif returning is not None:
            self._forget(returning)
        flow = self._flow(u, bits)
        self._learn(x, flow, x_next, self._received(t, self._everybody, row, u, bits))
        self._learned[np.isfinite(flow)] = t
        if not self._behind:
            self._marks.clear()
        elif self._history.next % MARK_EVERY == 0:
            self._mark(self._history.next)

    def _mark(self, t: int) -> None:
        self._marks.append(_Mark(t, self._law.memory.copy(), self._everybody))

    def restore(self, record: Record, anew: bool) -> None:
        """Write the record of nodes that come back into the history; `anew` if the shard has no other history."""
        self._read_at = -1
        if not self._most:
            return
        first, last = record.first, record.t - 1
        if anew:
            self._history.begin_at(first, last)
            self._marks.clear()
            self._behind.clear()
        nodes = np.flatnonzero(record.returning)
        incidences = np.flatnonzero(record.returning[self._row])
        steps = len(self._history.x(first, last))
        past = slice(len(record.x) - 1 - steps, len(record.x) - 1)
        self._history.x(first, last)[:, nodes] = record.x[past]
        self._history.u(first, last)[:, nodes] = record.u[past]
        self._history.bits(first, last)[:, incidences] = record.edge_open[past] * _OPEN
        # Until their rows arrive, these incidences wait for every step at which their edge was open.
        wanted = (record.edge_open[past] != 0).any(axis=0)
        self._behind.difference_update(incidences.tolist())
        self._behind.update(incidences[wanted].tolist())

    def sent(self, start: int, stop: int) -> tuple[Array, Array]:
        """Return the states and inputs of our own nodes at steps start to stop - 1, as far as they are stored, (S, k)
        each.
        """
        return self._history.x(start, stop)[:, : self.k], self._history.u(start, stop)[:, : self.k]

    def _completed(self, late_rows: Sequence[LateRows]) -> dict[int, int]:
        """Write late rows into the history; return, by node, the first step that waited for one of them."""
        history, since = self._history, dict[int, int]()
        for c, first, stop, inputs, states in late_rows:
            bits = history.bits(first, stop)[:, c]
            if inputs is not None:
                history.u(first, stop)[:, self._other[c]] = inputs[len(inputs) - len(bits) :]
            if self.asks and states is not None:
                history.x(first, stop)[:, self._other[c]] = states[len(states) - len(bits) :]
            waited = np.flatnonzero(bits == _OPEN)
            bits |= _RECEIVE
            if len(waited):
                node, step = int(self._row[c]), max(first, history.first) + int(waited[0])
                since[node] = min(step, since.get(node, step))
        return since

    def _append(self, x: Array, row: Array, u: Array, bits: Flags) -> None:
        history = self._history
        if self._marks and history.next - history.first == history.most and self._marks[0].t == history.first:
            self._move_first_mark(x)
        history.append(row, u, bits)

    def _move_first_mark(self, newest: Array) -> None:
        """Advance the first mark by one step, because the oldest row is dropped and its sample can no longer change."""
        t, memory, of = self._marks.pop(0)
        if self._marks and self._marks[0].t == t + 1:
            return
        history = self._history
        now, self._law.memory = self._law.memory, memory
        x_next = np.vstack([history.x(t + 1, t + 2)[:, : self.k], newest])[0]
        x, u, bits = history.x(t, t + 1)[0], history.u(t, t + 1)[0], history.bits(t, t + 1)[0]
        self._learn(x[: self.k], self._flow(u, bits), x_next, self._received(t, self._everybody, x, u, bits))
        self._marks.insert(0, _Mark(t + 1, self._law.memory, of))
        self._law.memory = now

    def _forget(self, nodes: Mask) -> None:
        """Reset the memory of these nodes to blank from the oldest row on."""
        first = self._history.first
        if not self._marks or self._marks[0].t > first:
            self._marks.insert(0, _Mark(first, self._blank.copy(), nodes))
        for k, (t, memory, of) in enumerate(self._marks):
            memory[..., nodes] = self._blank[..., nodes]
            self._marks[k] = _Mark(t, memory, of | nodes)
        memory = self._law.memory.copy()
        memory[..., nodes] = self._blank[..., nodes]
        self._law.memory = memory
        self._learned[nodes] = -1

    def _learn_again(self, since: Mapping[int, int], until: int) -> None:
        """Learn the samples of each node from its step in `since` to `until`, as if none of them had been learned.

        Usually none has been: a link that was down delivers all its rows at once. Otherwise return to the node's last
        valid mark first.
        """
        onward: dict[int, int] = {}
        from_mark: dict[int, list[int]] = {}
        for node, step in sorted(since.items()):
            if self._starts_here(node, step):
                onward[node] = step
            else:
                marks = (k for k, mark in enumerate(self._marks) if mark.t <= step and mark.of[node])
                from_mark.setdefault(max(marks, default=0), []).append(node)
        for k, nodes in from_mark.items():
            start, before, _ = self._marks[k]
            memory = self._law.memory.copy()
            memory[..., nodes] = before[..., nodes]
            self._law.memory = memory
            self._learn_onward(dict.fromkeys(nodes, start), until)
        if onward:
            self._learn_onward(onward, until)

    def _starts_here(self, node: int, step: int) -> bool:
        """Return True if the law's memory of a node is that before the sample of this step."""
        return bool(self._learned[node] < step)

    def _learn_onward(self, since: Mapping[int, int], until: int) -> None:
        """Learn the samples of each node from its step in `since` to `until`; the law's memory is that before them."""
        law, nodes, first = self._law, np.array(list(since)), np.array(list(since.values()))
        start = int(first.min())
        marks = {mark.t: mark.memory for mark in self._marks if mark.t > start}
        x, u, bits = (rows(start, until + 1) for rows in (self._history.x, self._history.u, self._history.bits))
        for step in range(start, until + 1):
            chosen = np.zeros(self.k, dtype=bool)
            chosen[nodes[first <= step]] = True
            if (mark := marks.get(step)) is not None:
                mark[..., chosen] = law.memory[..., chosen]
            if step < until:
                row, inputs, flags = (rows[step - start] for rows in (x, u, bits))
                flow = np.where(chosen, self._flow(inputs, flags), np.nan)
                sample = self._received(step, chosen, row, inputs, flags)
                self._learn(row[: self.k], flow, x[step + 1 - start][: self.k], sample)
                self._learned[np.isfinite(flow)] = step

    def _whole_flow(self, u: Array) -> Array:
        """Return the flow f of one step, (k,), from inputs (width,); no input is missing and all edges are open."""
        if self._weights is None:
            if (kernels := kernels_for(self.k)) is not None:
                return kernels.flow(self._first, self._other, u)  # type: ignore[no-any-return]
            return self._sums(u[self._own] - u[self._other])
        if (kernels := unequal_kernels_for(self.k)) is not None:
            return kernels.flow(self._first, self._other, self._weights, u)  # type: ignore[no-any-return]
        return self._sums(self._weights * (u[self._own] - u[self._other]))

    @cached_property
    def _first(self) -> Index:
        return starts(self._row, self.k)

    def _flow(self, u: Array, bits: Flags) -> Array:
        """Return the flow f of one step, (k,), from inputs (width,) and Flag bits (m,).

        NaN where an input is missing.
        """
        difference = u[self._own] - u[self._other]
        if self._weights is not None:
            difference *= self._weights
        difference[bits & _RECEIVE == 0] = np.nan
        difference[bits & _OPEN == 0] = 0.0
        return self._sums(difference).astype(float, copy=False)  # without incidences, bincount returns integers

    def _sums(self, difference: Array) -> Array:
        flow: Array = np.bincount(self._row, difference, self.k)  # type: ignore[assignment]  # weighted: floats
        return flow

    def _received(self, t: int, nodes: Mask, states: Array, u: Array, bits: Flags) -> Received | None:
        """Return the neighbours' values of step t, by incidence, for a law that asks; otherwise None.

        A sample does not wait for the message over a closed edge. So the sample never has that message. Otherwise its
        values would depend on the arrival of that message before the learning, or the second learning.
        """
        if not self.asks:
            return None
        got = (bits & TAKEN == TAKEN) & np.isfinite(states[self._other] + u[self._other])
        x, inputs = (np.where(got, values[self._other], np.nan) for values in (states, u))
        return Received(t, nodes.copy(), x, inputs, np.where(got, t, -1))

    def _learn(self, x: Array, flow: Array, x_next: Array, sample: Received | None = None) -> None:
        if not all_finite(x + x_next):  # without a reading, the samples before and after it are missing
            flow = np.where(np.isnan(x + x_next), np.nan, flow)
        if sample is None:
            self._law.learn(x, flow, x_next)
        else:
            self._law.learn(x, flow, x_next, sample)  # type: ignore[call-arg]  # it asks by its signature
