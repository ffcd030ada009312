"""The timeline of failures: one lane per link and node, from telemetry alone, planned or not.

A lane begins with the first failure in it. Lanes of an edge show its lost messages and cuts. Lanes of a node show its
absence, its missing inputs, and jumps of its a. A wrong estimate is no failure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.fault_accounts import at_ends
from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.orchestrator.views import palette
from hedgerow.orchestrator.views.palette import Color
from hedgerow.topologies.schema import Topology

LANES = 24
"""the maximum number of links and nodes with a lane"""
RUN = -1
"""the number of the lane of the whole run"""
FINE: Color = (38, 44, 54, 255)
NOT_I, NOT_J, CLOSED = 1, 2, 4
"""the states of an edge (i, j), as sums of these numbers; 0 is no failure"""
THERE, TURNED, NO_INPUT, GONE = range(4)
"""the states of a node; the worst one counts"""
OF_NODE: Sequence[tuple[str, Color]] = (
    ("ok", FINE),
    ("a jumps", (250, 250, 120, 255)),
    ("no input", palette.NO_INPUT),
    ("dead", palette.DEAD),
)


def of_edge(i: str, j: str) -> Sequence[tuple[str, Color]]:
    """Return the texts and colours for the states of the edge (i, j), by their codes."""
    one, other, both = f"lost {j}→{i}", f"lost {i}→{j}", "lost both"
    return (
        ("ok", FINE),
        *((what, palette.LOST) for what in (one, other, both)),
        ("cut", palette.CUT),
        *(("cut, lost", palette.BOTH),) * 3,
    )


@dataclass(frozen=True)
class Lane:
    """A row of the timeline."""

    entity: str
    states: Sequence[tuple[str, Color]]

    def log_static(self, stream: rr.RecordingStream) -> None:
        """Send the texts and colours of the states."""
        states = dict(self.states)
        values, colors = [*states], [*states.values()]
        stream.log(self.entity, rr.StateConfiguration(values=values, colors=colors), static=True)


@dataclass(frozen=True)
class Changes:
    """The steps when a lane changes its state, with the new states."""

    states: Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64], list[str]]]
    begun: Sequence[Lane] = ()
    """the new lanes"""

    def write(self, stream: rr.RecordingStream) -> None:
        """Send the changes."""
        for lane in self.begun:
            lane.log_static(stream)
        for entity, (t, wall, texts) in self.states.items():
            index = [rr.TimeColumn("step", sequence=t), rr.TimeColumn("wall", timestamp=wall)]
            stream.send_columns(entity, index, rr.StateChange.columns(state=texts))

    @property
    def size(self) -> int:
        """Return the approximate size [bytes]."""
        return sum(40 * len(t) for t, _, _ in self.states.values())

    @staticmethod
    def joined(parts: Sequence[Changes]) -> Changes:
        """Return the parts as one."""
        found: dict[str, tuple[NDArray[np.int64], NDArray[np.float64], list[str]]] = {}
        for entity in dict.fromkeys(entity for part in parts for entity in part.states):
            own = [part.states[entity] for part in parts if entity in part.states]
            t, wall = (np.concatenate([one[k] for one in own]) for k in (0, 1))
            found[entity] = t, wall, [what for one in own for what in one[2]]
        return Changes(found, [lane for part in parts for lane in part.begun])


LANE_ENTITIES = ("/agent/**", "/link/**", "/run")
"""the lanes; Rerun orders them by name, so agents come first; Rerun shows the path of an entity as its title"""


def _entity(kind: str, name: str) -> str:
    """Return the path of a lane, without the escapes that blanks would need in its title."""
    return f"{kind}/{rr.escape_entity_path_part(name.replace(' ', '_'))}"


class FaultTimeline:
    """The lanes of failures, and their changes from step to step."""

    def __init__(self, topology: Topology) -> None:
        self._ids, self._edges = topology.ids, topology.graph.edges
        self._ends = at_ends(topology.graph)
        self._before = np.zeros(len(self._edges) + len(self._ids), dtype=np.uint8)
        self._a: NDArray[np.float64] | None = None
        self.begun: dict[int, Lane] = {}

    def _lane(self, k: int) -> Lane:
        if k >= len(self._edges):
            return Lane(_entity("agent", str(self._ids[k - len(self._edges)])), OF_NODE)
        i, j = (str(self._ids[end]) for end in self._edges[k].tolist())
        return Lane(_entity("link", f"{i}-{j}"), of_edge(i, j))

    def codes(self, batch: Batch) -> NDArray[np.uint8]:
        """Return the state of each lane at each step, (B, E + n)."""
        if len(self._ends):
            lost = ~batch.link_up[:, self._ends]
            links = NOT_I * lost[:, :, 0] + NOT_J * lost[:, :, 1] + CLOSED * ~batch.edge_open
        else:
            links = np.zeros((len(batch.t), 0))
        before = batch.a[:1] if self._a is None else self._a[None]
        turned = batch.a != np.concatenate([before, batch.a[:-1]])
        self._a = batch.a[-1].copy()
        nodes = np.where(turned, TURNED, THERE)
        nodes = np.select([batch.dead, batch.missing], [GONE, NO_INPUT], nodes)
        return np.concatenate([links, nodes], axis=1).astype(np.uint8)

    def changes(self, batch: Batch, wall: NDArray[np.float64]) -> Changes:
        """Return the changes in this batch."""
        codes = self.codes(batch)
        changed = codes != np.concatenate([self._before[None], codes[:-1]])
        self._before = codes[-1].copy()
        new, found = [], {}
        if RUN not in self.begun:  # for an empty timeline, Rerun would suggest to add a lane
            self.begun[RUN] = Lane("run", (("steps", FINE),))
            new.append(self.begun[RUN])
            found["run"] = batch.t[:1], wall[:1], ["steps"]
        for k in changed.any(axis=0).nonzero()[0].tolist():
            if k not in self.begun:
                if len(self.begun) > LANES:
                    continue
                self.begun[k] = self._lane(k)
                new.append(self.begun[k])
            rows, lane = changed[:, k].nonzero()[0], self.begun[k]
            found[lane.entity] = batch.t[rows], wall[rows], [lane.states[code][0] for code in codes[rows, k].tolist()]
        return Changes(found, new)
