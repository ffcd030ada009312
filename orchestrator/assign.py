"""Who is told what: a resolved topology cut into the plant's truth and each agent process's local view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.view import NodeView, Peer, View
from plant.truth import Truth
from topologies.errors import UserError
from topologies.faults import effects
from topologies.schema import Nothing, Topology

Layout = Sequence[Sequence[int]]
"""Per agent process: the positions of its nodes, ascending."""

HISTORY_BYTES = 2**28
"""What the histories of a network may take, all processes together, as a rough measure."""


def layout(topology: Topology, processes: int | None) -> Layout:
    """Nodes over `processes` agent processes, in network order; None is one process a node."""
    n = len(topology.ids)
    if processes is not None and not 1 <= processes <= n:
        raise UserError(f"--processes {processes}: {n} nodes run in 1 to {n} processes")
    return [[int(k) for k in part] for part in np.array_split(np.arange(n), processes or n)]


def truth_of(topology: Topology, shards: Layout) -> Truth:
    """What the plant is told of a resolved topology."""
    own = list(topology.nodes.values())
    return Truth(
        ids=topology.ids,
        b=topology.b,
        a=[node.a for node in own],  # type: ignore[misc]  # resolved: every a is a number
        x0=[node.x0 for node in own],  # type: ignore[misc]
        edges=[(int(i), int(j)) for i, j in topology.graph.edges],
        disturbance=[_components(node.disturbance) for node in own],
        steps=topology.steps,
        seed=topology.seed,
        shards=shards,
        effects=[effect.to_dict() for effect in effects(topology.faults, topology)],
        faults=len(topology.faults),
        history=history_of(topology),
    )


def history_of(topology: Topology) -> int:
    """How many past steps every process keeps for back-filling: as many as the file says and memory has room for."""
    row = 8 * (3 * len(topology.ids) + 2 * len(topology.edges))
    return min(topology.history, max(1, HISTORY_BYTES // row)) if topology.backfill else 0


def _components(disturbance: object) -> list[dict[str, object]]:
    parts = disturbance if isinstance(disturbance, tuple) else (disturbance,)
    return [part.model_dump() for part in parts if part is not None and not isinstance(part, Nothing)]


def candidates_of(topology: Topology) -> list[tuple[float, ...]]:
    """The models that each node chooses among under the topology's law: hinf has the truth only, nominal its value."""
    own = topology.nodes.values()
    match topology.law:
        case "hinf":
            return [(float(node.a),) for node in own]  # type: ignore[arg-type]
        case "nominal":
            return [(float(node.nominal),) for node in own]  # type: ignore[arg-type]
        case _:
            return [tuple(node.candidates) for node in own]  # type: ignore[arg-type]


def law_of(topology: Topology) -> str:
    """The law that the agents run: hinf and nominal are minimax, with one candidate a node."""
    return "minimax" if topology.law in ("hinf", "nominal") else topology.law


def views_of(topology: Topology, shards: Layout) -> list[View]:
    """What each agent process is told: its own nodes and who their neighbours are, never the truth or the graph."""
    ids, graph = topology.ids, topology.graph
    home = {k: p for p, nodes in enumerate(shards) for k in nodes}
    neighbours: list[list[int]] = [[] for _ in ids]
    for i, j in zip(graph.node, graph.neighbour, strict=True):
        neighbours[i].append(int(j))
    candidates = candidates_of(topology)
    views = []
    for p, nodes in enumerate(shards):
        say: dict[int, set[int]] = {}
        hear: dict[int, set[int]] = {}
        for i in nodes:
            for j in neighbours[i]:
                if (q := home[j]) != p:
                    say.setdefault(q, set()).add(i)
                    hear.setdefault(q, set()).add(j)
        views.append(
            View(
                shard=p,
                b=topology.b,
                law=law_of(topology),
                nodes=[NodeView(ids[i], candidates[i], [ids[j] for j in neighbours[i]]) for i in nodes],
                history=history_of(topology),
                peers=[
                    Peer(q, [ids[i] for i in sorted(say[q])], [ids[j] for j in sorted(hear[q])]) for q in sorted(say)
                ],
            )
        )
    return views
