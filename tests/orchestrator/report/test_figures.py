"""The figures of a report: each is the array that it names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from hedgerow.orchestrator.ground.colours import PINK
from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.report.curves import BINS, quantiles
from hedgerow.orchestrator.report.timeline import rows
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.figures import KINDS, PAPERS, curves, drawn, names, page, ran, steps
from tests.tools.networks import read


def test_the_network_is_its_graph(paper: Run) -> None:
    """The figure shows the paper's tree: seven named nodes, six edges that meet them, and node 6, with a wrong
    estimate, in red.
    """
    figure = drawn("1", paper)
    (axis,) = figure.axes
    edges, nodes = axis.collections
    places = np.asarray(nodes.get_offsets())
    assert [text.get_text() for text in axis.texts] == [str(node) for node in paper.ids]
    np.testing.assert_array_equal([text.get_position() for text in axis.texts], places)
    np.testing.assert_array_equal([path.vertices for path in edges.get_paths()], places[paper.edges])
    in_pink = [to_hex(face) == PINK.lower() for face in np.asarray(nodes.get_facecolor())]
    assert in_pink == (paper.ahat[-1] != paper.a[-1]).tolist() == [False] * 5 + [True, False]
    assert names(figure) == ["estimate wrong at the end"]


@pytest.mark.parametrize("key", PAPERS)
def test_a_figure_of_the_paper_is_its_array(key: str, paper: Run) -> None:
    """There is one line per node, equal bit for bit, named, with units, each in a different colour."""
    figure = drawn(key, paper)
    (axis,) = figure.axes
    drawn_nodes, behind = curves(axis)[:7], curves(axis)[7:]
    np.testing.assert_array_equal(np.array(drawn_nodes).T, getattr(paper, PAPERS[key]))
    if key == "2":  # with the oracle's states in grey behind them
        np.testing.assert_array_equal(np.array(behind).T, paper.x_oracle)
    assert names(figure) == ["node 1", "2", "3", "4", "5", "6", "7", *(["oracle"] if key == "2" else [])]
    assert axis.get_xlabel() == "step $t$"
    assert "[units of $x$]" in axis.get_ylabel()
    assert axis.get_title() == axis.get_title("left") == ""
    assert len({(to_hex(line.get_color()), line.get_linestyle()) for line in axis.lines[:7]}) == 7
    assert len({to_hex(line.get_color()) for line in axis.lines[:7]}) == 7


def test_compared_figures_have_the_same_axes(paper: Run) -> None:
    """Figure 3 beside 2, and 5 beside 4, whichever of them are drawn."""
    limits = {key: drawn(key, paper).axes[0].get_ylim() for key in PAPERS}
    assert limits["2"] == limits["3"] != limits["4"] == limits["5"]
    assert limits["4"][1] > paper.nominal_gap.max() > paper.regret.max()


def test_estimates_stand_over_the_truth(paper: Run) -> None:
    """There is one panel per node; node 6 is wrong by an invisible amount, which a bar and a number show."""
    figure = drawn("estimates", paper)
    panels = [axis for axis in figure.axes if axis.get_visible()]
    assert [axis.get_title("left") for axis in panels] == [f"node {node}" for node in paper.ids]
    for i, axis in enumerate(panels):
        truth, estimate = steps(axis)
        np.testing.assert_array_equal(truth, paper.a[:, i])
        np.testing.assert_array_equal(estimate, paper.ahat[:, i])
        assert bool(axis.get_title("right")) == (paper.ahat[-1, i] != paper.a[-1, i])
    assert panels[5].get_title("right") == "ends off by −0.0065"
    assert names(figure) == ["candidates", "truth $a_i$", r"estimate $\hat a_i$", "wrong"]


def test_totals_are_the_runs(paper: Run) -> None:
    """The figures are D of both, R with its sign, and the gains; gamma* is marked as the oracle's."""
    figure = drawn("regret", paper)
    for values, expected in zip(curves(figure.axes[0]), (paper.regret_sum, paper.nominal_regret_sum), strict=True):
        np.testing.assert_array_equal(values, expected)
    assert names(figure) == ["minimax", "nominal"]

    (axis,) = drawn("cost", paper).axes
    np.testing.assert_array_equal(curves(axis), [paper.cost_regret])
    low, high = axis.get_ylim()
    assert low < paper.cost_regret.min() < 0 < paper.cost_regret.max() < high

    figure = drawn("gain", paper)
    np.testing.assert_array_equal(curves(figure.axes[0]), [paper.gain, paper.ceiling, paper.gain_less_x0])
    (oracle,) = (k for k, name in enumerate(names(figure)) if "oracle" in name)
    assert oracle == 2, "below the limit of the law"
    assert [*figure.axes[0].lines[oracle].get_ydata()] == [paper.gamma_star] * 2  # type: ignore[misc]
    assert figure.axes[0].get_ylim()[1] < paper.gain[0]
    assert f"above the axis, at up to {paper.gain[0]:.3g}" in KINDS["gain"].caption([paper])


def test_the_slack_of_the_certificate_is_drawn_with_its_zero(paper: Run) -> None:
    (axis,) = drawn("slack", paper).axes
    np.testing.assert_array_equal(curves(axis), [paper.ceiling_slack])
    low, high = axis.get_ylim()
    assert low < 0 < paper.ceiling_slack.max() < high


def test_the_timeline_equals_the_recording(faulty: Run) -> None:
    """2-3 is dropped, 3-4 is cut, 3 crashes: its edges carry nothing then, and its messages are lost."""
    figure = drawn("faults", faulty)
    (axis,) = figure.axes
    assert [label.get_text() for label in axis.get_yticklabels()] == ["2–3", "3–4", "3"]
    assert names(figure) == ["message lost", "no flow", "no input"]
    bars = {
        (round(path.get_extents().x0), round(path.get_extents().x1))
        for collection in axis.collections
        for path in collection.get_paths()
    }
    crossed = faulty.i_hears & faulty.j_hears
    assert bars == {(0, 12), (22, 32), (42, 52), *stretches(~crossed[:, 2])}
    missing = {row.name: row.missing for row in rows(faulty)}
    np.testing.assert_array_equal(missing["3"]["no input"], np.isnan(faulty.u[:, 2]))
    np.testing.assert_array_equal(missing["3–4"]["no flow"], ~faulty.edge_open[:, 2])


def stretches(mask: NDArray[np.bool_]) -> set[tuple[int, int]]:
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]])).nonzero()[0]
    return {(int(a), int(b)) for a, b in edges.reshape(-1, 2)}


def test_an_a_that_jumps_is_marked(folder: Path) -> None:
    jump = "faults=[{kind: jump, node: 4, at: 15, a: random}]"
    run = ran(resolve(load("paper7", [jump])), folder / "jump")
    figure = drawn("faults", run)
    assert names(figure) == ["a jumps"]
    assert [*figure.axes[0].lines[0].get_xdata()] == [15]  # type: ignore[misc]


def test_many_nodes_are_quantiles_as_the_caption_explains(grid: Run) -> None:
    """16 nodes: median and bands in figure 2, and a heat map of the errors; every node is included."""
    figure = drawn("2", grid)
    (axis,) = figure.axes
    np.testing.assert_array_equal(curves(axis)[0], np.median(grid.x, axis=1))
    assert names(figure) == ["median", "10 to 90 %", "least to largest of 16 nodes"]
    assert "Quantiles over all nodes" in KINDS["2"].caption([grid])

    share, heat, bar = drawn("estimates", grid).axes
    np.testing.assert_array_equal(steps(share), [grid.right / 16])
    np.testing.assert_allclose(heat.images[0].get_array(), np.abs(grid.ahat - grid.a).T, atol=1e-12)  # type: ignore[arg-type]
    assert bar.get_ylabel() == r"$|\hat a_i - a_i|$ [1]"


def test_long_runs_are_drawn_by_the_extremes_of_bins(folder: Path) -> None:
    """2500 steps give 500 bins; the largest regret of each is drawn, so no peak is lost, and the caption explains
    this.
    """
    run = ran(resolve(load("paper7", ["steps=2500"])), folder / "long")
    (axis,) = drawn("4", run).axes
    for line, values in zip(axis.lines, run.regret.T, strict=True):
        parts = np.array_split(values, BINS)
        np.testing.assert_array_equal(line.get_ydata(), [part.max() for part in parts])
        np.testing.assert_array_equal(values[np.asarray(line.get_xdata(), dtype=int)], line.get_ydata())
    _, (least, most) = quantiles(run.x, (0, 1))
    np.testing.assert_array_equal([least.min(), most.max()], [run.x.min(), run.x.max()])
    assert f"in {BINS} bins" in KINDS["4"].caption([run])


def test_lost_steps_are_gaps() -> None:
    values = np.where(np.arange(2000) // 100 == 7, np.nan, 1.0)[:, None]
    _, (median,) = quantiles(values, (0.5,))
    assert np.isnan(median).sum() == BINS // 20


def test_names_that_mean_something_to_matplotlib_stay_names(folder: Path) -> None:
    """Names with underscores in front would have no place in a legend, and long ones would fill it."""
    long = "a-name-of-more-letters-than-a-legend-has-room-for"
    run = ran(read(f"{{name: odd, b: 0.1, steps: 3, nodes: [_a, __b, {long}], edges: [[_a, __b]]}}"), folder / "odd")
    shown = names(drawn("2", run))
    assert shown[:2] == ["node _a", "__b"]
    assert len(shown[2]) < 18
    assert "…" in shown[2]


def test_a_law_without_estimates_has_no_such_figure(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There are no estimates and no disturbance: the gain is undefined, and the page is still written."""
    (folder / "still.py").write_text(
        "import numpy as np\n\nclass Still:\n    def __init__(self, b, candidates):\n"
        "        self.n, self.memory = candidates.shape[1], np.zeros((1, candidates.shape[1]))\n"
        "    def act(self, x): return np.zeros(len(x))\n    def learn(self, x, flow, x_next): pass\n"
        "    def report(self): return np.full((2, self.n), np.nan)\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(folder)
    run = ran(read("{name: s, b: 0.1, steps: 4, law: 'still:Still', nodes: [1], edges: []}"), folder / "still")
    assert not KINDS["estimates"].has([run])
    page = report([run], folder / "still-report", "gain", formats=["svg"])[0].read_text(encoding="utf-8")
    assert "undefined" in page
    assert "The law is still:Still, which must be importable." in page
    assert "estimates are the truth" not in page


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("steps", "formats"), [(160, ["svg"]), (2000, ["pdf", "png"])])
def test_a_law_under_which_the_network_diverges_is_drawn_and_reported(
    steps: int, formats: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its states are numbers for 161 steps, their squares for half as many."""
    (folder / "wild.py").write_text(
        "from hedgerow.agents.law import Minimax\n\nclass Wild(Minimax):\n    def act(self, x): return -180 * x\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(folder)
    run = ran(resolve(load("paper7", [f"steps={steps}", "law=wild:Wild"])), folder / f"wild-{steps}")
    assert run.T in (steps, 161)
    path, *_ = report([run], folder / f"wild-{steps}-report", formats=formats)
    assert "D is too large for a number" in "".join(page(path).text)


def test_gamma_star_is_no_promise_once_an_a_jumped(folder: Path) -> None:
    jump = "{kind: jump, node: 1, at: 8, a: 0.3}"
    text = "{name: jump, b: 0.1, steps: 20, defaults: {a: 0.8, candidates: [0.8, 0.3]}, nodes: [1, 2], edges: [[1, 2]],"
    run = ran(read(f"{text} faults: [{jump}], law: hinf}}"), folder / "jumped")
    path, *_ = report([run], folder / "jumped-report", "gain", formats=["svg"])
    assert "0.8000, 0.3000" in "".join(page(path).text)
    assert run.faultless is False
