"""Helpers for tests of imported networks."""

from __future__ import annotations

from hedgerow.orchestrator.network import Network


def edges_of(net: Network) -> dict[frozenset[int | str], float]:
    """Return the weight of each edge by the ids of its ends."""
    network = net.topology.network
    weights = network.graph.weights
    return {
        frozenset((network.ids[i], network.ids[j])): 1.0 if weights is None else float(weights[e])
        for e, (i, j) in enumerate(network.graph.edges.tolist())
    }
