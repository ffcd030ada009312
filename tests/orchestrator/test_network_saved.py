"""A network in Python and its file are the same network: saved, read, copied, and as a networkx graph."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import networkx as nx
import numpy as np
import pytest

import hedgerow as hg
from hedgerow.topologies.schema import Topology
from tests.tools.importing import edges_of


def odd() -> hg.Network:
    """Return a network with ids that are texts that YAML could take for something else."""
    rng = np.random.default_rng(3)
    graph = nx.random_geometric_graph(24, 0.4, seed=2)
    for i, j in graph.edges:
        graph.edges[i, j]["weight"] = float(rng.uniform(0.1, 3))
    names = ["a b", ("t", 1), "ü.x", "007", -5, 7.5, "yes", "null", "1e3", "0x1f", "12:30", "true", "~", "#x", ".5"]
    graph = nx.relabel_nodes(graph, dict(enumerate(names)))
    storage = rng.uniform(1, 9, len(graph)).tolist()
    nx.set_node_attributes(graph, dict(zip(graph, storage, strict=True)), "area")
    return hg.from_networkx(graph, largest_component=True, storage="area").with_samples({"007": rng.normal(size=300)})


NETWORKS: dict[str, Callable[[], hg.Network]] = {
    "odd ids": odd,
    "a list of nodes": lambda: hg.Network("pair", b=0.1, steps=5, nodes=["p", "q"], edges=[("p", "q")]),
    "no edges": lambda: hg.Network("one", b=0.1, steps=5, nodes=["p"]),
    "a rule": lambda: hg.Network("rule", b=0.1, steps=5, graph={"kind": "ring", "nodes": 5}),
    "nodes without settings": lambda: hg.Network("n", b=0.1, steps=5, nodes={"p": None, "q": {}}, edges=[("q", "p")]),
    "a bundled one": lambda: hg.Network.of("paper7"),
    "a table": lambda: hg.from_networkx(nx.cycle_graph(1200), b=0.1),
    "a changed table": lambda: hg.from_networkx(nx.cycle_graph(1200), b=0.1).replace(law="hinf", seed=9),
}


def same(one: Topology, other: Topology) -> None:
    a, b = one.network, other.network
    assert (one.law, list(a.ids), a.labels) == (other.law, list(b.ids), b.labels)
    np.testing.assert_array_equal(a.graph.edges, b.graph.edges)
    for left, right in (
        (a.a, b.a), (a.x0, b.x0), (a.candidates, b.candidates), (a.b, b.b), (a.positions, b.positions),
        (a.graph.weights, b.graph.weights),
    ):  # fmt: skip
        np.testing.assert_array_equal(np.asarray(left, dtype=float), np.asarray(right, dtype=float))
    for group, twin in zip(a.disturbance, b.disturbance, strict=True):
        assert group.kind == twin.kind
        for key, values in group.values.items():
            np.testing.assert_array_equal(values, twin.values[key])


@pytest.mark.parametrize("what", NETWORKS)
def test_a_saved_network_is_the_same(what: str, here: Path) -> None:
    net = NETWORKS[what]()
    net.save("net.yaml")
    same(net.topology, hg.load("net.yaml"))
    same(net.topology, net.replace(seed=net["seed"]).topology if "seed" in net else net.replace().topology)
    if not net.arrays:
        same(net.topology, hg.Network.of("net.yaml").topology)
        same(net.topology, hg.Network.of(net.topology).topology)
        same(net.topology, hg.Network(**dict(net)).topology)
    with pytest.raises(hg.UserError) as raised:
        net.save("net.yaml")
    assert raised.value.code == hg.Code.OUTPUT


def test_a_graph_of_networkx_has_the_network_that_it_came_from() -> None:
    net = odd()
    back = hg.from_networkx(net.graph)
    assert edges_of(back) == edges_of(net)
    one, other = net.topology.network, back.topology.network
    assert (list(one.ids), one.labels) == (list(other.ids), other.labels)
    np.testing.assert_array_equal(np.asarray(one.positions), np.asarray(other.positions))


def test_a_node_that_is_added_and_removed_leaves_the_network() -> None:
    net = odd()
    more = net.with_node("new", b=0.01, x0=1.0).with_edge("new", -5, weight=0.25)
    assert more.graph.edges["new", -5] == {"weight": 0.25}
    same(net.topology, more.without_node("new").topology)
