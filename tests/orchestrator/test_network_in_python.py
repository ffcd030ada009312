"""A network in Python: its networkx graph, its picture, its copies, and the way from a data frame to figure 4."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib as mpl
import networkx as nx
import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection

import hedgerow as hg
from tests.tools.importing import edges_of

NODES = {
    "p": {"position": [0, 0], "label": "Pump", "b": 0.05},
    "q": {"position": [2, 0], "x0": 3.0},
    "r": {"position": [2, 1], "candidates": [0.4, 0.6], "a": 0.6},
}
EDGES = [["p", "q"], {"ends": ["q", "r"], "weight": 4.0}, {"ends": ["p", "r"], "weight": 2.0}]


@pytest.fixture
def net() -> hg.Network:
    return hg.Network("three", b=0.1, steps=5, nodes=NODES, edges=EDGES)


@pytest.fixture
def ax() -> Iterator[Axes]:
    mpl.use("agg")
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def dots(ax: Axes) -> PathCollection:
    (found,) = [one for one in ax.collections if isinstance(one, PathCollection)]
    return found


def lines(ax: Axes) -> LineCollection:
    (found,) = [one for one in ax.collections if isinstance(one, LineCollection)]
    return found


def test_the_graph_has_all_that_the_file_says(net: hg.Network) -> None:
    graph = net.graph
    assert type(graph) is nx.Graph
    assert graph.name == "three"
    assert dict(graph.nodes["p"], a=0, x0=0) == {"b": 0.05, "label": "Pump", "pos": (0, 0), "a": 0, "x0": 0}
    assert (graph.nodes["q"]["x0"], graph.nodes["q"]["b"], graph.nodes["r"]["a"]) == (3.0, 0.1, 0.6)
    assert nx.get_edge_attributes(graph, "weight") == {("p", "q"): 1.0, ("q", "r"): 4.0, ("p", "r"): 2.0}
    again = edges_of(hg.from_networkx(graph, b=0.1))
    assert again == {frozenset("pq"): 1.0, frozenset("qr"): 4.0, frozenset("pr"): 2.0}


def test_a_picture_has_a_dot_for_each_node_and_wider_lines_for_larger_weights(net: hg.Network, ax: Axes) -> None:
    assert net.plot(ax) is ax
    at = np.asarray(dots(ax).get_offsets())
    np.testing.assert_allclose((at[2] - at[1]) / (at[1, 0] - at[0, 0]), [0, 0.5], atol=1e-9)
    widths = np.asarray(lines(ax).get_linewidth())
    assert len(widths) == 3
    assert widths[0] < widths[2] < widths[1]
    ends = [np.asarray(path.vertices) for path in lines(ax).get_paths()]
    for end, (i, j) in zip(ends, [(0, 1), (1, 2), (0, 2)], strict=True):
        np.testing.assert_allclose(end, at[[i, j]])
    assert [text.get_text() for text in ax.texts] == ["Pump", "q", "r"]


def test_names_are_drawn_if_they_are_few_or_wanted(ax: Axes) -> None:
    many = hg.Network("ring", b=0.1, steps=5, graph={"kind": "ring", "nodes": 80})
    assert not many.plot(ax).texts
    assert len(np.asarray(dots(ax).get_offsets())) == 80
    ax.clear()
    assert len(many.plot(ax, labels=True).texts) == 80


def test_a_picture_without_axes_has_its_own(net: hg.Network) -> None:
    mpl.use("agg")
    ax = net.plot(labels=False)
    assert not ax.texts
    assert len(np.asarray(dots(ax).get_offsets())) == 3
    plt.close("all")


def test_a_change_is_a_copy_that_is_checked(net: hg.Network, tmp_path: Path) -> None:
    more = net.with_node("s", x0=1.0).with_edge("s", "p", weight=0.5).without_edge("p", "q").replace(seed=9)
    assert (len(net["nodes"]), len(net.graph.edges)) == (3, 3)
    assert edges_of(more) == {frozenset("qr"): 4.0, frozenset("pr"): 2.0, frozenset("sp"): 0.5}
    assert set(more.without_node("r").graph.nodes) == {"p", "q", "s"}
    mistakes: list[Callable[[], hg.Network]] = [
        lambda: net.with_edge("p", "z"),
        lambda: net.with_edge("p", "p"),
        lambda: net.with_node("p", a=2.0),
    ]
    for mistake in mistakes:
        with pytest.raises(hg.TopologyError):
            mistake()
    path = more.save(tmp_path / "more.yaml")
    assert hg.Network.of(path).topology == more.topology
    with pytest.raises(hg.UserError):
        more.save(path)


def test_a_frame_of_edges_becomes_figure_4(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    edges = pandas.DataFrame({"from": ["s", "m", "m"], "to": ["m", "t", "h"], "capacity": [2.0, 1.0, 0.5]})
    net = hg.from_edges(edges, weight="capacity", steps=40, seed=3)
    assert edges_of(net) == {frozenset("sm"): 2.0, frozenset("mt"): 1.0, frozenset("mh"): 0.5}
    run = hg.simulate(net, run_dir=tmp_path / "run")
    # Figure 4: each node's distance to the trajectory of the controller that knows every a.
    np.testing.assert_array_equal(run.regret, np.abs(run.x - run.x_oracle))
    assert run.regret.shape == (41, 4)
    assert (run.regret[0] == 0).all()
    assert run.regret.max() > 0
