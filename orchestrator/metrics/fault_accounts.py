"""The accounts of faults: how often each fault was scheduled, took effect and was observed.

The accounts compare the telemetry with the schedule of the faults. An *instance* of a fault is one target at one step.
It *fired* if it took effect. It was *masked* if there was nothing to lose. It was *seen* if the process that lacks
something reports so. The table gives the evidence of each kind:

    kind         fired                    masked                            seen
    drop, delay  the row did not cross    no sender, or no receiver          the receiver lacks it
    cut          the edge is closed                                         both its ends report it
    sensor       no input came            agent absent                      the node sent no input
    actuator     no input came            agent absent, or no reading       both ends of all its edges report it
    crash        no input came            agent absent the step before      no report arrives
    jump         (1) holds under it                                         not visible

Telemetry reports in each row the inputs that the agents used one step earlier. So a step is judged when the next row
has arrived.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hedgerow.orchestrator.metrics.checks import Worst
from hedgerow.orchestrator.metrics.fault_schedule import Instances, Schedule
from hedgerow.topologies.graph import Array, Graph, Index, Mask
from hedgerow.wire.message import TAKEN, Flag, Flags

_OPEN, _RECEIVE, _TAKEN = np.uint8(Flag.OPEN), np.uint8(Flag.RECEIVE), np.uint8(TAKEN)


def absent(missing: Mask, report: Array) -> Mask:
    """Return True where a missing input came without a report, (B, n): the agent was absent. `report` is (B, 2, n)."""
    return missing & np.isnan(report).all(axis=1) if missing.any() else missing


class Observed(NamedTuple):
    """The inputs, edges and links in B rows of telemetry."""

    t: Index
    missing: Mask
    """True if no input arrived, (B, n)"""
    silent: Mask
    """True if no report arrived either, (B, n)"""
    edge_open: Mask
    link_up: Mask
    used: Flags
    """Flag bits of the inputs of the step before that were used, (B, 2E)"""

    def rows(self, some: slice) -> Observed:
        """Return some of the rows."""
        return Observed(*(getattr(self, name)[some] for name in self._fields))

    def then(self, later: Observed) -> Observed:
        """Return these rows, followed by later ones."""
        return Observed(*(np.concatenate([getattr(one, name) for one in (self, later)]) for name in self._fields))

    @property
    def whole(self) -> bool:
        """Return True if nothing is missing."""
        return bool(self.edge_open.all() and self.link_up.all()) and not self.missing.any()


class Judged(NamedTuple):
    """The outcome of K instances, one mask per question.

    `visible` is True if the process that would see the effect has reported.
    """

    fired: Mask
    masked: Mask
    visible: Mask
    seen: Mask


class Account(NamedTuple):
    """The counts of a fault at the judged steps: how often it was scheduled, and the outcomes."""

    scheduled: int
    fired: int
    masked: int
    visible: int
    seen: int


def at_ends(graph: Graph) -> Index:
    """Return, per edge (i, j), the incidence where i receives from j, and the one at j, (E, 2)."""
    ends = np.empty_like(graph.edges)
    ends[graph.edge, (graph.node != graph.edges[graph.edge, 0]).astype(np.int64)] = np.arange(len(graph.node))
    return ends


class FaultAccounts:
    """The accounts of all faults of a run, and the counts of missing inputs and messages."""

    def __init__(self, graph: Graph, schedule: Schedule) -> None:
        self._graph, self._schedule = graph, schedule
        self._counts = np.zeros((len(Account._fields), schedule.faults), dtype=np.int64)
        self._held: Observed | None = None
        """the last row, which is not judged yet"""
        self._ends = at_ends(graph)
        self.missing_inputs = 0
        """the number of (node, step) without an input"""
        self.lost_messages = 0
        """the number of (link, step) with a row that was not delivered in its step"""
        self.checks = {"missing_inputs": Worst(), "links": Worst(), "faults": Worst()}

    def __iter__(self) -> Iterator[Account]:
        return (Account(*counts) for counts in self._counts.T.tolist())

    def change(self, schedule: Schedule) -> None:
        """Change the faults from now on; the accounts of earlier faults continue."""
        self._schedule = schedule
        self._counts = np.pad(self._counts, ((0, 0), (0, schedule.faults - self._counts.shape[1])))

    def take(self, observed: Observed) -> None:
        """Record the next rows, one or more."""
        flows: Mask = np.zeros(len(observed.t), dtype=np.bool_)
        if observed.missing.any():
            self.missing_inputs += int(observed.missing.sum())
            flows = _any(observed.edge_open & _at_an_end(observed.missing, self._graph))
        self.lost_messages += int(observed.link_up.size - np.count_nonzero(observed.link_up))
        self.checks["missing_inputs"].see_exact(~flows, observed.t)
        observed = observed if self._held is None else self._held.then(observed)
        self._held = observed.rows(slice(-1, None))
        if len(observed.t) > 1:
            self._judge(observed.rows(slice(-1)), observed.used[1:], np.diff(observed.t) == 1)

    def finish(self) -> None:
        """Judge the last row, without a report on its used inputs."""
        if self._held is not None:
            self._judge(self._held, self._held.used, np.zeros(1, dtype=np.bool_))
            self._held = None

    def _judge(self, observed: Observed, used: Flags, followed: Mask) -> None:
        """Judge P steps by their used inputs, (P, 2E); these are unknown if the next row is lost."""
        links, faults = self.checks["links"], self.checks["faults"]
        first, last = int(observed.t[0]), int(observed.t[-1])
        if observed.whole and not self._schedule.between(first, last + 2) and (used[followed] == TAKEN).all():
            links.see_exact(followed[followed], observed.t[followed])
            faults.see_exact(np.ones(len(observed.t), dtype=np.bool_), observed.t)
            return
        judgement = _Judgement(self._graph, self._schedule, self._ends, observed, used, followed)
        links.see_exact(judgement.agreed()[followed], observed.t[followed])
        faults.see_exact(~judgement.wrong(self._counts), observed.t)


class _Judgement:
    """The judgement of some steps: the scheduled faults, and the used inputs."""

    def __init__(
        self, graph: Graph, schedule: Schedule, ends: Index, observed: Observed, used: Flags, followed: Mask
    ) -> None:
        self._graph, self._schedule, self._ends, self._observed, self._took = graph, schedule, ends, observed, used
        self._absent = schedule.absent(observed.t)
        after = schedule.absent(observed.t + 1)
        self._tells = followed[:, None] & ~after[:, graph.node]
        """per incidence: True if its node reports its used inputs, (P, 2E)"""
        self._crosses = ~(self._absent[:, graph.neighbour] | self._absent[:, graph.node])
        """per incidence: True if both the sender and the receiver are present, (P, 2E)"""
        self._lacks_receive, self._lacks_open = used & _RECEIVE == 0, used & _OPEN == 0

    def agreed(self) -> Mask:
        """Return True for steps in which all reporting nodes used what the plant reports as open and delivered,
        (P,).
        """
        expected = self._observed.edge_open[:, self._graph.edge] * _OPEN | self._observed.link_up * _RECEIVE
        return ~_any((expected != self._took & _TAKEN) & self._tells)

    def wrong(self, counts: Index) -> Mask:
        """Return True for steps in which a fault had no effect or something else failed, (P,); update `counts`."""
        observed, graph = self._observed, self._graph
        links = self._scheduled("lost", "late")
        cuts, sensors = self._scheduled("cut"), self._scheduled("blind")
        actuators, crashes, jumps = (self._scheduled(one) for one in ("mute", "absent", "truth"))
        blind, struck = self._absent.copy(), self._absent.copy()
        lost, closed = ~self._crosses, _at_an_end(observed.missing, graph)
        blind[sensors.row, sensors.target] = True
        struck[sensors.row, sensors.target] = struck[actuators.row, actuators.target] = True
        lost[links.row, links.target] = True
        closed[cuts.row, cuts.target] = True

        wrong = _any(~observed.link_up & ~lost) | _any(~observed.edge_open & ~closed)
        wrong |= _any(observed.missing & ~struck) | _any(self._absent & ~observed.silent)
        for found, judged in (
            (links, self._links(links)),
            (cuts, self._cuts(cuts)),
            (sensors, self._silenced(sensors, self._absent, observed.missing)),
            (actuators, self._actuators(actuators, blind)),
            (crashes, self._silenced(crashes, self._schedule.absent(observed.t - 1), observed.silent)),
            (jumps, _unseen(len(jumps.row))),
        ):
            if not len(found.row):
                continue
            scheduled = np.ones(len(found.row), dtype=np.bool_)
            for k, mask in enumerate((scheduled, *judged)):
                counts[k] += np.bincount(found.fault[mask], minlength=counts.shape[1])
            wrong[found.row[~(judged.fired | judged.masked) | (judged.visible & ~judged.seen)]] = True
        return wrong

    def _scheduled(self, *struck: str) -> Instances:
        return self._schedule.instances(self._observed.t, *struck)

    def _links(self, found: Instances) -> Judged:
        at = found.row, found.target
        masked = ~self._crosses[at]
        fired = ~masked & ~self._observed.link_up[at]
        visible = fired & self._tells[at]
        return Judged(fired, masked, visible, visible & self._lacks_receive[at])

    def _cuts(self, found: Instances) -> Judged:
        fired = ~self._observed.edge_open[found.row, found.target]
        ends = found.row[:, None], self._ends[found.target]
        visible = fired & _any(self._tells[ends])
        seen = visible & ~_any(self._tells[ends] & ~self._lacks_open[ends])
        return Judged(fired, np.zeros_like(fired), visible, seen)

    def _silenced(self, found: Instances, nobody: Mask, says_nothing: Mask) -> Judged:
        """Judge sensor faults and crashes: the node itself sends no input."""
        at = found.row, found.target
        masked = nobody[at]
        fired = ~masked & self._observed.missing[at]
        return Judged(fired, masked, fired, fired & says_nothing[at])

    def _actuators(self, found: Instances, nothing: Mask) -> Judged:
        at = found.row, found.target
        masked = nothing[at]
        fired = ~masked & self._observed.missing[at]
        tells = self._tells | self._tells[:, self._graph.reverse]
        says_open = self._tells & ~self._lacks_open
        says_open |= says_open[:, self._graph.reverse]
        visible = fired & self._at_node(tells)[at]
        return Judged(fired, masked, visible, visible & ~self._at_node(says_open)[at])

    def _at_node(self, incidences: Mask) -> Mask:
        """Return True for each node with a marked incidence, (P, n)."""
        rows, n = len(incidences), self._graph.n
        place = self._graph.node + n * np.arange(rows)[:, None]
        return np.bincount(place[incidences], minlength=rows * n).reshape(rows, n) > 0


def _any(marked: Mask) -> Mask:
    """Return True for each row with a mark."""
    return np.asarray(marked.any(axis=1))


def _at_an_end(nodes: Mask, graph: Graph) -> Mask:
    """Return True for each edge with a marked node at either end, (P, E)."""
    return nodes[:, graph.edges[:, 0]] | nodes[:, graph.edges[:, 1]]


def _unseen(jumps: int) -> Judged:
    nobody = np.zeros(jumps, dtype=np.bool_)
    return Judged(~nobody, nobody, nobody, nobody)
