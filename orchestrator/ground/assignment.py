"""The knowledge of each process: a resolved topology divided into the plant's truth and the local views of the
agents.
"""

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
from hedgerow.wire.message import REPORT_ROWS

Layout = Sequence[Sequence[int] | Index]
"""Per agent process: the positions of its nodes, ascending."""

REPORT_BYTES = 1024
"""the maximum size of a channel in a final report, and of the parts of a message beside its numbers [bytes]"""
HISTORY_BYTES = 2**28
"""The maximum memory for the histories of all processes together, as a rough estimate [bytes]."""


JUMPS_CHECKED = 20_000
"""the maximum number of nodes for which the plant can refuse the command of a jump to a value that is no candidate"""


def layout(topology: Topology, processes: int | None) -> Layout:
    """Return the nodes of each of `processes` agent processes, cut at few edges; None is one process per node."""
    n = len(topology.ids)
    if processes is not None and not 1 <= processes <= n:
        raise UserError(f"--processes {processes}: {n} nodes run in 1 to {n} processes")
    return parts_of(topology.graph, processes or n, topology.layout)


def truth_of(topology: Topology, shards: Layout) -> Truth:
    """Return the plant's knowledge of a resolved topology."""
    network = topology.network
    return Truth(
        ids=id_array(network.ids),
        b=network.b,
        a=network.a,
        x0=network.x0,
        edges=network.graph.edges,
        weights=network.graph.weights,
        candidates=network.candidates if len(network.ids) <= JUMPS_CHECKED else None,
        disturbance=network.disturbance,
        steps=topology.steps,
        seed=topology.seed,
        shards=[np.asarray(nodes, dtype=np.int64) for nodes in shards],
        effects=[effect.to_dict() for effect in effects(topology.faults, topology)],
        faults=len(topology.faults),
        history=history_of(topology),
    )


def history_of(topology: Topology) -> int:
    """Return the number of past steps that every process stores for back-filling: that of the file, limited by the
    memory.
    """
    graph = topology.graph
    row = 8 * (3 * graph.n + 2 * len(graph.edges))
    return min(topology.history, max(1, HISTORY_BYTES // row)) if topology.backfill else 0


def candidates_of(topology: Topology) -> Array:
    """Return the models of each node under the topology's law, one column per node, padded with NaN, (M, n).

    hinf has the truth alone, nominal its nominal value.
    """
    network = topology.network
    match topology.law:
        case "hinf":
            return network.a[None]
        case "nominal":
            return network.nominal[None]
        case _:
            return network.candidates


def law_seed(topology: Topology, seed: int | None = None) -> int:
    """Return the seed of the laws: a function of the seed of the run that does not reveal the truth.

    `seed` replaces that of the topology if it is given. The result is 0 for the laws of the paper, which draw nothing:
    an agent receives only what its law may need.
    """
    if topology.law in LAWS:
        return 0
    return int(lots.keys(topology.seed if seed is None else seed, "law", lots.words_of(["seed"]))[0] >> np.uint64(1))


def law_of(topology: Topology) -> str:
    """Return the law that the agents run: hinf and nominal are minimax with one candidate per node."""
    return "minimax" if topology.law in ("hinf", "nominal") else topology.law


def views_of(topology: Topology, shards: Layout, source: str = "") -> list[View]:
    """Return the local view of each agent process: its nodes and their neighbours, but never the truth or the graph.

    `source` is the digest of the source of the law, for processes that load it themselves.
    """
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
        # By shard and then by node: both ends use this order in a link message.
        shard, beside = home[neighbour[outside]] * graph.n, neighbour[outside]
        received, place = np.unique(shard + beside, return_inverse=True)
        column[outside] = len(nodes) + place
        sent = np.unique(shard + row[outside])
        found = np.unique(received // graph.n, return_counts=True)
        peers = [
            Peer(q, sent[sent // graph.n == q] % graph.n, count)
            for q, count in zip(*(one.tolist() for one in found), strict=True)
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
                outside=ids[received % graph.n],
                history=history,
                seed=law_seed(topology),
                law_source=source,
            )
        )
    return views


def process_name(view: View) -> str:
    """Return the name of the process of a view: in `ps`, in its log, and in its certificate."""
    return _name(view.shard, view.ids)


def process_names(topology: Topology) -> list[str]:
    """Return the names of the agent processes of a network, by shard."""
    shards, ids = layout(topology, topology.process_count), id_array(topology.ids)
    return [_name(p, ids[np.asarray(nodes, dtype=np.int64)]) for p, nodes in enumerate(shards)]


def _name(shard: int, ids: Ids) -> str:
    name = f"agent-{ids[0]}"
    # A certificate holds a name of at most 64 letters.
    return name if len(ids) == 1 and len(name) <= 64 else keys.shard_name(shard)


def places(views: Sequence[View]) -> list[Place]:
    """Return the place of each process: the data for the rules of access."""
    return [
        Place(process_name(view), view.shard, [peer.shard for peer in view.peers], _largest(view), len(view.row))
        for view in views
    ]


def _largest(view: View) -> int:
    """Return an upper bound of the largest message of a process [bytes]: its final report, or all rows that a peer has
    missed.
    """
    row = max((len(peer.sends) for peer in view.peers), default=0)
    input_ = 8 * view.k * (1 + REPORT_ROWS) + len(view.row)
    return REPORT_BYTES * (1 + len(view.peers)) + max(16 * row * (view.history + 1), input_)


def _without_padding(candidates: Array) -> Array:
    """Return the array without rows in which the shard has no candidate: it must not reveal how many other shards
    have.
    """
    return np.ascontiguousarray(candidates[~np.isnan(candidates).all(axis=1)])
