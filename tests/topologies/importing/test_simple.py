"""Graphs of any kind become undirected ones with ids, and every change is counted."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.topologies.importing.ids import ids_of
from tests.tools.importing import edges_of


def test_parallel_edges_add_and_loops_are_dropped() -> None:
    graph = nx.MultiGraph()
    graph.add_edge("p", "q", weight=1.0)
    graph.add_edge("q", "p", weight=2.5)
    graph.add_edge("q", "q", weight=1.0)
    net = hg.from_networkx(graph)
    assert edges_of(net) == {frozenset("pq"): 3.5}
    assert [note[:2] for note in net.notes if "dropped" in note or "merged" in note] == ["1 ", "1 "]


def test_two_directions_are_one_edge_of_the_mean_weight() -> None:
    graph = nx.DiGraph()
    graph.add_edge(0, 1, weight=1.0)
    graph.add_edge(1, 0, weight=2.0)
    graph.add_edge(1, 2, weight=4.0)
    assert edges_of(hg.from_networkx(graph)) == {frozenset((0, 1)): 1.5, frozenset((1, 2)): 4.0}


def test_a_symmetric_matrix_names_every_edge_once() -> None:
    matrix = np.array([[0, 2.0, 0], [2.0, 0, 0.25], [0, 0.25, 0]])
    assert edges_of(hg.from_adjacency(matrix)) == {frozenset((0, 1)): 2.0, frozenset((1, 2)): 0.25}


@pytest.mark.parametrize("weight", [0.0, -1.0, float("nan"), float("inf")])
def test_a_weight_that_is_not_above_0_is_refused(weight: float) -> None:
    graph = nx.Graph()
    graph.add_edge(0, 1, weight=weight)
    with pytest.raises(hg.UserError) as raised:
        hg.from_networkx(graph)
    assert raised.value.code == hg.Code.FILE_FORMAT


def test_a_named_attribute_gives_the_weights_and_a_missing_one_is_refused() -> None:
    graph = nx.path_graph(3)
    nx.set_edge_attributes(graph, {(0, 1): 0.5, (1, 2): 0.25}, "capacity")
    assert edges_of(hg.from_networkx(graph)) == {frozenset((0, 1)): 1.0, frozenset((1, 2)): 1.0}
    assert edges_of(hg.from_networkx(graph, weight="capacity"))[frozenset((0, 1))] == 0.5
    assert edges_of(hg.from_networkx(graph, weight=3))[frozenset((0, 1))] == 3.0
    with pytest.raises(hg.UserError) as raised:
        hg.from_networkx(graph, weight="length")
    assert raised.value.code == hg.Code.OPTION


def test_the_largest_component_and_the_largest_weights_are_kept() -> None:
    graph = nx.disjoint_union(nx.cycle_graph(3), nx.path_graph(2))
    assert len(hg.from_networkx(graph).topology.ids) == 5
    assert len(hg.from_networkx(graph, largest_component=True).topology.ids) == 3
    star = nx.star_graph(4)
    nx.set_edge_attributes(star, {edge: float(k + 1) for k, edge in enumerate(star.edges)}, "weight")
    assert edges_of(hg.from_networkx(star, max_degree=2)) == {frozenset((0, 3)): 3.0, frozenset((0, 4)): 4.0}


def test_storage_gives_each_node_its_gain() -> None:
    graph = nx.path_graph(3)
    nx.set_node_attributes(graph, {0: 1.0, 1: 4.0, 2: 16.0}, "area")
    net = hg.from_networkx(graph, storage="area", b=0.2)
    np.testing.assert_allclose(net.topology.network.b, [0.2, 0.1, 0.05])


def test_labels_and_positions_are_kept() -> None:
    graph = nx.Graph()
    graph.add_node(0, label="São Paulo", pos=(1.0, 2.0))
    graph.add_node(1, label="Rio de Janeiro", pos=(3.0, 4.0))
    graph.add_edge(0, 1)
    network = hg.from_networkx(graph).topology.network
    assert tuple(network.ids) == ("Sao_Paulo", "Rio_de_Janeiro")
    assert network.labels == ("São Paulo", "Rio de Janeiro")
    assert network.positions is not None
    assert network.positions.tolist() == [[1.0, 2.0], [3.0, 4.0]]


NAMES = st.one_of(
    st.text(max_size=6), st.integers(-5, 12), st.floats(-2, 4), st.tuples(st.integers(0, 3), st.text(max_size=2))
)


@given(st.lists(NAMES, unique_by=repr, min_size=1, max_size=8))
def test_any_names_become_ids_of_a_valid_file(names: list[object]) -> None:
    ids, labels, _ = ids_of(names, None)
    assert len(set(ids)) == len(names) == len(labels)
    net = hg.Network("any", b=0.1, steps=1, nodes={node: {} for node in ids})
    assert list(net.topology.ids) == ids


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6), st.floats(0.01, 9)), min_size=1, max_size=20))
def test_merged_weights_are_sums_in_any_order(triples: list[tuple[int, int, float]]) -> None:
    expected: dict[frozenset[int | str], float] = {}
    for i, j, weight in triples:
        if i != j:
            expected[frozenset((i, j))] = expected.get(frozenset((i, j)), 0.0) + weight
    found = edges_of(hg.from_edges(triples))
    assert found.keys() == expected.keys()
    assert all(found[edge] == pytest.approx(weight) for edge, weight in expected.items())
