"""What became of every fault: an account each, kept from telemetry and from what the faults were to do.

An *instance* of a fault is one target at one step. It *fired* if it took effect, and was *masked* if there was
nothing to lose. It was *seen* if the process that must miss something reports it:

    kind         fired                    masked                            seen
    drop, delay  the row did not cross    no sender, or nobody to listen    the receiver lacks it
    cut          the edge is closed                                         both its ends say so
    sensor       no input came            nobody there                      the node sent no input
    actuator     no input came            nobody there, or no reading       both ends of all its edges say so
    crash        no input came            nobody there the step before      nobody reports
    jump         (1) holds under it                                         nobody can see it

What was taken in of a step is told with the next one, so that a step is judged when that is here.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hedgerow.orchestrator.metrics.checks import Worst
from hedgerow.orchestrator.metrics.fault_schedule import Instances, Schedule
from hedgerow.topologies.graph import Graph, Index, Mask
from hedgerow.wire.codec import TAKEN, Flag, Flags

_OPEN, _HEAR, _TAKEN = np.uint8(Flag.OPEN), np.uint8(Flag.HEAR), np.uint8(TAKEN)


class Told(NamedTuple):
    """What B rows of telemetry tell of inputs, edges and links."""

    t: Index
    missing: Mask
    """no input came, (B, n)"""
    silent: Mask
    """no report either, (B, n)"""
    edge_open: Mask
    link_up: Mask
    took: Flags
    """Flag bits of what was taken in of the step before, (B, 2E)"""

    def rows(self, some: slice) -> Told:
        """Some of them."""
        return Told(*(getattr(self, name)[some] for name in self._fields))

    def then(self, later: Told) -> Told:
        """These, and later ones."""
        return Told(*(np.concatenate([getattr(one, name) for one in (self, later)]) for name in self._fields))

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return bool(self.edge_open.all() and self.link_up.all()) and not self.missing.any()


class Judged(NamedTuple):
    """The outcome of K instances, one mask per question; `visible` is True if the process that sees it has reported."""

    fired: Mask
    masked: Mask
    visible: Mask
    seen: Mask


class Account(NamedTuple):
    """How often a fault was to strike at the steps that were judged, and what became of that."""

    scheduled: int
    fired: int
    masked: int
    visible: int
    seen: int


def at_ends(graph: Graph) -> Index:
    """Per edge (i, j): the incidence at i, on which i hears j, and the one at j, (E, 2)."""
    ends = np.empty_like(graph.edges)
    ends[graph.edge, (graph.node != graph.edges[graph.edge, 0]).astype(np.int64)] = np.arange(len(graph.node))
    return ends


class Accounts:
    """The accounts of all faults of a run, and of what went missing."""

    def __init__(self, graph: Graph, schedule: Schedule) -> None:
        self._graph, self._schedule = graph, schedule
        self._counts = np.zeros((len(Account._fields), schedule.faults), dtype=np.int64)
        self._held: Told | None = None
        """the last row, which is not judged yet"""
        self._ends = at_ends(graph)
        self.missing_inputs = 0
        """(node, step) without an input"""
        self.lost_messages = 0
        """(link, step) whose row did not cross in its step"""
        self.checks = {"missing_inputs": Worst(), "links": Worst(), "faults": Worst()}

    def __iter__(self) -> Iterator[Account]:
        return (Account(*counts) for counts in self._counts.T.tolist())

    def change(self, schedule: Schedule) -> None:
        """The faults are these from now on; the accounts of those there were go on."""
        self._schedule = schedule
        self._counts = np.pad(self._counts, ((0, 0), (0, schedule.faults - self._counts.shape[1])))

    def take(self, told: Told) -> None:
        """Take in the next rows, one or more."""
        flows: Mask = np.zeros(len(told.t), dtype=np.bool_)
        if told.missing.any():
            self.missing_inputs += int(told.missing.sum())
            flows = _any(told.edge_open & _at_an_end(told.missing, self._graph))
        self.lost_messages += int(told.link_up.size - np.count_nonzero(told.link_up))
        self.checks["missing_inputs"].see_exact(~flows, told.t)
        told = told if self._held is None else self._held.then(told)
        self._held = told.rows(slice(-1, None))
        if len(told.t) > 1:
            self._judge(told.rows(slice(-1)), told.took[1:], np.diff(told.t) == 1)

    def finish(self) -> None:
        """No more rows come: of the last, nobody tells what was taken in."""
        if self._held is not None:
            self._judge(self._held, self._held.took, np.zeros(1, dtype=np.bool_))
            self._held = None

    def _judge(self, told: Told, took: Flags, followed: Mask) -> None:
        """Judge P steps by what was taken in of them, (P, 2E); nobody knows where the row after is lost."""
        links, faults = self.checks["links"], self.checks["faults"]
        first, last = int(told.t[0]), int(told.t[-1])
        if told.whole and not self._schedule.between(first, last + 2) and (took[followed] == TAKEN).all():
            links.see_exact(followed[followed], told.t[followed])
            faults.see_exact(np.ones(len(told.t), dtype=np.bool_), told.t)
            return
        judgement = _Judgement(self._graph, self._schedule, self._ends, told, took, followed)
        links.see_exact(judgement.agreed()[followed], told.t[followed])
        faults.see_exact(~judgement.wrong(self._counts), told.t)


class _Judgement:
    """Some steps, what the faults were to do in them, and what was taken in of them."""

    def __init__(self, graph: Graph, schedule: Schedule, ends: Index, told: Told, took: Flags, followed: Mask) -> None:
        self._graph, self._schedule, self._ends, self._told, self._took = graph, schedule, ends, told, took
        self._absent = schedule.absent(told.t)
        after = schedule.absent(told.t + 1)
        self._tells = followed[:, None] & ~after[:, graph.node]
        """per incidence: whether its node tells what it took in, (P, 2E)"""
        self._crosses = ~(self._absent[:, graph.neighbour] | self._absent[:, graph.node])
        """whether there is a sender, and somebody to listen, (P, 2E)"""
        self._lacks_hear, self._lacks_open = took & _HEAR == 0, took & _OPEN == 0

    def agreed(self) -> Mask:
        """Whether all who tell took in what the plant says was open and crossed, (P,)."""
        expected = self._told.edge_open[:, self._graph.edge] * _OPEN | self._told.link_up * _HEAR
        return ~_any((expected != self._took & _TAKEN) & self._tells)

    def wrong(self, counts: Index) -> Mask:
        """Whether a fault did not do what it should or something else happened, (P,); `counts` go on."""
        told, graph = self._told, self._graph
        links = self._scheduled("drop", "delay")
        cuts, sensors = self._scheduled("cut"), self._scheduled("sensor")
        actuators, crashes, jumps = (self._scheduled(kind) for kind in ("actuator", "crash", "jump"))
        blind, struck = self._absent.copy(), self._absent.copy()
        lost, closed = ~self._crosses, _at_an_end(told.missing, graph)
        blind[sensors.row, sensors.target] = True
        struck[sensors.row, sensors.target] = struck[actuators.row, actuators.target] = True
        lost[links.row, links.target] = True
        closed[cuts.row, cuts.target] = True

        wrong = _any(~told.link_up & ~lost) | _any(~told.edge_open & ~closed)
        wrong |= _any(told.missing & ~struck) | _any(self._absent & ~told.silent)
        for found, judged in (
            (links, self._links(links)),
            (cuts, self._cuts(cuts)),
            (sensors, self._silenced(sensors, self._absent, told.missing)),
            (actuators, self._actuators(actuators, blind)),
            (crashes, self._silenced(crashes, self._schedule.absent(told.t - 1), told.silent)),
            (jumps, _unseen(len(jumps.row))),
        ):
            if not len(found.row):
                continue
            scheduled = np.ones(len(found.row), dtype=np.bool_)
            for k, mask in enumerate((scheduled, *judged)):
                counts[k] += np.bincount(found.fault[mask], minlength=counts.shape[1])
            wrong[found.row[~(judged.fired | judged.masked) | (judged.visible & ~judged.seen)]] = True
        return wrong

    def _scheduled(self, *kinds: str) -> Instances:
        return self._schedule.instances(self._told.t, *kinds)

    def _links(self, found: Instances) -> Judged:
        at = found.row, found.target
        masked = ~self._crosses[at]
        fired = ~masked & ~self._told.link_up[at]
        visible = fired & self._tells[at]
        return Judged(fired, masked, visible, visible & self._lacks_hear[at])

    def _cuts(self, found: Instances) -> Judged:
        fired = ~self._told.edge_open[found.row, found.target]
        ends = found.row[:, None], self._ends[found.target]
        visible = fired & _any(self._tells[ends])
        seen = visible & ~_any(self._tells[ends] & ~self._lacks_open[ends])
        return Judged(fired, np.zeros_like(fired), visible, seen)

    def _silenced(self, found: Instances, nobody: Mask, says_nothing: Mask) -> Judged:
        """Of sensors and crashes: the node itself sends no input."""
        at = found.row, found.target
        masked = nobody[at]
        fired = ~masked & self._told.missing[at]
        return Judged(fired, masked, fired, fired & says_nothing[at])

    def _actuators(self, found: Instances, nothing: Mask) -> Judged:
        at = found.row, found.target
        masked = nothing[at]
        fired = ~masked & self._told.missing[at]
        tells = self._tells | self._tells[:, self._graph.reverse]
        says_open = self._tells & ~self._lacks_open
        says_open |= says_open[:, self._graph.reverse]
        visible = fired & self._at_node(tells)[at]
        return Judged(fired, masked, visible, visible & ~self._at_node(says_open)[at])

    def _at_node(self, incidences: Mask) -> Mask:
        """Whether any incidence of each node is marked, (P, n)."""
        rows, n = len(incidences), self._graph.n
        place = self._graph.node + n * np.arange(rows)[:, None]
        return np.bincount(place[incidences], minlength=rows * n).reshape(rows, n) > 0


def _any(marked: Mask) -> Mask:
    """Whether anything is marked in each row."""
    return np.asarray(marked.any(axis=1))


def _at_an_end(nodes: Mask, graph: Graph) -> Mask:
    """Whether a node at either end of each edge is marked, (P, E)."""
    return nodes[:, graph.edges[:, 0]] | nodes[:, graph.edges[:, 1]]


def _unseen(jumps: int) -> Judged:
    nobody = np.zeros(jumps, dtype=np.bool_)
    return Judged(~nobody, nobody, nobody, nobody)
