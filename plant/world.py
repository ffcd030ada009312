"""The dynamics (1): x_i(t+1) = a_i x_i(t) + b_i sum_j k_ij (u_i(t) - u_j(t)) + w_i(t), over the edges that are open.

It includes the faults. A step has two halves. `begin` decides what holds at t, and `states` gives the messages to the
shards. `step` uses their inputs and advances. A missing input, for any reason, closes all edges of its node at that
step, at both ends. So no old value is held, and no flow is one-sided (docs/theory.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from typing import NamedTuple

import numpy as np

from hedgerow.plant.disturbance import Disturbance
from hedgerow.plant.faults import ActiveFaults, Faults
from hedgerow.plant.link_states import LinkStates, Places
from hedgerow.plant.links import Deliveries, Forecast, Links
from hedgerow.plant.truth import Truth
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.fast import kernels_for, unequal_kernels_for
from hedgerow.topologies.graph import Array, Gain, Graph, Index, Mask, all_finite
from hedgerow.wire.codec import join
from hedgerow.wire.history import History
from hedgerow.wire.message import TAKEN, Buffer, Flag, Flags, Record, State, Telemetry

TOGETHER = 2**12
"""the number of links, over all steps, that are looked at together"""


def dynamics(a: Array, b: Gain, graph: Graph, x: Array, u: Array, w: Array, edge_open: Mask | None = None) -> Array:
    """Return x(t+1) from x(t), u(t), w(t) and the edges open at t (None: all); equation (1)."""
    if edge_open is None and kernels_for(graph.n) is not None:
        if x.ndim == 1:
            return _compiled_dynamics(a, b, graph, x, u, w)
        a, w = np.broadcast_to(a, x.shape), np.broadcast_to(w, x.shape)
        return np.array([dynamics(*one) for one in zip(a, repeat(b), repeat(graph), x, u, w, strict=False)])
    return a * x + b * graph.flow(u, edge_open) + w


def _compiled_dynamics(a: Array, b: Gain, graph: Graph, x: Array, u: Array, w: Array) -> Array:
    """Return the same for one large network with all edges open."""
    if graph.weight is None and isinstance(b, float) and (kernels := kernels_for(graph.n)) is not None:
        return kernels.dynamics(graph.first, graph.neighbour, a, b, x, u, w)  # type: ignore[no-any-return]
    if graph.weight is not None and (kernels := unequal_kernels_for(graph.n)) is not None:
        b = np.full(graph.n, b) if isinstance(b, float) else b
        return kernels.dynamics(graph.first, graph.neighbour, graph.weight, a, b, x, u, w)  # type: ignore[no-any-return]
    return a * x + b * graph.flow(u) + w


@dataclass(frozen=True)
class _Part:
    """A shard: its nodes, and its incidences in the shard's own order."""

    nodes: Index
    incidences: Index


@dataclass(slots=True)
class _Step:
    """The faults and messages of one step."""

    sent: Array
    """x(t) as the agents read it, (n,): NaN if the reading is lost or the node is absent"""
    read: Array
    """the same for absent nodes too; a returning node receives it for the time of its absence"""
    flags: Flags | None = None
    """Flag bits by incidence, (2E,); None if all are set and there is no other message"""
    absent: Mask | None = None
    """None for no node"""
    returning: Mask | None = None
    """nodes that were absent at the step before; None for no node"""
    deliveries: Deliveries | None = None
    """None if every link delivers the row of t alone"""
    cut: Mask | None = None
    mute: Mask | None = None


class _Made(NamedTuple):
    """A finished step: its telemetry as far as the plant knows it, and the data that `account` needs."""

    t: int
    x: Array
    u: Array
    w: Array
    edge_open: Flags | None
    """None if all edges were open"""
    deliveries: Deliveries | None
    """None if every link delivered the row of t alone"""
    gone: Mask | None
    now: _Step | None
    """the faults and messages of the step; None if nothing was missing"""


class _Ahead(NamedTuple):
    """The links of the next steps, if every node acts at them."""

    first: int
    """the first of these steps"""
    faults: Faults
    changes: int
    """the faults, and their number of changes when this was computed"""
    forecast: Forecast
    states: LinkStates

    def holds(self, t: int, faults: Faults) -> bool:
        """Return True if t is one of these steps, and these faults are still the same."""
        same = self.faults is faults and self.changes == faults.changes
        return same and 0 <= t - self.first < len(self.forecast.complete)


class World:
    """The true network in motion: its state x(t), its faults, and the advance to the next step."""

    def __init__(self, truth: Truth) -> None:
        self.graph = graph = Graph(len(truth.ids), truth.edges, truth.weights)
        self.a = truth.a.copy()
        self.b = truth.b
        self.t = 0
        self.x = truth.x0
        self.steps = truth.steps
        self._disturbance = Disturbance(truth.disturbance, truth.ids, truth.seed)
        self._next_w: Array | None = None
        """w(t), if it is already computed"""
        self.fault_count = truth.faults
        """number of faults, including those added during the run"""
        self.faults = Faults((Effect.from_dict(one) for one in truth.effects), graph, truth.ids, truth.seed)
        self.links = Links(graph, truth.history)
        self._record = History(truth.history, graph.n, graph.n, len(graph.edges))
        self.order: Index = np.concatenate(truth.shards)
        """Nodes in the order of the shards."""
        shard_of = np.empty(graph.n, dtype=np.int64)
        shard_of[self.order] = np.repeat(np.arange(len(truth.shards)), [len(nodes) for nodes in truth.shards])
        self._places = Places(graph, shard_of, len(truth.shards))
        self._parts = [
            _Part(nodes, incidences)
            for nodes, incidences in zip(
                truth.shards, np.split(self._places.order, self._places.stops[:-1]), strict=True
            )
        ]
        self._place, self._incidence_place = self.order.argsort(), self._places.order.argsort()
        e = len(graph.edges)
        self._all_open: Flags = np.ones(e, dtype=np.uint8)
        self._all_up: Flags = np.ones(2 * e, dtype=np.uint8)
        self._all_taken: Flags = np.full(2 * e, TAKEN, dtype=np.uint8)
        self._taken_bytes = [bytes([TAKEN]) * len(part.incidences) for part in self._parts]
        self.whole = True
        """True if, at t - 1, all edges were open, all links were up and every input was used"""
        self._open: Flags | None = None
        """edges that carried flow at t - 1, (E,); None for all"""
        self._received: Deliveries | None = None
        """the deliveries at t - 1; None if every link delivered the row of that step alone"""
        self._now = _Step(self.x, self.x)
        self._states: LinkStates | None = None
        """what the shards learn of their links at t; None if nothing is missing"""
        self._ahead: _Ahead | None = None
        """the links of t and later steps; None unless only link messages fail at t"""

    # The first half of a step: what holds at t, and the messages to the shards.

    def begin(self) -> None:
        """Decide which faults, edges and links hold at t."""
        t, faults, links, graph = self.t, self.faults, self.links, self.graph
        if (ahead := self._ahead) is not None and ahead.holds(t, faults):
            self._begin_ahead(ahead)
            return
        before = self._now.absent
        active, gone, soon = None, None, None
        self._ahead = self._states = None
        if not (faults.none_at(t) and faults.none_at(t + 1)):
            for node, a in faults.jumps(t):
                self.a[node] = a
            active, gone, soon = faults.at(t), faults.absent(t), faults.absent(t + 1)
        if active is None and gone is None and soon is None and before is None and links.complete:
            self._now = _Step(self.x, self.x)
            if self._open is not None or self._received is not None:
                self._note_links(None)
            return
        if before is None and (ahead := self._links_ahead()) is not None:
            self._ahead = ahead
            self._begin_ahead(ahead)
            return
        active = active or ActiveFaults()
        down: Mask = np.zeros(len(graph.node), dtype=bool) if gone is None else gone[graph.neighbour]
        if gone is not None:
            if soon is not None:  # a node that returns at t + 1 already receives the messages of t
                down = down | (gone & soon)[graph.node]
            links.forget(gone, t)
        if active.lost is not None:
            down = down | active.lost
        deliveries = links.plan(down, active.late)
        read = self.x if active.blind is None else np.where(active.blind, np.nan, self.x)
        sent = read if gone is None else np.where(gone, np.nan, read)
        returning = before if before is None or gone is None else before & ~gone
        self._now = _Step(sent, read, None, gone, returning, deliveries, active.cut, active.mute)
        self._note_links(deliveries)

    def _note_links(self, deliveries: Deliveries | None) -> None:
        """Compute what the shards learn of their links at t; None if every link delivers the row of t alone."""
        received, sent = (one or self.links.whole for one in (self._received, deliveries))
        self._states = LinkStates(self._places, self._open, received.alone, sent.alone)
        self._now.flags = self._states.flags[0]

    def _links_ahead(self) -> _Ahead | None:
        """Compute the links of t and later steps together; None unless link messages fail at t, and nothing else."""
        faults = self.faults.of_links(self.t, max(1, TOGETHER // max(1, len(self.graph.node))))
        if faults is None:
            return None
        forecast = self.links.forecast(faults)
        sent, received = forecast.deliveries, self._received or self.links.whole
        states = LinkStates(self._places, self._open, sent.one_earlier(received), sent)
        return _Ahead(self.t, self.faults, self.faults.changes, forecast, states)

    def _begin_ahead(self, ahead: _Ahead) -> None:
        k = self.t - ahead.first
        self._states = ahead.states
        deliveries = None if ahead.forecast.whole[k] else ahead.forecast.deliveries.at(k)
        self._now = _Step(self.x, self.x, ahead.states.flags[k], deliveries=deliveries)

    def present(self, p: int) -> bool:
        """Return True if shard p has a node that is present at t."""
        absent = self._now.absent
        return absent is None or not bool(absent[self._parts[p].nodes].all())

    def wanted(self, p: int, t: int) -> bool:
        """Return True if shard p has a node that should be present at step t."""
        absent = self.faults.absent(t)
        return absent is None or not bool(absent[self._parts[p].nodes].all())

    def comes_back(self, p: int) -> bool:
        """Return True if shard p, absent at t, is needed again before the last step."""
        ends = [one.stop for one in self.faults.effects if one.removes_agents]
        return any(self.wanted(p, stop) for stop in ends if self.t < stop < self.steps)

    @property
    def ready_states(self) -> tuple[Array, Sequence[bytes]] | None:
        """Return x(t) in the order of the shards, (n,), and by shard what follows its states in the message.

        None if a node is absent or has no reading, or if the messages are not made yet.
        """
        if self._now.flags is None:
            tails = self._no_tails
        elif self._ahead is not None:
            tails = self._ahead.states.tails(self.t - self._ahead.first)
        else:
            return None
        return self._now.sent if self._in_order else self._now.sent.take(self.order), tails

    @cached_property
    def _no_tails(self) -> Sequence[bytes]:
        return [b""] * len(self._parts)

    def states(self) -> list[tuple[State | None, Record | None]]:
        """Return, by shard, its state of t, None if the shard is absent, and the record of its returning nodes."""
        now, t = self._now, self.t
        x = now.sent if self._in_order else now.sent.take(self.order)
        if now.flags is None:
            return [(State(t, x[own], b""), None) for own in self._slices]
        messages: list[tuple[State | None, Record | None]] = []
        assert self._states is not None, "there are flags"
        parts = self._states.parts(0 if self._ahead is None else t - self._ahead.first)
        for p, (part, (flags, spans)) in enumerate(zip(self._parts, parts, strict=True)):
            if not self.present(p):
                messages.append((None, None))
            else:
                messages.append((State(t, x[self._slices[p]], flags, spans), self._record_of(part)))
        return messages

    @cached_property
    def _slices(self) -> list[slice]:
        """Return, by shard, the slice of its nodes in the order of the shards."""
        stops = np.cumsum([len(part.nodes) for part in self._parts]).tolist()
        return [slice(stop - len(part.nodes), stop) for stop, part in zip(stops, self._parts, strict=True)]

    def _record_of(self, part: _Part) -> Record | None:
        if self._now.returning is None or not (returning := self._now.returning[part.nodes]).any():
            return None
        nodes, record = part.nodes[returning], self._record
        edges = self.graph.edge[part.incidences[np.isin(self.graph.node[part.incidences], nodes)]]
        first = record.first if record.next else self.t
        x, u = record.x(first, self.t)[:, nodes], record.u(first, self.t)[:, nodes]
        return Record(self.t, returning, first, x.copy(), u.copy(), record.bits(first, self.t)[:, edges].copy())

    def look_ahead(self) -> None:
        """Compute w(t), and the links of t + 1 if they are known, while the plant waits for the inputs of t."""
        self._next_w = self._w()
        self.faults.at(self.t + 1)  # the faults of many steps are computed together
        if (ahead := self._ahead) is not None and ahead.holds(self.t + 1, self.faults):
            ahead.states.tails(self.t + 1 - ahead.first)

    def _w(self) -> Array:
        if self._disturbance.sees_state:
            return self._disturbance.at(self.t, self.x, self.a)
        return self._disturbance.at(self.t)

    # The second half: the inputs, and the advance to t + 1.

    def step(self, u: Array, report: Array, used: Sequence[Buffer]) -> Telemetry:
        """Advance from t to t + 1 under u(t), NaN where an input is missing; return the telemetry of t."""
        self.advance(u)
        return self.account(report, used)

    def advance(self, u: Array) -> None:
        """Advance from t to t + 1 under u(t), (n,), in the order of the shards; `account` for t after that."""
        now, graph, x, t = self._now, self.graph, self.x, self.t
        if not self._in_order:
            u = u.take(self._place)
        gone = self.faults.absent(t)
        edge_open, deliveries = None, now.deliveries
        everybody = gone is None and all_finite(u)
        quiet = now.flags is None and everybody
        if self._ahead is not None and everybody:
            self.links.follow(self._ahead.forecast, t - self._ahead.first)
        else:
            self._ahead = None
            if not quiet:
                u, edge_open, deliveries = self._what_acts(u, gone)
            self.links.commit(deliveries)
        w = self._w() if self._next_w is None else self._next_w
        self._next_w = None
        self.x = dynamics(self.a, self.b, graph, x, u, w, None if edge_open is None else edge_open.view(np.bool_))
        self._record.append(now.read, u, self._all_open if edge_open is None else edge_open)
        self._open, self._received = edge_open, deliveries
        self._made = _Made(t, x, u, w, edge_open, deliveries, gone, None if quiet else now)
        self.t += 1

    def account(self, report: Array, used: Sequence[Buffer]) -> Telemetry:
        """Return the telemetry of the step that `advance` made last, even if the next one has begun.

        report (REPORT_ROWS, n) and, by shard, the Flag bits of the used inputs are in the order of the shards.
        """
        t, x, u, w, edge_open, deliveries, gone, now = self._made
        if not self._in_order:
            report = report.take(self._place, axis=1)
        taken, up = self._taken(used), None
        if now is None and taken is None:
            self.whole = True
            return Telemetry(t, x, u, w, report, self._all_open, self._all_up, self._all_taken)
        if now is not None:
            report, taken, up = self._what_is_reported(report, taken, deliveries, gone, now)
        self.whole = edge_open is None and up is None and taken is None
        edge_open = self._all_open if edge_open is None else edge_open
        up, taken = self._all_up if up is None else up, self._all_taken if taken is None else taken
        return Telemetry(t, x, u, w, report, edge_open, up, taken)

    def _what_acts(self, u: Array, gone: Mask | None) -> tuple[Array, Flags | None, Deliveries | None]:
        """Return the inputs, the open edges and the deliveries of a step with something missing."""
        now, graph = self._now, self.graph
        edge_open: Flags | None = None
        deliveries = now.deliveries
        if now.cut is None and now.mute is None and gone is None and all_finite(u):
            return u, edge_open, deliveries
        missing = ~np.isfinite(u)
        if now.mute is not None:
            missing |= now.mute
        if gone is not None:
            missing |= gone
        if now.cut is not None or missing.any():
            u = np.where(missing, np.nan, u)
            closed = missing[graph.edges].any(axis=1)
            if now.cut is not None:
                closed |= now.cut
            if closed.any():
                edge_open = np.where(closed, np.uint8(0), np.uint8(1))
        if gone is not None:
            deliveries = deliveries or self.links.whole
            died = gone if now.absent is None else gone & ~now.absent  # ended since the step began
            some = deliveries.some & ~gone[graph.neighbour] & ~died[graph.node]
            deliveries = Deliveries(some, np.where(some, deliveries.late, 0), np.where(some, deliveries.back, 0))
        return u, edge_open, deliveries

    def _what_is_reported(
        self, report: Array, taken: Flags | None, deliveries: Deliveries | None, gone: Mask | None, now: _Step
    ) -> tuple[Array, Flags | None, Flags | None]:
        """Return the reports, the used inputs and the links that are up, in a step with something missing.

        None for all.
        """
        node, bits = self.graph.node, self._all_taken if taken is None else taken
        up = None if deliveries is None else deliveries.fresh
        if gone is not None:
            report = np.where(gone, np.nan, report)
            taken = bits = np.where(gone[node], np.uint8(0), bits)
            up = None if up is None else up & ~gone[node]
        if now.returning is not None and now.returning.any():
            # Messages from before their return are back-filled, not received in time.
            taken = np.where(now.returning[node], bits & np.uint8(~Flag.RECEIVE & 0xFF), bits)
        return report, taken, None if up is None else up.view(np.uint8)

    @cached_property
    def _in_order(self) -> bool:
        """Return True if the shards, one after another, hold the nodes in network order."""
        return bool((self.order[1:] > self.order[:-1]).all())

    def _taken(self, used: Sequence[Buffer]) -> Flags | None:
        """Return the Flag bits of the used inputs in the order of the incidences, (2E,); None if all are set."""
        if not any(used):
            return None
        parts = (bits or everything for bits, everything in zip(used, self._taken_bytes, strict=True))
        taken = np.frombuffer(join(parts), np.uint8)
        return taken if self._in_order else taken.take(self._incidence_place)
