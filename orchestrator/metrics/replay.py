"""The replay: the plant of the file and the class of the law, put into the recorded state of every step.

Each row of telemetry gives x(t). From x(t) and the faults of the file, `plant.world` determines open edges, deliveries
and delays. `agents.shard` closes the sample of t - 1 and acts. All other numbers of the row must equal the results, bit
for bit. The first row that differs ends the replay, which names the step and the node.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import candidates_of, history_of, law_of, law_seed
from hedgerow.plant.disturbance import Disturbance
from hedgerow.plant.faults import ActiveFaults, Faults
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.faults import effects
from hedgerow.topologies.graph import Array, Graph, Index, Mask, all_finite
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import gather
from hedgerow.wire.message import LATE, REPORT_ROWS, Flag, Flags, State, Telemetry

AUDITED = 20_000
"""the maximum number of replayed nodes; in a larger network, a subset that the seed draws"""
NAMED = 8
"""the maximum number of reported differences of one step"""
PLAN, LAW = "plan", "law"
CLAIMS = {
    PLAN: "x(0), every w, and all open edges, deliveries and missing values are those of the file and of the recorded"
    " faults, bit for bit",
    LAW: "every u, ahat, margin and used input is that of the law's class for the recorded x and u and for the"
    " deliveries under the faults, bit for bit",
}


class Finding(NamedTuple):
    """The first differences from the replay, all in one step."""

    check: str
    step: int
    node: int | str | None
    """the id of the first node that differs; None if it is the whole row"""
    why: list[str]
    """by difference: its place, the recorded value and the replayed one"""


class Replay:
    """The replay of telemetry in the order of its steps, with the first difference."""

    def __init__(self, topology: Topology, audited: int = AUDITED, receipts: bool = True) -> None:
        """Prepare the replay. Without `receipts`, the rows are those of tables, which have no used inputs.

        Tables have null for a margin that is not finite.
        """
        self._receipts = receipts
        network = topology.network
        self._topology, self._graph = topology, network.graph
        self._a = network.a.copy()
        """the truth of all nodes at the replayed step: a disturbance that depends on the state depends on it too"""
        self._part = part = _Part(network.graph, topology.seed, audited)
        self._x0, self._disturbance = network.x0, Disturbance(network.disturbance, network.ids, topology.seed)
        history = history_of(topology)
        truth = Truth(
            ids=id_array(network.ids)[part.nodes],
            b=network.b if isinstance(network.b, float) else network.b[part.nodes],
            a=network.a[part.nodes],
            x0=network.x0[part.nodes],
            edges=part.graph.edges,
            weights=part.graph.weights,
            disturbance=[],
            steps=topology.steps,
            seed=topology.seed,
            shards=[np.arange(part.graph.n)],
            effects=[],
            faults=0,
            history=history,
        )
        self._world = _Shadow(truth)
        candidates = candidates_of(topology)[:, part.nodes]
        self._shard = Shard(
            View(
                shard=0,
                b=truth.b,
                law=law_of(topology),
                ids=truth.ids,
                candidates=np.ascontiguousarray(candidates[~np.isnan(candidates).all(axis=1)]),
                row=part.graph.node,
                column=part.graph.neighbour,
                weights=part.graph.weight,
                peers=[],
                outside=id_array([]),
                history=history,
                seed=law_seed(topology),
            )
        )
        self.nodes = part.audited
        """the number of replayed nodes"""
        self.steps = 0
        """the number of equal rows"""
        self.finding: Finding | None = None
        self.doubt = ""
        """the reason why the replay ended before the run without a difference"""
        self.change(topology)

    def change(self, topology: Topology) -> None:
        """Use the faults of this topology from the next step on."""
        self._topology = topology
        faults = Faults(effects(topology.faults, topology), self._graph, topology.network.ids, topology.seed)
        self._faults, self._world.faults = faults, self._part.of(faults)

    def take(self, rows: Sequence[Telemetry]) -> None:
        """Replay some rows, which follow the earlier ones."""
        with np.errstate(all="ignore"):
            for row in rows:
                if self.finding is not None or self.doubt:
                    return
                self._take(row)

    def _take(self, row: Telemetry) -> None:
        t = self._world.t
        if row.t > t:
            self.doubt = f"replayed up to step {t} only: its row is lost"
            return
        if row.t < t:
            self.finding = Finding(PLAN, row.t, None, [f"the row of step {row.t} came after that of step {t - 1}"])
            return
        try:
            self._compare(row, self._expected(row))
        except Exception as error:  # the law is code of the user
            self.doubt = f"replayed up to step {t} only: {type(error).__name__}: {error}"
        else:
            self.steps += self.finding is None

    def _expected(self, row: Telemetry) -> Telemetry:
        """Return the expected telemetry of the replayed nodes, from the recorded x and all replayed steps."""
        world, shard, part = self._world, self._shard, self._part
        t, x = row.t, part.of_nodes(row.x)
        world.x = x
        world.begin()
        if world.quiet:
            u = part.beyond(shard, shard.answer(State(t, x, b"")), row)
            if all_finite(u):
                return world.pass_by(u, shard.report)
            return world.follow(u, shard.report, shard.used, part.of_nodes(row.w))
        ((state, record),) = world.states()
        if state is None:
            nothing, no_report, used = shard.silence
            u, report = gather([nothing]), gather([no_report]).reshape(REPORT_ROWS, -1)
        else:
            if record is not None:
                shard.recall(record)
            u = part.beyond(shard, shard.answer(state), row)
            report, used = shard.report, shard.used
        return world.follow(u, report, used, part.of_nodes(row.w))

    # The differences.

    def _compare(self, row: Telemetry, expected: Telemetry) -> None:
        part, t = self._part, row.t
        if t == 0 and row.x.tobytes() != self._x0.tobytes():
            self._find_numbers(PLAN, t, "x(0)", row.x, self._x0)
        w = self._w(row)
        if row.w.tobytes() != w.tobytes():
            self._find_numbers(PLAN, t, "w", row.w, w)
        if not part.whole:
            row = part.of_row(row)
        if not self._receipts:
            row = row._replace(used=expected.used)
            ahat, margin = expected.report
            expected = expected._replace(report=np.stack([ahat, np.where(np.isfinite(margin), margin, np.nan)]))
        if (
            row.u.tobytes() == expected.u.tobytes()
            and row.report.tobytes() == expected.report.tobytes()
            and row.used.tobytes() == expected.used.tobytes()
            and row.link_up.tobytes() == expected.link_up.tobytes()
            and row.edge_open.tobytes() == expected.edge_open.tobytes()
        ):
            return
        used = row.used, expected.used
        own = part.own
        missing = np.isnan(row.u)
        other = (missing != np.isnan(expected.u)) & own
        texts = ["has an input that a fault takes away", "has no input, and no fault takes it away"]
        found = [(k, texts[int(missing[k])]) for k in np.flatnonzero(other).tolist()]
        self._find(PLAN, t, found, part.nodes)
        # Compare first the used inputs of t - 1, and then the actions at t.
        self._find_flags(LAW, t - 1, ("counted for flow", "counted for none"), *used, Flag.OPEN)
        self._find_flags(LAW, t - 1, ("was taken in", "was not taken in"), *used, Flag.RECEIVE)
        self._find_late(t - 1, *used)
        self._find_edges(t, row.edge_open, expected.edge_open)
        self._find_flags(PLAN, t, ("crosses in its step", "does not"), row.link_up, expected.link_up, 1)
        for name, seen, right in (
            ("ahat", row.report[0], expected.report[0]),
            ("margin", row.report[1], expected.report[1]),
            ("u", row.u, expected.u),
        ):
            self._find_numbers(LAW, t, name, np.where(own, seen, 0.0), np.where(own, right, 0.0), part.nodes)

    def _w(self, row: Telemetry) -> Array:
        """Return w(t), (n,), for the recorded x(t)."""
        if not self._disturbance.sees_state:
            return self._disturbance.at(row.t)
        for node, a in self._faults.jumps(row.t):
            self._a[node] = a
        return self._disturbance.at(row.t, row.x, self._a)

    def _find_numbers(
        self, check: str, t: int, name: str, seen: Array, right: Array, nodes: Index | None = None
    ) -> None:
        other = (seen.view(np.int64) != right.view(np.int64)) & ~(np.isnan(seen) & np.isnan(right))
        found = [
            (k, f"{name} is {float(seen[k])!r}, and should be {float(right[k])!r}")
            for k in np.flatnonzero(other).tolist()
        ]
        self._find(check, t, found, nodes)

    def _find_flags(self, check: str, t: int, texts: tuple[str, str], seen: Flags, right: Flags, bit: int) -> None:
        """Find the incidences with another bit; `texts` has the words for a set bit and a clear bit."""
        part, ids = self._part, self._topology.ids
        found = []
        for c in np.flatnonzero((seen ^ right) & bit).tolist():
            words = texts if seen[c] & bit else texts[::-1]
            sender = ids[int(part.nodes[part.graph.neighbour[c]])]
            text = f"the row from node {sender} {words[0]}; by the faults, it {words[1]}"
            found.append((int(part.graph.node[c]), text))
        self._find(check, t, found, part.nodes)

    def _find_late(self, t: int, seen: Flags, right: Flags) -> None:
        """Find the incidences with another number of late rows."""
        part, ids = self._part, self._topology.ids
        came, due = seen >> LATE, right >> LATE
        found = []
        for c in np.flatnonzero(came != due).tolist():
            sender = ids[int(part.nodes[part.graph.neighbour[c]])]
            text = f"{came[c]} late rows from node {sender} were taken in; by the faults, {due[c]} arrive"
            found.append((int(part.graph.node[c]), text))
        self._find(LAW, t, found, part.nodes)

    def _find_edges(self, t: int, seen: Any, right: Any) -> None:
        part, ids = self._part, self._topology.ids
        found = []
        for e in np.flatnonzero(seen != right).tolist():
            i, j = part.graph.edges[e].tolist()
            other = ids[int(part.nodes[j])]
            found.append((i, f"the edge to {other} is {_open(seen[e])}, and should be {_open(right[e])}"))
        self._find(PLAN, t, found, part.nodes)

    def _find(self, check: str, t: int, found: Sequence[tuple[int, str]], nodes: Index | None = None) -> None:
        """Record the first difference, and further ones of the same kind and step."""
        if not found or self.finding is not None:
            return
        ids = self._topology.ids
        named = [(ids[k if nodes is None else int(nodes[k])], text) for k, text in found[:NAMED]]
        self.finding = Finding(check, t, named[0][0], [f"node {node}: {text}" for node, text in named])


class _Shadow(World):
    """The plant of the file without its motion: `x` is set from outside at every step."""

    @property
    def quiet(self) -> bool:
        """Return True if t has no fault, t - 1 had none, and nothing is to be back-filled."""
        return self._now.flags is None

    def pass_by(self, u: Array, report: Array) -> Telemetry:
        """Make a quiet step with complete inputs."""
        t, x = self.t, self.x
        self._record.append(x, u, self._all_open)
        self._open, self._received = None, None
        self.t += 1
        return Telemetry(t, x, u, x, report, self._all_open, self._all_up, self._all_taken)

    def follow(self, u: Array, report: Array, used: bytes, w: Array) -> Telemetry:
        """Make any step with these inputs and the recorded w."""
        self._next_w = w
        return self.step(u, report, [used])


class _Part:
    """The replayed nodes, all or some, and their neighbours, which act as recorded."""

    def __init__(self, graph: Graph, seed: int, audited: int) -> None:
        self.whole = graph.n <= audited
        self.audited = min(graph.n, audited)
        n = graph.n
        if self.whole:
            self.nodes: Index = np.arange(n)
            """positions in the network, ascending, (k,)"""
            self.own: Mask = np.ones(n, dtype=np.bool_)
            """True for the replayed ones, (k,)"""
            self.graph = graph
            return
        chosen: Mask = np.zeros(n, dtype=np.bool_)
        chosen[np.random.default_rng(seed).choice(n, audited, replace=False)] = True
        self._edges: Mask = np.asarray(chosen[graph.edges].any(axis=1))
        edges = graph.edges[self._edges]
        near = chosen.copy()
        near[edges] = True
        self.nodes, self.own = np.flatnonzero(near), chosen[near]
        self._near = near
        self._incidences: Mask = self._edges[graph.edge]
        weights = None if graph.weights is None else graph.weights[self._edges]
        self.graph = Graph(len(self.nodes), np.searchsorted(self.nodes, edges), weights)

    def of_nodes(self, values: Array) -> Array:
        """Return values of the part's nodes, (..., k), from those of the network, (..., n)."""
        return values if self.whole else values[..., self.nodes]

    def of_row(self, row: Telemetry) -> Telemetry:
        """Return a row of the network as one of the part."""
        nodes = (self.of_nodes(values) for values in (row.x, row.u, row.w, row.report))
        links = (bits[self._incidences] for bits in (row.link_up, row.used))
        x, u, w, report = nodes
        link_up, used = links
        return Telemetry(row.t, x, u, w, report, row.edge_open[self._edges], link_up, used)

    def beyond(self, shard: Shard, u: Array, row: Telemetry) -> Array:
        """Return the inputs of the part, with recorded ones for nodes that are only neighbours."""
        if self.whole:
            return u
        mixed = np.where(self.own, u, self.of_nodes(row.u))
        shard.replace_inputs(mixed)
        return mixed

    def of(self, faults: Faults) -> Faults:
        """Return the faults of the network as those of the part."""
        return faults if self.whole else _Some(faults, self._near, self._edges, self._incidences)


class _Some(Faults):
    """The faults of a network, restricted to some nodes, edges and incidences."""

    def __init__(self, whole: Faults, nodes: Mask, edges: Mask, incidences: Mask) -> None:
        self._whole = whole
        self._targets = {"lost": incidences, "late": incidences, "cut": edges, "blind": nodes, "mute": nodes}
        self.effects: list[Effect] = whole.effects

    def none_at(self, t: int) -> bool:
        return self._whole.none_at(t)

    def at(self, t: int) -> ActiveFaults | None:
        if (active := self._whole.at(t)) is None:
            return None
        found = {name: getattr(active, name) for name in self._targets}
        return ActiveFaults(**{name: None if one is None else one[self._targets[name]] for name, one in found.items()})

    def of_links(self, t: int, most: int) -> None:
        """Return None: the faults of a part are taken step by step."""

    def absent(self, t: int) -> Mask | None:
        absent = self._whole.absent(t)
        return None if absent is None else absent[self._targets["blind"]]

    def jumps(self, t: int) -> list[tuple[int, float]]:  # noqa: ARG002
        """Return an empty list: a part does not move by itself."""
        return []


def _open(bit: Any) -> str:
    return "open" if bit else "closed"
