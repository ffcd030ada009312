"""The viewer's content: the network as a picture, the faults with their times, and the costs.

    1          below each other, as in the file
    |
    2 - - - - - - 4         messages between 2 and 4 are lost: dashes
    |           /   \\
    3 -|  |- 5  6     7     the edge between 3 and 5 is cut: a gap
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray
from PIL import Image
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.metrics.fault_schedule import Schedule
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.views import palette
from hedgerow.orchestrator.views.layout import positions
from hedgerow.orchestrator.views.palette import packed, state_colors
from hedgerow.orchestrator.views.rerun.fault_timeline import LANES, OF_NODE, FaultTimeline, of_edge
from hedgerow.orchestrator.views.rerun.heatmap import COLUMNS, HeatMap
from hedgerow.orchestrator.views.rerun.network_picture import Picture, decaying_peak
from hedgerow.orchestrator.views.rerun.panels import DOWN, LARGE
from hedgerow.orchestrator.views.rerun.stream import PICTURES_AT_ONCE, Pace, RerunStream
from hedgerow.orchestrator.views.rerun.viewer import Viewer
from hedgerow.topologies.graph import Graph
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.orchestrator.views.test_rerun_stream import paper7
from tests.orchestrator.views.test_rerun_stream import read as scalars
from tests.tools import networks
from tests.tools.examples import examples
from tests.tools.networks import observe, simulate
from tests.tools.processes import Orchestrator
from tests.tools.schedules import with_faults
from tests.tools.viewers import begin_headless, kill, until

DROP: dict[str, Any] = {"kind": "drop", "link": [2, 4], "steps": [0, 20]}
CUT: dict[str, Any] = {"kind": "cut", "edge": [3, 5], "steps": [12, 20]}


def recorded(topology: Topology, path: Path, rows: int = 7) -> tuple[Observer, list[Batch]]:
    """The run in run.rrd at `path`, logged in batches of some rows."""
    observer, ran = Observer(topology), simulate(topology)
    stream = RerunStream(topology, observer, "story", path, None)
    batches = [observer.take(ran.rows[k : k + rows]) for k in range(0, len(ran.rows), rows)]
    for batch in batches:
        stream.log(batch)
    observer.finish(ran.end)
    stream.end(observer)
    assert stream.close(60.0)
    return observer, batches


def column(path: Path, entity: str, component: str) -> dict[int, Any]:
    """Return a component of an entity by step; -1 has the static one."""
    found: dict[int, Any] = {}
    for chunk in RrdReader(path).stream().filter(content=f"/{entity}", components=component):
        table = chunk.to_record_batch()
        steps = table.column("step").to_pylist() if "step" in table.schema.names else [-1] * table.num_rows
        found |= dict(zip(map(int, steps), table.column(component).to_pylist(), strict=True))
    return found


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def test_a_tree_is_drawn_as_a_tree() -> None:
    topology = paper7()
    x, level = positions(topology.graph).T
    assert level.tolist() == [0, 1, 2, 2, 3, 3, 3]
    assert x[topology.ids.index(6)] < x[topology.ids.index(4)] < x[topology.ids.index(7)]
    assert x[topology.ids.index(3)] < x[topology.ids.index(4)]


def test_a_grid_is_drawn_as_a_grid() -> None:
    side = 12
    across = [(side * i + j, side * i + j + 1) for i in range(side) for j in range(side - 1)]
    down = [(side * i + j, side * (i + 1) + j) for i in range(side - 1) for j in range(side)]
    x, y = positions(Graph(side * side, np.array(across + down))).T.reshape(2, side, side)
    assert np.abs(np.diff(x, axis=1) - 1).max() < 0.25
    assert np.abs(np.diff(y, axis=0) - 1).max() < 0.25


@given(networks.networks(most=9, steps=1))
@settings(deadline=None, max_examples=examples(40))
def test_every_network_has_a_place_for_each_node_and_always_the_same(topology: Topology) -> None:
    places = positions(topology.graph)
    n = len(places)
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1)) + 9 * np.eye(n)
    assert apart.min() > 0.05
    np.testing.assert_array_equal(places, positions(topology.graph))


def test_a_picture_shows_lost_messages_cut_edges_and_wrong_models(tmp_path: Path) -> None:
    topology = with_faults(paper7(), [DROP, CUT, {"kind": "crash", "node": 7, "at": 14, "restart_after": 3}])
    path = tmp_path / "run.rrd"
    _, batches = recorded(topology, path)
    edges = column(path, "network/edges", "LineStrips2D:colors")
    broken = column(path, "network/broken", "LineStrips2D:colors")
    rings = column(path, "network/rings", "Points2D:colors")
    crosses = column(path, "network/dead", "LineStrips2D:strips")
    fills = column(path, "network/nodes", "Points2D:colors")
    graph = topology.graph
    hidden = int(packed(palette.BACKGROUND))
    peak = 0.0
    for t, batch, row in ((int(t), one, row) for one in batches for row, t in enumerate(one.t)):
        lost, cut = ~batch.link_up[row], ~batch.edge_open[row][graph.edge]
        assert [color == hidden for color in edges[t]] == (lost | cut).tolist(), t
        drawn = np.array(broken[t])
        assert (drawn == packed(palette.LOST)).sum() == 3 * (lost & ~cut).sum(), t
        assert np.isin(drawn, [packed(palette.CUT), packed(palette.BOTH)]).sum() == 2 * cut.sum(), t
        wrong = (batch.ahat[row] != batch.a[row]) & ~np.isnan(batch.ahat[row])
        assert [color == int(packed(palette.WRONG)) for color in rings[t]] == wrong.tolist(), t
        assert [color == int(packed(palette.DEAD)) for color in rings[t]] == np.isnan(batch.ahat[row]).tolist(), t
        assert len(crosses[t]) == 1 + 2 * np.isnan(batch.ahat[row]).sum(), t
        x = np.abs(batch.x[row])
        peak = max(0.85 * peak, x.max())
        np.testing.assert_allclose(
            np.array(fills[t], dtype=np.uint32).view(np.uint8).astype(int),
            state_colors(x / peak).view(np.uint8).astype(int),
            atol=1,
        )
    assert sorted(edges) == list(range(topology.steps))
    assert (14 in crosses, len(crosses[14]), len(crosses[13])) == (True, 3, 1)


def test_the_panel_now_names_the_largest_state_failures_wrong_models_and_costs(tmp_path: Path) -> None:
    topology = with_faults(paper7(), [DROP, CUT])
    _, batches = recorded(topology, tmp_path / "run.rrd")
    texts = column(tmp_path / "run.rrd", "now", "TextDocument:text")
    batch, row = batches[2], 1
    assert batch.t[row] == 15
    _, struggles, down, wrong, costs = texts[15][0].splitlines()
    assert f"node **{topology.ids[int(np.abs(batch.x[row]).argmax())]}**" in struggles
    assert "edge cut: **3–5**" in down
    assert "message lost: **4→2, 2→4**" in down
    assert {i for i in topology.ids if f" {i} (â" in wrong} == {
        i for i, right in zip(topology.ids, batch.ahat[row] == batch.a[row], strict=True) if not right
    }
    assert f"D = {batch.regret_sum[row]:.4g} (nominal law {batch.nominal_regret_sum[row]:.4g})" in costs
    assert "oracle's" in costs


def test_the_lanes_are_the_schedule(tmp_path: Path) -> None:
    """The timeline of each link and node at each step, compared with the schedule of the faults."""
    faults: list[dict[str, Any]] = [
        {"kind": "drop", "from": 2, "to": 4, "steps": [3, 25], "probability": 0.4},
        {"kind": "drop", "at": {"7": [[4, 2]], "8": [[4, 2]]}},
        {"kind": "cut", "edge": [3, 5], "steps": [5, 28], "probability": 0.5},
        {"kind": "cut", "edge": [2, 4], "steps": [8, 12]},
    ]
    topology = with_faults(paper7(), faults)
    path = tmp_path / "run.rrd"
    recorded(topology, path)
    schedule, graph, steps = Schedule(topology), topology.graph, np.arange(topology.steps)
    codes = np.zeros((topology.steps, len(topology.edges)), dtype=int)
    drops, cuts = schedule.instances(steps, "lost"), schedule.instances(steps, "cut")
    for row, incidence in set(zip(drops.row.tolist(), drops.target.tolist(), strict=True)):
        edge = graph.edge[incidence]
        codes[row, edge] += 1 if graph.node[incidence] == graph.edges[edge, 0] else 2
    codes[cuts.row, cuts.target] += 4
    begun = set()
    for k, (i, j) in enumerate(topology.pairs):
        shows = column(path, f"link/{i}-{j}", "StateChange:state")
        now, shown = ["ok"], []
        for t in range(topology.steps):
            now = shows.get(t, now)
            shown += now
        assert shown == [of_edge(str(i), str(j))[code][0] for code in codes[:, k]], (i, j)
        if shows:
            begun.add((i, j))
    assert begun == {(2, 4), (3, 5)}


def test_a_lane_of_a_node_shows_death_silence_and_jumps_and_no_wrong_models() -> None:
    candidates = paper7().nodes[2].candidates
    assert isinstance(candidates, tuple)
    topology = with_faults(
        paper7(),
        [
            {"kind": "crash", "node": 4, "at": 10, "restart_after": 3},
            {"kind": "sensor", "node": 1, "steps": [15, 17]},
            {"kind": "jump", "node": 2, "at": 20, "a": candidates[0]},
        ],
    )
    _, batch = observe(topology, simulate(topology))
    codes = FaultTimeline(topology).codes(batch)[:, len(topology.edges) :]
    labels_of = [[OF_NODE[code][0] for code in row] for row in codes]
    assert [t for t, row in enumerate(labels_of) if row[3] == "dead"] == [10, 11, 12]
    assert [t for t, row in enumerate(labels_of) if row[0] == "no input"] == [15, 16]
    assert [t for t, row in enumerate(labels_of) if row[1] == "a jumps"] == [20]
    assert {label for row in labels_of for label in row} == {"ok", "dead", "no input", "a jumps"}


def test_faults_of_the_file_stand_among_the_events(tmp_path: Path) -> None:
    recorded(with_faults(paper7(), [DROP, CUT]), tmp_path / "run.rrd")
    lines = column(tmp_path / "run.rrd", "events", "TextLog:text")
    assert lines[0] == ["fault 1 begins: drop 2-4 from step 0 to 20"]
    assert lines[12] == ["fault 2 begins: cut 3-5 from step 12 to 20"]
    assert "ends" in lines[20][0]


def test_a_quick_run_is_thinned_and_its_last_step_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    pace = Pace(20.0)
    assert len(pace.pick(0)) == 0
    assert pace.pick(60).tolist() == list(range(60)), "what is short is drawn whole"
    pace.pick(10 * PICTURES_AT_ONCE)
    drawn = 0
    for _ in range(500):
        clock[0] += 0.02
        picked = pace.pick(1000)
        assert not len(picked) or picked[-1] == 999
        drawn += len(picked)
    assert 195 <= drawn <= 205


def test_the_last_step_is_drawn_even_if_it_comes_too_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Pace, "pick", lambda *_: np.zeros(0, dtype=np.int64))
    recorded(paper7(), tmp_path / "run.rrd")
    drawn = column(tmp_path / "run.rrd", "network/nodes", "Points2D:colors")
    assert sorted(drawn) == [paper7().steps - 1]


def test_the_scale_of_a_picture_follows_the_decaying_peak() -> None:
    peak = decaying_peak(np.array([0.0, 8.0, 0.0, 7.0, 0.0]), 1.0)
    np.testing.assert_allclose(peak, [0.85, 8.0, 6.8, 7.0, 5.95])
    np.testing.assert_array_equal(decaying_peak(np.zeros(3), 0.0), 0)


def test_the_heat_map_keeps_its_size_and_every_peak() -> None:
    _, batch = observe(paper7(), simulate(paper7()))
    heat, n = HeatMap(7), len(batch.t)
    for k in range(100):
        x = np.zeros_like(batch.x)
        if k == 33:
            x[4, 2] = -5.0
        heat.take(Batch(**{**vars(batch), "t": batch.t + k * n, "x": x}))
    assert heat.image.shape[1] <= COLUMNS
    assert heat.axes == ("nodes", "steps, 8 a column")
    assert [*map(tuple, np.argwhere(heat.image))] == [(2, (33 * n + 4) // 8)]


def ring(nodes: int) -> Topology:
    edges = [[k, (k + 1) % nodes] for k in range(nodes)]
    defaults = {"x0": {"random": [-5, 5]}, "disturbance": {"kind": "white", "std": 1}}
    text = {"name": "ring", "b": 0.1, "steps": 20, "processes": 1, "nodes": [*range(nodes)], "edges": edges}
    faults = [{"kind": "cut", "edge": [k, k + 1], "steps": [4, 9]} for k in range(0, 2 * LANES)]
    return networks.read(json.dumps(text | {"defaults": defaults, "faults": faults}))


def test_a_large_network_is_aggregated_and_loses_no_number(tmp_path: Path) -> None:
    topology = ring(100)
    assert len(topology.ids) > LARGE
    path = tmp_path / "run.rrd"
    _, batches = recorded(topology, path)
    x = np.abs(np.concatenate([batch.x for batch in batches]))
    np.testing.assert_array_equal(scalars(path, "x")[1][:-1], np.concatenate([batch.x for batch in batches]))
    largest, most, median = scalars(path, "quantiles/x")[1].T
    np.testing.assert_array_equal(largest, x.max(axis=1))
    assert ((x <= most[:, None]).mean(axis=1) >= 0.9).all()
    np.testing.assert_array_equal(median, np.sort(x, axis=1)[:, 49])
    down = scalars(path, "quantiles/down")[1]
    assert down[:, DOWN.index("edges cut")].tolist() == [0] * 4 + [2 * LANES] * 5 + [0] * 11
    assert sum(entity.startswith(("/link/", "/agent/")) for entity in entities(path)) == LANES
    names = column(path, "network/worst", "Points2D:labels")
    assert names[19] == [str(i) for i in np.argsort(-x[19], kind="stable")[:5]]


def test_a_node_by_itself_can_be_watched(tmp_path: Path) -> None:
    topology = networks.read('{"name": "one", "b": 0.1, "steps": 5, "nodes": ["a.b"]}')
    recorded(topology, tmp_path / "run.rrd")
    assert len(column(tmp_path / "run.rrd", "network/nodes", "Points2D:colors")) == 5


@pytest.fixture
def watched() -> Iterator[Viewer]:
    viewer = begin_headless(None, "--window-size", "1600x900")
    yield viewer
    kill(viewer)


class Seen:
    """A picture of the viewer's window, and the place of paper7 in it."""

    def __init__(self, screenshot: Path) -> None:
        window = np.asarray(Image.open(screenshot).convert("RGB")).astype(int)
        topology = resolve(load("paper7"))
        self._pixels, self._picture = window[:, : window.shape[1] // 3], Picture(topology)
        self._place = dict(zip(topology.ids, self._picture.places, strict=True))

    def between(self, i: int, j: int, part: float) -> NDArray[np.float64]:
        """A place on the edge (i, j)."""
        return np.asarray(self._place[i] + part * (self._place[j] - self._place[i]))

    @property
    def broken(self) -> bool:
        """Return True if 2-4 is lost and 3-5 cut: its middle is a gap, and node 2 learns nothing and is wrong."""
        return (
            self.at(palette.LOST, self.between(2, 4, 0.4))
            and self.at(palette.LOST, self.between(2, 4, 0.6))
            and self.at(palette.CUT, self.between(3, 5, 0.36))
            and not self.at(palette.LOST, self.between(4, 7, 0.5))
            and not self.at(palette.CUT, self.between(2, 3, 0.36))
            and self.at(palette.WRONG, self._place[2], reach=40)
        )

    @property
    def whole(self) -> bool:
        """Return True if neither is broken; an undrawn network has no broken line either, but no legend."""
        lines = [self.between(2, 4, part) for part in (0.4, 0.6)] + [self.between(3, 5, part) for part in (0.36, 0.64)]
        drawn = self.of(palette.NO_INPUT).any() and self.of(palette.LOST).any()
        return bool(drawn) and not any(self.at(color, p) for p in lines for color in (palette.LOST, palette.CUT))

    def of(self, color: palette.Color) -> NDArray[np.bool_]:
        """Return a mask of a colour in the left third of the window, which is the network's."""
        brightest = self._pixels.max(axis=2)  # of nodes, the viewer shades the rim
        parts = self._pixels / np.maximum(brightest, 1)[:, :, None] - np.array(color[:3]) / max(color[:3])
        return np.asarray((np.abs(parts) < 0.1).all(axis=2) & (brightest > 0.6 * max(color[:3])))

    def at(self, color: palette.Color, place: NDArray[np.float64], reach: int = 8) -> bool:
        """Return True if a colour is near a place of the picture; the legend gives the position of the picture."""
        legend = self._picture.legend
        ring = np.argwhere(self.of(palette.NO_INPUT))  # in the legend, above "lost both"; above it, a node's name
        ring = ring[ring[:, 0] > len(self._pixels) / 2]
        if not len(ring):
            return False
        top, left = (ring.min(axis=0) + ring.max(axis=0)) / 2
        below = np.argwhere(self.of(palette.LOST))[:, 0]
        below = below[below > top]
        if not len(below):
            return False
        pixels = (below.mean() - top) / (legend.y[1] - legend.y[0])
        middle = np.array([left, top])
        x, y = np.rint(middle + pixels * (place - [legend.x[3], legend.y[0]])).astype(int)
        near = self.of(color)[max(0, y - reach) : y + reach, max(0, x - reach) : x + reach]
        return bool(near.any())


@pytest.mark.slow
def test_a_link_is_drawn_as_broken_only_while_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, watched: Viewer
) -> None:
    """Live over Zenoh: seven processes, a real viewer, and two faults that are healed once they are seen."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    faults = [{"kind": "drop", "link": [2, 4]}, {"kind": "cut", "edge": [3, 5]}]

    def look() -> Seen:
        ViewerClient.connect(watched.url).save_screenshot(str(tmp_path / "seen.png"))
        return Seen(tmp_path / "seen.png")

    def broken() -> bool:
        return look().broken

    def whole() -> bool:
        return look().whole

    options = [f"--set=faults={json.dumps(faults)}", "--rate=10", "--steps=100000", "--no-record"]
    with Orchestrator("up", "paper7", "--viewer", watched.url, *options) as up:
        up.wait_for("running")
        until(broken, every_s=0.5)  # a picture costs more than the network
        with Live() as live:
            assert live.heal().numbers == (1, 2)
        until(whole, every_s=0.5)
        state = ViewerClient.connect(watched.url).get_state()
        assert {"Now", "Events", "Inputs u", "Regret D"} <= {view.name for view in state.views}
        assert not [view.reports for view in state.views if view.reports]
