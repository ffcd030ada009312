"""Networks by a rule, and in a table: the meaning of a short file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.recording import same_tables
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies import hinf, resolve
from hedgerow.topologies.errors import Code, TopologyError
from hedgerow.topologies.generators import GENERATORS, Generator, GraphRule
from hedgerow.topologies.graph import Graph, Index
from hedgerow.topologies.load import load
from hedgerow.topologies.network import Network
from hedgerow.topologies.partition import _levelled, cut, partition
from hedgerow.topologies.schema import Topology
from tests.tools.examples import examples
from tests.tools.networks import read, simulate
from tests.tools.refusals import refusal

RULE: TypeAdapter[Generator] = TypeAdapter(GraphRule)
HEAD = "name: n\nb: 0.05\nsteps: 4\nseed: 5\n"
CHANCE = (
    "defaults: {x0: {random: [1, 9]}, candidates: {random: 3}, disturbance:"
    " [{kind: white, std: {random: [0, 1]}}, none, {kind: impulse, at: 2, value: 3}]}\n"
)


def rule(kind: str, nodes: int, **more: Any) -> Generator:
    return RULE.validate_python({"kind": kind, "nodes": nodes, **more})


def edges(kind: str, nodes: int, **more: Any) -> list[tuple[int, int]]:
    return [(i, j) for i, j in rule(kind, nodes, **more).edges(1).tolist()]


def degrees(pairs: Index, n: int) -> Index:
    return np.bincount(pairs.ravel(), minlength=n)


def pieces(pairs: Index, n: int) -> int:
    return int(connected_components(coo_array((np.ones(len(pairs)), pairs.T), (n, n)), directed=False)[0])


def same_bits(one: Network, other: Network) -> bool:
    """Every number of both."""
    groups = [
        (a.number, a.kind, a.nodes.tolist(), *(a.values[key].tobytes() for key in sorted(a.values)))
        == (b.number, b.kind, b.nodes.tolist(), *(b.values[key].tobytes() for key in sorted(b.values)))
        for a, b in zip(one.disturbance, other.disturbance, strict=True)
    ]
    names = ("a", "x0", "nominal", "candidates", "parts")
    columns = [getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in names]
    return all(groups + columns) and bool((one.graph.edges == other.graph.edges).all()) and [*one.ids] == [*other.ids]


def test_those_that_leave_nothing_to_chance() -> None:
    assert edges("line", 4) == [(0, 1), (1, 2), (2, 3)]
    assert edges("ring", 4) == [(0, 1), (0, 3), (1, 2), (2, 3)]
    assert edges("star", 4) == [(0, 1), (0, 2), (0, 3)]
    assert edges("grid", 5) == [(0, 1), (0, 3), (1, 2), (1, 4), (3, 4)]
    assert edges("grid", 4, columns=1) == edges("line", 4)
    assert edges("tree", 6) == [(0, 1), (0, 2), (1, 3), (1, 4), (2, 5)]
    assert edges("random_regular", 4, degree=3) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert edges("line", 1) == []


@given(st.sampled_from([*GENERATORS]), st.integers(5, 80), st.integers(0, 99), st.sampled_from([None, 4, 9]))
@settings(deadline=None, max_examples=examples(150))
def test_every_rule_makes_a_graph_within_its_bounds(kind: str, nodes: int, seed: int, most: int | None) -> None:
    """Nodes 0 .. n-1, no loop, no edge twice, ascending; and the same again from the same seed."""
    if most is not None and kind == "star":
        most = nodes
    n = nodes + nodes % 2
    made = rule(kind, n, seed=seed, max_degree=most)
    pairs = made.edges(0)
    Graph(n, pairs)
    assert pairs.shape == (len(pairs), 2)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert (np.diff(pairs[:, 0] * n + pairs[:, 1]) > 0).all()
    assert pairs.min() >= 0
    assert pairs.max() < n
    degree = degrees(pairs, n)
    assert degree.max() <= (most or n)
    assert not made.degree or degree.max() == made.degree
    assert (rule(kind, n, seed=seed, max_degree=most).edges(77) == pairs).all(), "its own seed, whatever the file's"
    if kind == "random_regular":
        assert (degree == 3).all()
    if kind in ("line", "star", "tree", "random_tree"):
        assert (len(pairs), pieces(pairs, n)) == (n - 1, 1)
    if kind == "small_world" and most is None and n >= 20:
        assert 2 * len(pairs) / n > 3


def test_chance_has_the_shape_that_its_name_promises() -> None:
    """With 20,000 nodes: hubs in a scale-free graph, few neighbours in a geometric one, a seed for every draw."""
    n = 20_000
    hubs = degrees(rule("scale_free", n).edges(1), n)
    assert 3.9 < hubs.mean() <= 4
    assert hubs.max() > 100
    # P(degree >= k) of this graph falls as m (m + 1) / (k (k + 1)).
    assert (hubs >= 10).mean() == pytest.approx(2 * 3 / (10 * 11), rel=0.15)
    near = degrees(rule("geometric", n, mean_degree=6).edges(1), n)
    assert near.mean() == pytest.approx(6, rel=0.05)
    assert degrees(rule("small_world", n, rewire=0).edges(1), n).tolist() == [4] * n
    moved = rule("small_world", n, rewire=0.3).edges(1)
    apart = np.minimum(moved[:, 1] - moved[:, 0], n - moved[:, 1] + moved[:, 0]) > 2
    assert apart.mean() == pytest.approx(0.3, rel=0.05)
    for kind in ("random_tree", "random_regular", "small_world", "scale_free", "geometric"):
        assert rule(kind, n).edges(1).tolist() != rule(kind, n).edges(2).tolist()


@pytest.mark.parametrize(
    ("graph", "place"),
    [
        ("{kind: rign, nodes: 5}", "graph: kind"),
        ("{kind: ring}", "graph"),
        ("{kind: ring, nodes: 2}", "graph"),
        ("{kind: ring, nodes: 1.5}", "graph: nodes"),
        ("{kind: ring, nodes: 9, max_degree: 1}", "graph"),
        ("{kind: random_regular, nodes: 9, degree: 3}", "graph"),
        ("{kind: random_regular, nodes: 3, degree: 3}", "graph"),
        ("{kind: small_world, nodes: 9, degree: 3}", "graph: degree"),
        ("{kind: random_tree, nodes: 9, max_degree: 1}", "graph"),
        ("{kind: grid, nodes: 9, colums: 3}", "graph"),
        ("{kind: line, nodes: 9}\nedges: [[0, 1]]", "edges"),
        ("{kind: line, nodes: 9}\nnodes: {9: {x0: 1}}", "node 9"),
        ("{kind: line, nodes: 9}\nnodes: {a: {x0: 1}}", "node a"),
        ("{kind: line, nodes: 9}\nfaults: [{kind: cut, edge: [2, 4]}]", "fault 1: edge"),
        ("{kind: line, nodes: 9}\nfaults: [{kind: sensor, node: 9}]", "fault 1: node"),
        ("{kind: star, nodes: 99}", "node 0"),
        ("{kind: line, nodes: 9}\ndefaults: {candidates: [0.5, 0.999]}", "node 1: candidates"),
        ("{kind: line, nodes: 9}\nprocesses: some", "processes"),
        ("{kind: line, nodes: 9}\nprocesses: 10", "processes"),
    ],
)
def test_a_rule_that_is_none_is_refused(graph: str, place: str) -> None:
    with pytest.raises(TopologyError) as refused:
        read(f"{HEAD}graph: {graph}\n")
    assert [problem.place for problem in refused.value.problems] == [place]


@given(st.sampled_from([*GENERATORS]), st.integers(0, 9))
@settings(deadline=None, max_examples=examples(30))
def test_a_generated_network_is_the_one_that_is_written_out(kind: str, seed: int) -> None:
    """Every random number, and the overrides of single nodes."""
    own = "{3: {x0: -7, disturbance: none}, 1: {a: 0.6}, 5: {candidates: [0.5, 0.6], a: 0.6}}"
    text = f"{HEAD}{CHANCE}".replace("seed: 5", f"seed: {seed}")
    made = read(f"{text}graph: {{kind: {kind}, nodes: 8}}\nnodes: {own}\n")
    listed = [list(pair) for pair in made.edges]
    nodes = "{0: {}, 1: {a: 0.6}, 2: {}, 3: {x0: -7, disturbance: none}, 4: {}, 5: {candidates: [0.5, 0.6], a: 0.6},"
    assert read(f"{text}edges: {listed}\nnodes: {nodes} 6: {{}}, 7: {{}}}}\n") == made
    assert (made.nodes[3].x0, made.nodes[1].a, made.nodes[5].candidates) == (-7, 0.6, (0.5, 0.6))
    assert same_bits(made.network, made.model_copy(update={"nodes": made.nodes}).network)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file lists six nodes at most: these are many."""
    monkeypatch.setattr(resolve, "SPELLED_OUT", 6)


BIG = HEAD + CHANCE + "graph: {kind: random_regular, nodes: 40}\nnodes: {7: {x0: 3}}\n"


@pytest.mark.usefixtures("short")
def test_a_run_of_many_nodes_can_be_repeated_from_its_folder(tmp_path: Path) -> None:
    faults = (
        "faults: [{kind: crash, node: 3, at: 2, restart_after: 1}, {kind: jump, node: 9, at: 1, a: random},"
        " {kind: drop, from: 0, to: 1}]"
    )
    edge = next(j for i, j in read(BIG).pairs if i == 0)
    topology = read(BIG + faults.replace("to: 1", f"to: {edge}"))
    folder = create(topology, tmp_path / "one")
    assert len(folder.topology.read_text()) < 500
    assert simulate_into(topology, folder, layout(topology, 1), Watching(record=False), Quiet()).exit_code == 0
    again = load(str(folder.path))
    assert same_bits(again.network, topology.network)
    assert resolve.resolve(again) == topology
    repeated = create(again, tmp_path / "two")
    simulate_into(again, repeated, layout(again, 3), Watching(record=False), Quiet())
    assert same_tables(folder.path, repeated.path)
    assert repeated.topology.read_bytes() == folder.topology.read_bytes()


@pytest.mark.usefixtures("short")
def test_the_nodes_of_a_big_network_are_looked_at_one_by_one() -> None:
    big = read(BIG)
    spelled = Topology.model_validate(big.model_dump(exclude={"nodes", "edges"}) | plain(big))
    assert same_bits(big.network, spelled.network)
    assert len(big.nodes) == 40
    assert big.nodes[7].x0 == 3
    assert 40 not in big.nodes
    assert "7" not in big.nodes
    with pytest.raises(KeyError):
        big.nodes[40]
    assert big.edges[0] == big.edges[:1][0] == next(iter(big.edges))


def plain(topology: Topology) -> dict[str, Any]:
    return {"nodes": {node: own.model_dump() for node, own in topology.nodes.items()}, "edges": tuple(topology.edges)}


def test_the_worst_case_of_a_rule() -> None:
    worst = read(
        f"{HEAD}graph: {{kind: ring, nodes: 5}}\ndefaults: {{a: 0.5}}\ndisturbance: {{kind: worst_case, energy: 4}}"
    )
    (group,) = worst.network.disturbance
    assert (group.values["value"] ** 2).sum() == pytest.approx(4)


def table(folder: Path, more: str = "", **columns: Any) -> Topology:
    """Return the topology of a file with this table."""
    np.savez(folder / "t.npz", **columns)
    return read(f"{HEAD}table: t.npz\n{more}", folder=folder)


def test_users_bring_tables(tmp_path: Path) -> None:
    """Edges alone suffice; a column holds for every node that `nodes:` does not change."""
    pairs = np.array([[2, 0], [1, 2]])
    bare = table(tmp_path, "defaults: {x0: 4}", edges=pairs)
    assert (bare.ids, bare.edges, bare.nodes[1].x0) == ((0, 1, 2), ((2, 0), (1, 2)), 4)
    full = table(
        tmp_path,
        "defaults: {x0: 4, nominal: 0.4}\nnodes: {mid: {x0: 9, disturbance: none}}",
        **{
            "edges": pairs,
            "ids": np.array(["left", "mid", "3"]),
            "a": [0.5, 0.6, 0.7],
            "x0": [1, 2, 3],
            "candidates": [[0.5, np.nan], [0.3, 0.6], [0.7, 0.2]],
            "w 0 white std": [0.1, 0.2, 0.3],
            "w 1 impulse nodes": [1, 2],
            "w 1 impulse at": [2, 3],
            "w 1 impulse value": [5.0, 6.0],
        },
    )
    assert full.ids == ("left", "mid", 3)
    assert [own.x0 for own in full.nodes.values()] == [1, 9, 3]
    assert [own.a for own in full.nodes.values()] == [0.5, 0.6, 0.7]
    assert [own.nominal for own in full.nodes.values()] == [0.4] * 3
    assert [own.candidates for own in full.nodes.values()] == [(0.5,), (0.3, 0.6), (0.7, 0.2)]
    kinds = [own.disturbance.kind if not isinstance(own.disturbance, tuple) else 2 for own in full.nodes.values()]  # type: ignore[union-attr]
    assert kinds == ["white", "none", 2]
    assert simulate(full, layout(full, 1)).same_bits(simulate(full))


PAIR = np.array([[0, 1]])


@pytest.mark.parametrize(
    ("columns", "code"),
    [
        ({"a": [0.5]}, Code.FILE_FORMAT),
        ({"edges": [[0, 0]]}, Code.FILE_FORMAT),
        ({"edges": [[0, 1], [1, 0]]}, Code.FILE_FORMAT),
        ({"edges": [[0, 3]], "x0": [1, 2]}, Code.FILE_FORMAT),
        ({"edges": [[0.0, 1.0]], "x0": [1, 2]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "ids": [1, 1]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "ids": ["a b", "c"]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "a": [0.5, np.nan]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "a": [0.5, 0.999]}, Code.TOPOLOGY),
        ({"edges": PAIR, "ids": [1, 2], "a": [0.5]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "candidates": [[0.5], [np.nan]]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "candidates": [[0.5], [0.4]], "a": [0.5, 0.5]}, Code.TOPOLOGY),
        ({"edges": PAIR, "c": [1]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "w 0 white stdd": [1, 2]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "w 0 white nodes": [1]}, Code.FILE_FORMAT),
        ({"edges": PAIR, "w 0 samples values": [[1.0], [2.0]]}, Code.TOPOLOGY),
        ({"edges": np.array([{"x": 1}])}, Code.FILE_FORMAT),
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path: Path, columns: dict[str, Any], code: Code) -> None:
    with refusal(code):
        table(tmp_path, **columns)


@pytest.mark.parametrize("file", ["../t.npz", "/etc/passwd", "inner/../../t.npz", "link.npz"])
def test_a_table_is_beside_its_file(tmp_path: Path, file: str) -> None:
    np.savez(tmp_path / "t.npz", edges=PAIR)
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link.npz").symlink_to("../t.npz")
    with pytest.raises(TopologyError):
        read(f"{HEAD}table: {file}\n", folder=folder)


@given(st.sampled_from([*GENERATORS]), st.integers(2, 9))
@settings(deadline=None, max_examples=examples(40))
def test_a_partition_is_one_and_cuts_no_more_than_the_order_of_the_file(kind: str, processes: int) -> None:
    n = 200
    graph = Graph(n, rule(kind, n).edges(3))
    parts = partition(graph, processes)
    assert sorted(np.concatenate(parts).tolist()) == list(range(n))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    assert all((np.diff(part) > 0).all() for part in parts)
    assert cut(graph, parts) <= cut(graph, tuple(np.array_split(np.arange(n), processes)))
    again = partition(Graph(n, graph.edges.copy()), processes)
    assert all((one == other).all() for one, other in zip(parts, again, strict=True))


def test_few_edges_of_a_shuffled_ring_are_cut() -> None:
    n = 1000
    place = np.random.default_rng(1).permutation(n)
    graph = Graph(n, place[rule("ring", n).edges(1)])
    assert cut(graph, partition(graph, 2)) <= 4


@pytest.mark.parametrize("kind", ["tree", "random_tree"])
def test_few_edges_of_a_shuffled_forest_are_cut(kind: str) -> None:
    """All that hangs below a node goes along with it: the ways from a root to two cuts are short."""
    n = 2000
    place = np.random.default_rng(1).permutation(2 * n)
    trees = np.concatenate([rule(kind, n).edges(1), n + rule(kind, n).edges(2)])
    graph = Graph(2 * n, place[trees])
    assert cut(graph, partition(graph, 2)) <= 1
    assert cut(graph, partition(graph, 3)) <= 100


def test_a_layout_by_the_graph_gives_the_same_bits() -> None:
    topology = read(
        BIG.replace("40", "90")
        + "faults: [{kind: drop, from: 0, to: 1, probability: 0.5}]".replace(
            "to: 1", f"to: {read(BIG.replace('40', '90')).pairs[0][1]}"
        )
    )
    one = simulate(topology, layout(topology, 1))
    assert simulate(topology, layout(topology, 4)).same_bits(one)
    assert simulate(topology, layout(topology, None)).same_bits(one)


def test_how_many_processes_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    counts = {
        (n, word): read(f"{HEAD}graph: {{kind: line, nodes: {n}}}\n{word}").process_count
        for n in (2, 64, 65)
        for word in ("", "processes: auto", "processes: per-node", "processes: 2")
    }
    assert list(counts.values()) == [2, 2, 2, 2, 64, 3, 64, 2, 3, 3, 65, 2]
    resolved = read(f"{HEAD}graph: {{kind: line, nodes: 65}}")
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    assert resolved.process_count == 3, "a resolved file fixes it for every machine"


@pytest.mark.parametrize("kind", ["ring", "random_regular", "scale_free"])
def test_products_with_q_agree_with_its_factors(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    network = read(f"{HEAD}graph: {{kind: {kind}, nodes: 600, max_degree: 9}}").network
    exact = hinf.gamma_star(network.a, network.b, network.graph)
    w = np.sin(np.arange(600))
    solved = hinf.q_solver(network.a, network.b, network.graph)(w)
    monkeypatch.setattr(hinf, "FACTORED", 500)
    assert hinf.gamma_star(network.a, network.b, network.graph) == pytest.approx(exact, rel=hinf.EIGENVALUE_RTOL)
    np.testing.assert_allclose(hinf.q_solver(network.a, network.b, network.graph)(w), solved, rtol=1e-7)


def test_a_random_regular_graph_is_cut_at_few_edges() -> None:
    """Orders of the nodes cut a fifth of its edges, and METIS a tenth."""
    pytest.importorskip("pymetis")
    graph = Graph(20_000, rule("random_regular", 20_000).edges(1))
    assert cut(graph, partition(graph, 2)) < 0.11 * len(graph.edges)


@given(st.lists(st.integers(0, 4), min_size=30, max_size=60))
@settings(deadline=None, max_examples=examples(30))
def test_parts_of_any_sizes_are_made_equal(home: list[int]) -> None:
    graph = Graph(len(home), rule("random_tree", len(home)).edges(1))
    found = np.bincount(_levelled(graph, np.array(home), 5), minlength=5)
    assert found.max() - found.min() <= 1
    assert found.sum() == len(home)
