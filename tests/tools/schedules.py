"""Random faults of the tests, and their effects on the knowledge of a node, computed in the simplest way."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from hypothesis import strategies as st

from hedgerow.agents.law import Minimax
from hedgerow.plant.faults import Lots
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.faults import effects
from hedgerow.topologies.network import padded
from hedgerow.topologies.schema import Topology
from tests.tools.networks import Trajectory, listed


def windows(steps: int) -> st.SearchStrategy[list[int]]:
    """[from, to), of which some begin or end beyond the run."""
    return st.tuples(st.integers(0, steps), st.integers(1, steps)).map(lambda pair: [pair[0], sum(pair)])


@st.composite
def schedules(draw: st.DrawFn, topology: Topology, most: int = 5) -> list[dict[str, Any]]:
    """Draw some faults of any kinds, as a file spells them."""
    ids, steps = list(topology.ids), topology.steps
    kinds = ["sensor", "actuator", "crash", "jump"]
    if topology.edges:
        kinds += ["drop", "drop one way", "drop table", "delay", "cut", "cut table"]
    if len(ids) > 1:
        kinds.append("partition")
    return [draw(_fault(draw(st.sampled_from(kinds)), topology, ids, steps)) for _ in range(draw(st.integers(0, most)))]


@st.composite
def _fault(draw: st.DrawFn, kind: str, topology: Topology, ids: list[Any], steps: int) -> dict[str, Any]:
    window = {"steps": draw(windows(steps))}
    lot = draw(st.sampled_from([{}, {"probability": 0.3}, {"probability": 0.7}]))
    node = draw(st.sampled_from(ids))
    edge = list(draw(st.sampled_from(topology.pairs))) if topology.edges else []
    if draw(st.booleans()):
        edge.reverse()
    at, models = draw(st.integers(0, steps)), listed(topology)
    table = st.dictionaries(st.integers(0, steps), st.just([edge]), min_size=1, max_size=4)
    again = draw(st.sampled_from([{}, *({"restart_after": r} for r in (1, 2, 5))]))
    groups = draw(st.integers(1, max(1, len(ids) - 1)).map(lambda split: [ids[:split], ids[split:]]))
    one_way = {"from": edge[0], "to": edge[1]} if edge else {}
    faults: dict[str, dict[str, Any]] = {
        "drop": {"kind": "drop", "link": edge, **window, **lot},
        "drop one way": {"kind": "drop", **one_way, **window, **lot},
        "drop table": {"kind": "drop", "at": draw(table)},
        "delay": {"kind": "delay", **one_way, "by": draw(st.integers(1, 4)), **window, **lot},
        "cut": {"kind": "cut", "edge": edge, **window, **lot},
        "cut table": {"kind": "cut", "at": draw(table)},
        "partition": {"kind": "partition", "groups": groups, "cut": draw(st.booleans()), **window},
        "sensor": {"kind": "sensor", "node": node, **window, **lot},
        "actuator": {"kind": "actuator", "node": node, **window, **lot},
        "crash": {"kind": "crash", "node": node, "at": at, **again},
        "jump": {"kind": "jump", "node": node, "at": at, "a": draw(st.sampled_from(models[ids.index(node)]))},
    }
    return faults[kind]


def with_faults(topology: Topology, faults: list[dict[str, Any]], **more: Any) -> Topology:
    """Return the same resolved network with these faults."""
    return Topology.model_validate(json.loads(topology.model_dump_json()) | {"faults": faults} | more)


class Plain:
    """The knowledge of every node at every step, by sets of rows and the rules of docs/faults.md; slow and obvious."""

    def __init__(self, topology: Topology, ran: Trajectory) -> None:
        self.topology, self.ran, self.graph = topology, ran, topology.graph
        self.effects = effects(topology.faults, topology)
        self.lots = Lots(topology.graph, topology.ids, topology.seed)
        self.lots.take(self.effects)
        n, T = self.graph.n, topology.steps
        self.absent = np.zeros((T + 2, n), dtype=bool)
        for t in range(T + 2):
            for effect in self._of("crash"):
                if effect.start <= t < effect.stop:
                    self.absent[t, list(effect.targets)] = True

    def _of(self, kind: str) -> list[Effect]:
        return [effect for effect in self.effects if effect.kind == kind]

    def struck(self, kind: str, t: int) -> set[int]:
        """Return the targets that effects of a kind strike at t."""
        found: set[int] = set()
        for effect in self._of(kind):
            if effect.table is not None:
                found |= set(effect.table.get(t, ()))
            else:
                hit = self.lots.strikes(effect, np.array([t]))[0]
                found |= {target for target, yes in zip(effect.targets, hit, strict=True) if yes}
        return found

    def late(self, t: int) -> dict[int, int]:
        """Links that are late at t, and by how much."""
        late: dict[int, int] = {}
        for effect in self._of("delay"):
            hit = self.lots.strikes(effect, np.array([t]))[0]
            for target, yes in zip(effect.targets, hit, strict=True):
                if yes:
                    late[target] = max(late.get(target, 0), effect.by)
        return late

    def ahat(self) -> Any:
        """Return the estimates that the law should act on, (T, n); NaN for absent nodes."""
        graph, T = self.graph, self.topology.steps
        x = self.ran.x
        known: list[set[int]] = [set() for _ in graph.node]
        blind = [self.struck("sensor", t) for t in range(T + 1)]
        estimates = np.full((T, graph.n), np.nan)
        learned_from = np.zeros(graph.n, dtype=int)
        for t in range(T):
            for i in range(graph.n):
                if self.absent[t, i]:
                    for c in np.flatnonzero(graph.node == i).tolist():
                        known[c].clear()
                    if not self.topology.backfill:
                        learned_from[i] = t + 1
                    continue
                estimates[t, i] = self._estimate(i, t, known, blind, x, int(learned_from[i]))
            # A message of t is known at t + 1.
            lost, late = self.struck("drop", t), self.late(t)
            for c, (i, j) in enumerate(zip(graph.node.tolist(), graph.neighbour.tolist(), strict=True)):
                if c in lost or self.absent[t, j] or (self.absent[t, i] and self.absent[t + 1, i]):
                    continue
                if self.topology.backfill:
                    known[c] |= set(range(t - late.get(c, 0) + 1))
                elif c not in late:
                    known[c].add(t)
            # A row that arrives at a node before its return is lost with all else.
            for c, i in enumerate(graph.node.tolist()):
                if self.absent[t, i] and self.absent[t + 1, i]:
                    known[c].clear()
        return estimates

    def _estimate(self, i: int, t: int, known: list[set[int]], blind: Any, x: Any, since: int) -> float:
        topology, rows = self.topology, self.ran.rows
        law = Minimax(gain_of(topology, i), padded([listed(topology)[i]]))
        incidences = np.flatnonzero(self.graph.node == i)
        for tau in range(since, t):
            if i in blind[tau] or i in blind[tau + 1]:
                continue
            open_here = [c for c in incidences if rows[tau].edge_open[self.graph.edge[c]]]
            if not all(tau in known[c] for c in open_here):
                continue
            u = rows[tau].u
            flow, weight = 0.0, self.graph.weight
            for c in open_here:
                flow += (1.0 if weight is None else weight[c]) * (u[i] - u[self.graph.neighbour[c]])
            law.learn(x[tau, i : i + 1], np.array([flow]), x[tau + 1, i : i + 1])
        return float(law.ahat[0])


def gain_of(topology: Topology, i: int) -> float:
    """The gain of the node at a position."""
    b = topology.network.b
    return b if isinstance(b, float) else float(b[i])
