"""Who is told what: a resolved topology cut into the plant's truth and each agent process's local view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hedgerow.agents.view import Ids, Peer, View
from hedgerow.plant.truth import Truth
from hedgerow.topologies import lots
from hedgerow.topologies.archive import id_array
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.faults import effects
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.partition import parts_of
from hedgerow.topologies.schema import LAWS, Topology
from hedgerow.wire import keys
from hedgerow.wire.access import Place
from hedgerow.wire.codec import REPORT_ROWS

Layout = Sequence[Sequence[int] | Index]
"""Per agent process: the positions of its nodes, ascending."""

WORD_BYTES = 1024
"""what a process says of a channel in its last word, or has around its numbers, at most"""
HISTORY_BYTES = 2**28
"""What the histories of a network may take, all processes together, as a rough measure."""


def layout(topology: Topology, processes: int | None) -> Layout:
    """Nodes over `processes` agent processes, cut where few edges cross; None is one process a node."""
    n = len(topology.ids)
    if processes is not None and not 1 <= processes <= n:
        raise UserError(f"--processes {processes}: {n} nodes run in 1 to {n} processes")
    return parts_of(topology.graph, processes or n, topology.layout)


def truth_of(topology: Topology, shards: Layout) -> Truth:
    """What the plant is told of a resolved topology."""
    network = topology.network
    return Truth(
        ids=id_array(network.ids),
        b=network.b,
        a=network.a,
        x0=network.x0,
        edges=network.graph.edges,
        weights=network.graph.weights,
        disturbance=network.disturbance,
        steps=topology.steps,
        seed=topology.seed,
        shards=[np.asarray(nodes, dtype=np.int64) for nodes in shards],
        effects=[effect.to_dict() for effect in effects(topology.faults, topology)],
        faults=len(topology.faults),
        history=history_of(topology),
    )


def history_of(topology: Topology) -> int:
    """How many past steps every process keeps for back-filling: as many as the file says and memory has room for."""
    graph = topology.network.graph
    row = 8 * (3 * graph.n + 2 * len(graph.edges))
    return min(topology.history, max(1, HISTORY_BYTES // row)) if topology.backfill else 0


def candidates_of(topology: Topology) -> Array:
    """The models that each node chooses among under the topology's law, a column a node, NaN-padded, (M, n).

    hinf has the truth only, nominal its nominal value.
    """
    network = topology.network
    match topology.law:
        case "hinf":
            return network.a[None]
        case "nominal":
            return network.nominal[None]
        case _:
            return network.candidates


def law_seed(topology: Topology) -> int:
    """Return the seed of the laws: a function of the seed of the run, from which the truth cannot be found.

    It is 0 for the laws of the paper, which draw nothing: an agent is given what its law may need, and no more.
    """
    if topology.law in LAWS:
        return 0
    return int(lots.keys(topology.seed, "law", lots.words_of(["seed"]))[0] >> np.uint64(1))


def law_of(topology: Topology) -> str:
    """The law that the agents run: hinf and nominal are minimax, with one candidate a node."""
    return "minimax" if topology.law in ("hinf", "nominal") else topology.law


def views_of(topology: Topology, shards: Layout) -> list[View]:
    """What each agent process is told: its own nodes and who their neighbours are, never the truth or the graph."""
    graph, ids, candidates = topology.network.graph, id_array(topology.ids), candidates_of(topology)
    b, law, history = topology.network.b, law_of(topology), history_of(topology)
    home = np.empty(graph.n, dtype=np.int64)
    for p, nodes in enumerate(shards):
        home[nodes] = p
    incidences = home[graph.node].argsort(kind="stable")
    stops = np.bincount(home[graph.node], minlength=len(shards)).cumsum()
    views = []
    for p, (nodes, own) in enumerate(zip(shards, np.split(incidences, stops[:-1]), strict=True)):
        nodes = np.asarray(nodes, dtype=np.int64)  # noqa: PLW2901
        row, neighbour = np.searchsorted(nodes, graph.node[own]), graph.neighbour[own]
        column = np.searchsorted(nodes, neighbour)
        outside = home[neighbour] != p
        # By shard and then by node: the order in which both ends list what is in a link message.
        shard, beside = home[neighbour[outside]] * graph.n, neighbour[outside]
        heard, place = np.unique(shard + beside, return_inverse=True)
        column[outside] = len(nodes) + place
        said = np.unique(shard + row[outside])
        hears, says = heard // graph.n, said // graph.n
        peers = [
            Peer(q, said[says == q] % graph.n, int(count))
            for q, count in zip(*(found.tolist() for found in np.unique(hears, return_counts=True)), strict=True)
        ]
        views.append(
            View(
                shard=p,
                b=b if isinstance(b, float) else b[nodes],
                law=law,
                ids=ids[nodes],
                candidates=_without_padding(candidates[:, nodes]),
                row=row,
                column=column,
                weights=None if graph.weight is None else graph.weight[own],
                peers=peers,
                heard=ids[heard % graph.n],
                history=history,
                seed=law_seed(topology),
            )
        )
    return views


def process_name(view: View) -> str:
    """What the process of a view is called: in `ps`, by its log, and in its certificate."""
    return _name(view.shard, view.ids)


def process_names(topology: Topology) -> list[str]:
    """What the agent processes of a network are called, by shard."""
    shards, ids = layout(topology, topology.process_count), id_array(topology.ids)
    return [_name(p, ids[np.asarray(nodes, dtype=np.int64)]) for p, nodes in enumerate(shards)]


def _name(shard: int, ids: Ids) -> str:
    name = f"agent-{ids[0]}"
    # A certificate holds a name of 64 letters at most.
    return name if len(ids) == 1 and len(name) <= 64 else keys.shard_name(shard)


def places(views: Sequence[View]) -> list[Place]:
    """Where each process stands: all that the rules of access need to know of a network."""
    return [
        Place(process_name(view), view.shard, [peer.shard for peer in view.peers], _largest(view), len(view.row))
        for view in views
    ]


def _largest(view: View) -> int:
    """Bytes of the largest message that a process ever says, at most: its last word, or all that a peer has missed."""
    row = max((len(peer.say) for peer in view.peers), default=0)
    input_ = 8 * view.k * (1 + REPORT_ROWS) + len(view.row)
    return WORD_BYTES * (1 + len(view.peers)) + max(16 * row * (view.history + 1), input_)


def _without_padding(candidates: Array) -> Array:
    """Less the rows that no node of the shard has a candidate in: it is not told how many others have."""
    return np.ascontiguousarray(candidates[~np.isnan(candidates).all(axis=1)])
