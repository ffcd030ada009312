"""Gains of nodes and weights of edges: files, draws, tables and intervals, and equal ones that change no bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.metrics.summary import table as shown
from hedgerow.topologies import nodes as spelling
from hedgerow.topologies import resolve as resolving
from hedgerow.topologies.edges import Edge
from hedgerow.topologies.errors import Code, TopologyError
from hedgerow.topologies.graph import Graph
from hedgerow.topologies.load import load
from hedgerow.topologies.network import span
from hedgerow.topologies.partition import cut, cut_weight
from hedgerow.topologies.resolve import resolve, save, to_yaml
from hedgerow.topologies.schema import Topology
from tests.tools.networks import networks, observe, partitions, read, simulate

HEAD = "name: n\nb: 0.1\nsteps: 6\nseed: 5\ndefaults: {x0: 3, disturbance: {kind: white, std: 0.2}}\n"
UNEQUAL = (
    HEAD + "nodes: {1: {b: 0.05, label: North tank, position: [0, 1]}, 2: {b: {random: [0.05, 0.1]}}, 3: {}}\n"
    "edges: [[1, 2], {ends: [3, 2], weight: 0.25}, {ends: [1, 3], weight: {random: [0.5, 2]}}]\n"
)


@given(networks(), st.data())
def test_gains_and_weights_that_are_all_alike_change_no_bit(topology: Topology, data: st.DataObject) -> None:
    """One number for all, or the same number in arrays: the trajectory, the metrics and the checks are equal."""
    network = topology.network
    edges = network.graph.edges
    alike = replace(network, b=0.05, graph=Graph(network.graph.n, edges))
    spelled = replace(
        network, b=np.full(len(network.ids), 0.05), graph=Graph(alike.graph.n, edges, np.ones(len(edges)))
    )
    one, other = topology.of_network(alike), topology.of_network(spelled)
    shards = data.draw(partitions(len(topology.ids)))
    ran = simulate(one, shards)
    assert simulate(other, shards).same_bits(ran)
    (observer, batch), (again, same) = observe(one, ran), observe(other, ran)
    assert repr(observer.summary()) == repr(again.summary())
    assert batch.cost.tobytes() == same.cost.tobytes()
    assert [check.excess <= 0 for check in observer.checks.values()] == [
        check.excess <= 0 for check in again.checks.values()
    ]


def test_a_file_with_equal_gains_and_weights_is_uniform() -> None:
    nodes = "nodes: [1, 2]\n"
    spelled = read(HEAD.replace("x0: 3", "x0: 3, b: 0.2") + nodes + "edges: [{ends: [1, 2], weight: 1}]\n")
    assert isinstance(spelled.network.b, float)
    assert spelled.graph.weights is None
    assert to_yaml(spelled) == to_yaml(read(HEAD.replace("b: 0.1", "b: 0.2") + nodes + "edges: [[1, 2]]\n"))


def test_the_resolved_file_holds_every_gain_and_weight_to_the_bit() -> None:
    topology = read(UNEQUAL)
    text = to_yaml(topology)
    again = read(text)
    assert to_yaml(again) == text
    assert np.array_equal(again.network.b, topology.network.b)
    assert np.array_equal(again.graph.weights, topology.graph.weights)  # type: ignore[arg-type]
    assert simulate(again).same_bits(simulate(topology))
    assert again.nodes[1].label == "North tank"
    assert again.nodes[1].position == (0.0, 1.0)
    assert again.network.labels == ("North tank", "", "")
    assert again.edges[0] == (1, 2)
    assert again.edges[1] == Edge(ends=(3, 2), weight=0.25)
    assert again.pairs == [(1, 2), (3, 2), (1, 3)]


def test_a_draw_is_a_function_of_the_seed_and_the_ids() -> None:
    """Neither the order of nodes and edges nor a further node changes a gain or a weight."""
    topology = read(UNEQUAL)
    other = read(
        HEAD + "nodes: {4: {}, 3: {}, 2: {b: {random: [0.05, 0.1]}}, 1: {b: 0.05}}\n"
        "edges: [{ends: [3, 1], weight: {random: [0.5, 2]}}, {ends: [2, 3], weight: 0.25}, [2, 1], [4, 3]]\n"
    )
    assert other.nodes[2].b == topology.nodes[2].b
    assert topology.graph.weights is not None
    assert other.graph.weights is not None
    assert other.graph.weights[:3].tolist() == topology.graph.weights[::-1].tolist()
    drawn = [float(topology.graph.weights[2]), float(read(UNEQUAL, "seed=6").graph.weights[2])]  # type: ignore[index]
    assert all(0.5 <= weight < 2 for weight in drawn)
    assert drawn[0] != drawn[1]


def test_a_rule_gives_its_edges_weights() -> None:
    same = read(HEAD + "graph: {kind: ring, nodes: 5, weight: 0.5}")
    assert same.graph.weights is not None
    assert (same.graph.weights == 0.5).all()
    assert same.graph.weighted_degree.tolist() == [1.0] * 5
    drawn = read(HEAD + "graph: {kind: grid, nodes: 9, weight: {random: [0.5, 1]}}")
    assert drawn.graph.weights is not None
    assert len(np.unique(drawn.graph.weights)) == len(drawn.edges)
    assert read(HEAD + "graph: {kind: ring, nodes: 5, weight: 1}").graph.weights is None


def test_a_large_network_keeps_gains_weights_labels_and_positions_in_its_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resolving, "SPELLED_OUT", 2)
    monkeypatch.setattr(spelling, "SPELLED_OUT", 2)
    topology = read(UNEQUAL)
    save(topology, tmp_path / "topology.yaml")
    again = resolve(load(str(tmp_path / "topology.yaml")), tmp_path)
    assert isinstance(again.edges, spelling.Edges)
    assert tuple(again.edges) == tuple(topology.edges)
    assert tuple(again.edges[1:]) == tuple(topology.edges)[1:]
    assert tuple(again.pairs) == ((1, 2), (3, 2), (1, 3))
    assert dict(again.nodes) == dict(topology.nodes)
    assert again.network.labels == topology.network.labels
    assert simulate(again).same_bits(simulate(topology))


def test_users_bring_gains_and_weights_in_tables(tmp_path: Path) -> None:
    pairs = np.array([[0, 1], [1, 2]])
    columns: dict[str, Any] = {"edges": pairs, "weights": [2.0, 0.5], "b": [0.1, 0.05, 0.2], "labels": ["x", "", "z"]}
    np.savez(tmp_path / "t.npz", **columns)
    topology = read(HEAD + "table: t.npz\nnodes: {2: {b: 0.1}}\n", folder=tmp_path)
    assert np.asarray(topology.network.b).tolist() == [0.1, 0.05, 0.1]
    assert topology.graph.weighted_degree.tolist() == [2.0, 2.5, 0.5]
    assert topology.nodes[2].label == "z"


@pytest.mark.parametrize(
    "columns",
    [
        {"weights": [1.0, 0.0]},
        {"weights": [1.0, -1.0]},
        {"weights": [1.0, np.nan]},
        {"weights": [1.0]},
        {"b": [0.1, 0.1, 0.0]},
        {"b": [0.1]},
        {"positions": [[0.0, 1.0]]},
        {"positions": [[0.0, np.nan], [0.0, 0.0], [1.0, 1.0]]},
        {"labels": ["a", "b", "c\x1b"]},
        {"labels": [1, 2, 3]},
        {"b": [0.1, 0.4, 0.1], "a": [0.5, 0.5, 0.5]},
    ],
    ids=str,
)
def test_a_column_that_is_wrong_is_refused(tmp_path: Path, columns: dict[str, Any]) -> None:
    whole: dict[str, Any] = {"edges": np.array([[0, 1], [1, 2]]), "x0": [1.0, 2.0, 3.0]} | columns
    np.savez(tmp_path / "t.npz", **whole)
    with pytest.raises(TopologyError):
        read(HEAD + "table: t.npz\n", folder=tmp_path)


@pytest.mark.parametrize(
    ("edge", "line"),
    [
        ("{ends: [1, 2], weight: 0}", 7),
        ("{ends: [1, 2], weight: -0.5}", 7),
        ("{ends: [1, 2], weight: {random: [0, 1]}}", 7),
        ("{ends: [1, 2], weight: {random: [2, 1]}}", 7),
        ("{ends: [1, 2, 3], weight: 1}", 7),
        ("{ends: [1, 9], weight: 1}", 7),
        ("{ends: [1, 1], weight: 1}", 7),
        ("{weight: 1}", 7),
        ("{ends: [1, 2], wieght: 1}", 7),
    ],
)
def test_an_edge_that_is_wrong_is_refused_on_its_line(edge: str, line: int) -> None:
    with pytest.raises(TopologyError) as refused:
        read(f"{HEAD}nodes: [1, 2, 3]\nedges: [{edge}]\n")
    (problem,) = refused.value.problems
    assert problem.line == line
    assert problem.code == Code.TOPOLOGY


def test_the_same_edge_twice_is_refused_with_any_weights() -> None:
    with pytest.raises(TopologyError) as refused:
        read(f"{HEAD}nodes: [1, 2]\nedges:\n- [1, 2]\n- {{ends: [2, 1], weight: 3}}\n")
    (problem,) = refused.value.problems
    assert problem.line == 9


def test_a_file_is_judged_by_the_largest_numbers_that_can_be_drawn() -> None:
    """With b up to 0.3 and weights up to 2, a node with two edges has no interval, for any draw."""
    text = HEAD + "graph: {kind: ring, nodes: 5, weight: {random: [0.1, W]}}\n"
    for seed in range(3):
        with pytest.raises(TopologyError) as refused:
            read(text.replace("W", "2"), f"seed={seed}", "defaults.b={random: [0.01, 0.3]}")
        (problem,) = refused.value.problems
        assert "0.1767" in problem.cure
        read(text.replace("W", "2"), f"seed={seed}", "defaults.b={random: [0.01, 0.1767]}")


@given(networks())
def test_a_drawn_number_is_in_the_interval_of_its_node(topology: Topology) -> None:
    """Candidates are drawn for the gain and the weighted degree of each node."""
    network = topology.network
    again = resolve(
        Topology.model_validate(
            topology.model_dump()
            | {"nodes": {node: {"b": own.b, "x0": 1.0} for node, own in topology.nodes.items()}, "defaults": {}}
        )
    )
    a = again.network.candidates
    load_ = np.broadcast_to(network.b, len(network.ids)) ** 2 * network.graph.weighted_degree
    assert (a * a + 2 * load_ < a + 1e-15).all()


def test_check_shows_gains_weighted_degrees_and_the_weight_that_is_cut() -> None:
    topology = read(UNEQUAL, "edges.2.weight=1.5", "nodes.2.b=0.06", "processes=3")
    text = shown(topology)
    for number in ("0.06", "0.25", "1.5", "2.75"):
        assert number in text
    assert "gain" not in shown(read(HEAD + "nodes: [1, 2]\nedges: [[1, 2]]\n")).splitlines()[0]


def test_a_cut_is_counted_by_edges_and_weighed_beside() -> None:
    graph = Graph(4, np.array([[0, 1], [1, 2], [2, 3]]), np.array([5.0, 0.5, 7.0]))
    parts = (np.array([0, 1]), np.array([2, 3]))
    assert cut(graph, parts) == 1
    assert cut_weight(graph, parts) == 0.5


def test_a_range_in_words() -> None:
    assert span(0.1) == "0.1"
    assert span(np.array([0.05, 0.2])) == "0.05 to 0.2"


def test_a_random_gain_of_the_network_leads_to_the_defaults() -> None:
    with pytest.raises(TopologyError) as refused:
        read(HEAD.replace("b: 0.1", "b: {random: [0.05, 0.1]}") + "nodes: [1, 2]\n")
    (problem,) = refused.value.problems
    assert (problem.line, problem.place) == (2, "b")
    assert "defaults:" in problem.cure


def test_lots_that_stand_in_a_file_give_the_gain() -> None:
    """A lot of 0.5 is the middle of the range."""
    topology = read(
        HEAD + "nodes: {1: {b: {random: [0.05, 0.1]}}, 2: {}}\nlots: {seed: 5, nodes: {1: {b: 0.5}}}\n",
    )
    assert topology.nodes[1].b == pytest.approx(0.075)
