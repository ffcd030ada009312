"""The report: figures with the numbers of the run, files for a journal, and a self-contained page.

paper  --report-->  figures 2 3 4 5, estimates, regret, cost, gain
faulty --report-->  the same, and faults
paper + fixed       one network under two laws, on the same axes
"""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from numpy.typing import NDArray
from PIL import Image

from hedgerow.orchestrator import report as reports
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.recording import Watching
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.report.compare import notices
from hedgerow.orchestrator.report.curves import BINS, quantiles
from hedgerow.orchestrator.report.figures import FIGURES
from hedgerow.orchestrator.report.reading import METRICS, number
from hedgerow.orchestrator.report.style import RED, look, save
from hedgerow.orchestrator.report.timeline import rows
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.tools.networks import read

ROOT = Path(__file__).parents[3]
KINDS = {kind.key: kind for kind in FIGURES}
DRAWN = [kind for kind in FIGURES if kind.key != "faults" and not kind.on_request]
"""The figures of a run without faults."""
PAPERS = {"2": "x", "3": "x_oracle", "4": "regret", "5": "nominal_gap"}


def ran(topology: Topology, folder: Path) -> Run:
    """A run in this process, read back from its folder."""
    simulate_into(topology, create(topology, folder), layout(topology, 1), Watching(record=False), Quiet())
    return load_run(folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def paper(folder: Path) -> Run:
    return ran(resolve(load("paper7")), folder / "paper")


@pytest.fixture(scope="module")
def fixed(folder: Path) -> Run:
    return ran(resolve(load("paper7", ["law=nominal"])), folder / "fixed")


@pytest.fixture(scope="module")
def faulty(folder: Path) -> Run:
    return ran(resolve(load(str(ROOT / "docs/examples/faulty.yaml"))), folder / "faulty")


@pytest.fixture(scope="module")
def grid(folder: Path) -> Run:
    return ran(resolve(load("grid16")), folder / "grid")


def drawn(key: str, *runs: Run) -> Figure:
    with look():
        figure = KINDS[key].draw(runs)
        figure.draw_without_rendering()
    return figure


def curves(axis: Axes) -> list[NDArray[np.float64]]:
    """The values of the lines with more than two points, each over 0, 1, 2, …"""
    lines = [line for line in axis.lines if len(line.get_ydata()) > 2]  # type: ignore[arg-type]
    for line in lines:
        np.testing.assert_array_equal(line.get_xdata(), np.arange(len(line.get_xdata())))  # type: ignore[arg-type]
    return [np.asarray(line.get_ydata()) for line in lines]


def steps(axis: Axes) -> list[NDArray[np.float64]]:
    """The values of the curves that hold until the next step."""
    return [np.asarray(patch.get_data()[0]) for patch in axis.patches if isinstance(patch, StepPatch)]


def names(figure: Figure) -> list[str]:
    return [text.get_text() for one in figure.legends for text in one.get_texts()]


# Figures


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
    in_red = [to_hex(face) == RED.lower() for face in np.asarray(nodes.get_facecolor())]
    assert in_red == (paper.ahat[-1] != paper.a[-1]).tolist() == [False] * 5 + [True, False]
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
    np.testing.assert_array_equal(curves(figure.axes[0]), [paper.gain_less_x0, paper.gain, paper.ceiling])
    assert names(figure)[-1] == r"$\gamma^*$ (the oracle's)"
    assert [*figure.axes[0].lines[-1].get_ydata()] == [paper.gamma_star] * 2  # type: ignore[misc]
    assert figure.axes[0].get_ylim()[1] < paper.gain[0]
    assert f"above the axis, at up to {paper.gain[0]:.3g}" in KINDS["gain"].caption([paper])


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
    page = report([run], folder / "still-report", "gain")[0].read_text(encoding="utf-8")
    assert "undefined" in page
    assert "The law is still:Still, which must be importable." in page
    assert "estimates are the truth" not in page


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("steps", [160, 2000])
def test_a_law_under_which_the_network_diverges_is_drawn_and_reported(
    steps: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its states are numbers for 161 steps, their squares for half as many."""
    (folder / "wild.py").write_text(
        "from hedgerow.agents.law import Minimax\n\nclass Wild(Minimax):\n    def act(self, x): return -180 * x\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(folder)
    run = ran(resolve(load("paper7", [f"steps={steps}", "law=wild:Wild"])), folder / f"wild-{steps}")
    assert run.T in (steps, 161)
    path, *_ = report([run], folder / f"wild-{steps}-report")
    assert "D is too large for a number" in "".join(page(path).text)


def test_gamma_star_is_no_promise_once_an_a_jumped(folder: Path) -> None:
    jump = "{kind: jump, node: 1, at: 8, a: 0.3}"
    text = "{name: jump, b: 0.1, steps: 20, defaults: {a: 0.8, candidates: [0.8, 0.3]}, nodes: [1, 2], edges: [[1, 2]],"
    run = ran(read(f"{text} faults: [{jump}], law: hinf}}"), folder / "jumped")
    path, *_ = report([run], folder / "jumped-report", "gain")
    assert "0.8000, 0.3000 from step 8" in "".join(page(path).text)
    assert run.faultless is False


# Files


@pytest.fixture(scope="module")
def written(paper: Run, folder: Path) -> dict[str, Path]:
    """All of the report of `paper`."""
    return {path.name: path for path in report([paper], folder / "paper-report")}


def test_every_figure_is_there_as_pdf_and_png(written: dict[str, Path], folder: Path) -> None:
    expected = {f"{kind.file}.{kind_of}" for kind in FIGURES for kind_of in ("pdf", "png") if kind in DRAWN}
    assert written.keys() == {"report.html", *expected}
    assert {path.name for path in (folder / "paper-report").iterdir()} == written.keys()


def test_a_figure_is_a_column_wide_with_its_fonts_in_it(written: dict[str, Path]) -> None:
    """3.5 in, TrueType embedded, no Type 3, and not a word of when it was made."""
    for name, path in written.items():
        content = path.read_bytes()
        if name.endswith(".pdf"):
            ((width, _),) = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", content)
            assert float(width) == 3.5 * 72
            assert content.count(b"/FontFile2") == content.count(b"/Type /FontDescriptor") > 0
            assert b"/Type3" not in content
            assert b"CreationDate" not in content
        elif name.endswith(".png"):
            with Image.open(path) as image:
                assert image.width == 3.5 * 300
                assert round(image.info["dpi"][0]) == 300
                assert len(image.convert("RGB").getcolors(image.width * image.height) or ()) > 50


def test_the_same_run_gives_the_same_bytes(paper: Run, folder: Path) -> None:
    """The second report is from another process and day, with other settings of matplotlib and other hashes."""
    keys = "1,4"
    here = report([paper], folder / "once", keys)
    (folder / "matplotlibrc").write_text("lines.linewidth: 9\npdf.fonttype: 3\n", encoding="utf-8")
    other = {"MATPLOTLIBRC": str(folder), "PYTHONHASHSEED": "7", "TZ": "Pacific/Kiritimati", "SOURCE_DATE_EPOCH": "1"}
    command = [
        sys.executable,
        "-P",
        "-m",
        "hedgerow.orchestrator",
        "report",
        "paper",
        "--figures",
        keys,
        "--out",
        "twice",
    ]
    ran_ = subprocess.run(command, cwd=folder, env=os.environ | other, capture_output=True, text=True, check=False)
    assert ran_.returncode == 0, ran_.stderr
    assert ran_.stdout == "twice/report.html, and 2 figures as PDF and PNG beside it\n"
    for path in here:
        assert path.read_bytes() == (folder / "twice" / path.name).read_bytes(), path.name


def test_the_operator_loads_matplotlib_only_to_report() -> None:
    code = "import sys, orchestrator.cli.main; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# The page


class Page(HTMLParser):
    """A page for a reader: its elements are closed in order; its references, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    @property
    def links(self) -> list[str]:
        """Everything that a browser might fetch."""
        return [value or "" for _, own in self.elements for key, value in own.items() if key in ("src", "href")]

    def row(self, name: str) -> list[str]:
        """The cells behind the first cell of that name."""
        start = self.text.index(name) + 1
        return [cell for cell in self.text[start : self.text.index("\n", start)] if cell.strip()]


def page(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def test_the_page_has_the_numbers_of_the_verdict(paper: Run, written: dict[str, Path]) -> None:
    """The page has a table of all metrics and checks, and the complete verdict.json."""
    shown = page(written["report.html"])
    for name, words in METRICS.items():
        value = paper.verdict.content["metrics"][name]
        assert shown.row(words)[0] == (f"{value} of 7" if name == "nodes_right" else number(value))
    for name, check in paper.verdict.content["checks"].items():
        assert shown.row(name)[:2] == ["holds", check["claim"]]
    assert METRICS.keys() == paper.verdict.content["metrics"].keys()
    (verdict,) = (text for text in shown.text if text.startswith('{\n  "verdict"'))
    assert json.loads(verdict) == paper.verdict.content
    text = " ".join(shown.text)
    for said in (
        "Verdict: valid.",
        "6 of 7 estimates are the truth after 30 steps",
        "does not bound the gain",
        "numpy",
    ):
        assert said in text


def test_the_page_asks_for_nothing(written: dict[str, Path]) -> None:
    """Every picture is in it, and neither the page nor a picture in it fetches anything."""
    content = written["report.html"].read_text(encoding="utf-8")
    shown = Page(content)
    assert content.startswith("<!DOCTYPE html>")
    assert all(link.startswith("data:") for link in shown.links)
    assert not re.search(r"@import|url\(", content)
    assert not {"script", "link", "iframe", "object", "base"} & {tag for tag, _ in shown.elements}
    pictures = [base64.b64decode(link.partition("base64,")[2]) for link in shown.links if "svg" in link]
    assert len(pictures) == len(DRAWN)
    for svg in pictures:
        assert svg.startswith(b"<?xml")
        assert not re.search(rb"href=\"(?!#|data:)|<script|url\((?!#)", svg)
    assert all(own.get("alt") for tag, own in shown.elements if tag == "img")
    assert written["report.html"].stat().st_size < 2**20


def test_the_file_in_the_page_repeats_the_run(paper: Run, written: dict[str, Path], folder: Path) -> None:
    """The download in the page is the run's own topology, and its run is the same bit for bit."""
    (link,) = (link for link in page(written["report.html"]).links if "yaml" in link)
    text = base64.b64decode(link.partition("base64,")[2])
    again = ran(resolve(parse(text, "paper.yaml", folder)), folder / "again")
    for table in ("telemetry.parquet", "edges.parquet"):
        assert (again.folder / table).read_bytes() == (paper.folder / table).read_bytes()


def test_the_repetition_of_a_stopped_run_stops_at_the_same_step(paper: Run, folder: Path) -> None:
    longer = paper.topology.model_copy(update={"steps": 1000})
    path, *_ = report([replace(paper, topology=longer)], folder / "stopped-report", "gain")
    assert "orchestrator simulate paper.yaml --steps 30\n" in "".join(page(path).text)


def test_names_are_text(paper: Run, folder: Path) -> None:
    """A run with the name of a script does not run it, and its name is not mathematics."""
    name = """<script>alert("$x$")&'"""
    shutil.copytree(paper.folder, folder / name)
    run = load_run(folder / name)
    verdict = run.folder / "verdict.json"
    verdict.write_text(verdict.read_text().replace('"valid"', '"INVALID"').replace("[]", '["</pre><script>"]', 1))
    path, *_ = report([load_run(folder / name), paper], folder / "escaped", "gain")
    shown = page(path)
    assert "script" not in {tag for tag, _ in shown.elements}
    assert f"A: {name}. " in shown.text
    assert "Verdict: INVALID (</pre><script>)." in shown.text
    assert "orchestrator report '<script>alert(\"$x$\")&'\"'\"'' paper" in shown.text


def test_faults_and_their_effects(faulty: Run, folder: Path) -> None:
    """Each fault has its account, and the part of D from its steps."""
    path, *_ = report([faulty], folder / "faulty-report", "faults")
    shown = page(path)
    D = faulty.regret_sum
    for fault, (start, stop) in zip(faulty.verdict.content["faults"], ((0, 12), (22, 32), (42, 52)), strict=True):
        counts = [str(fault[name]) for name in ("scheduled", "fired", "masked", "seen", "beyond")]
        assert shown.row(fault["what"]) == [*counts, f"{D[stop] - D[start]:.4g}"]


def test_a_run_without_a_verdict_is_reported_so_far(paper: Run, folder: Path) -> None:
    """`up` was killed, or still runs: the numbers are computed again, and the page does not claim validity."""
    shutil.copytree(paper.folder, folder / "killed", ignore=shutil.ignore_patterns("verdict.json"))
    path, *_ = report([load_run(folder / "killed")], folder / "killed-report", "4")
    shown = page(path)
    assert "Verdict: none yet." in shown.text
    assert shown.row(METRICS["regret"]) == [number(paper.verdict.content["metrics"]["regret"])]


# Runs beside each other


def test_two_laws_on_the_same_axes(paper: Run, fixed: Run, folder: Path) -> None:
    """Each run has a panel with the same limits; totals overlap, numbers are side by side, and differences are in
    words.
    """
    upper, lower = drawn("4", paper, fixed).axes
    np.testing.assert_array_equal(np.array(curves(upper)).T, paper.regret)
    np.testing.assert_array_equal(np.array(curves(lower)).T, fixed.regret)
    assert upper.get_ylim() == lower.get_ylim()
    assert [axis.get_title("left") for axis in (upper, lower)] == ["A: minimax", "B: nominal"]
    figure = drawn("regret", paper, fixed)
    expected = [paper.regret_sum, paper.nominal_regret_sum, fixed.regret_sum, fixed.nominal_regret_sum]
    np.testing.assert_array_equal(curves(figure.axes[0]), expected)
    assert names(figure) == ["A: minimax", "B: nominal", "nominal"]

    path, *_ = report([paper, fixed], folder / "laws", "regret,gain")
    shown = page(path)
    for name, words in METRICS.items():
        if name != "nodes_right":
            assert shown.row(words) == [number(run.verdict.content["metrics"][name]) for run in (paper, fixed)]
    assert "B differs from A in the law (nominal, not minimax)." in shown.text
    assert not [own for _, own in shown.elements if own.get("class") == "warning"]


def test_other_networks_are_not_compared_without_a_warning(paper: Run, grid: Run, folder: Path) -> None:
    path, *_ = report([paper, grid], folder / "others", "2")
    text = " ".join(page(path).text)
    assert "These runs are not comparable" in text
    assert "it has other nodes (16, not 7) and edges." in text


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ([], "B repeats A"),
        (["seed=2"], "B differs from A in true a and candidates and the disturbances. So it has a different oracle"),
        (["faults=[{kind: drop, link: [2, 4], steps: [3, 9]}]"], "B differs from A in the faults."),
        (
            ["steps=20", "defaults.x0=1"],
            "B differs from A in x(0) and the steps (20, not 30). So it has a different oracle",
        ),
        (["b=0.09"], "B is of another network than A: it has other b (0.09, not 0.1)."),
    ],
)
def test_differences_are_reported(paper: Run, tmp_path: Path, overrides: Sequence[str], said: str) -> None:
    comparable, sentences = notices([paper, ran(resolve(load("paper7", overrides)), tmp_path / "run")])
    assert sentences[0].startswith(said)
    assert comparable == ("another network" not in said)


# Failures


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures take time only if they are wanted."""
    monkeypatch.setattr("hedgerow.orchestrator.report.style.save", lambda *_: b"<svg/>")


@pytest.mark.parametrize(
    ("figures", "said"),
    [
        ("9", "there is no figure 9; choose of 1, 2, 3, 4, 5, paper, estimates, regret, cost, gain, faults"),
        ("2,", "there is no figure without a name; choose of 1"),
        ("faults", "there is nothing to show of faults in paper; leave it out"),
    ],
)
def test_a_figure_that_there_is_not(paper: Run, tmp_path: Path, figures: str, said: str) -> None:
    with pytest.raises(UserError, match=re.escape(said)):
        report([paper], tmp_path / "out", figures)
    assert [*tmp_path.iterdir()] == []


@pytest.mark.usefixtures("quick")
def test_existing_files_are_replaced_only_on_request(paper: Run, tmp_path: Path) -> None:
    """Foreign files are never replaced."""
    out = tmp_path / "deep" / "out"
    report([paper], out, "2")
    with pytest.raises(UserError, match="already exists; --force replaces it"):
        report([paper], out, "4")
    (out / "report.html").write_text("old", encoding="utf-8")
    report([paper], out, "4", force=True)
    assert "Figure 4" in (out / "report.html").read_text(encoding="utf-8")
    (out / "thesis.tex").touch()
    with pytest.raises(UserError, match=r"holds thesis\.tex, which is of no report"):
        report([paper], out, "4", force=True)
    with pytest.raises(UserError, match=r"is a file; --out names a folder"):
        report([paper], out / "thesis.tex", "4", force=True)


def test_a_report_is_complete_or_absent(paper: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk fills up at the second figure: the old report remains, without further files."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("old", encoding="utf-8")
    done: list[str] = []

    def full(figure: Figure, folder: Path, name: str, title: str, formats: Sequence[str]) -> bytes:
        if done:
            raise OSError(28, "No space left on device")
        done.append(name)
        return save(figure, folder, name, title, formats)

    monkeypatch.setattr("hedgerow.orchestrator.report.style.save", full)
    with pytest.raises(UserError, match="No space left on device; --out names another folder"):
        report([paper], out, "cost,gain", force=True)
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "report.html"]
    assert (out / "report.html").read_text(encoding="utf-8") == "old"


def test_too_many_runs(paper: Run, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="8 runs: a report is of 1 to 7"):
        report([paper] * 8, tmp_path / "out")


def test_without_matplotlib_the_message_names_the_package(
    paper: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [*sys.modules]:
        if name.partition(".")[0] == "matplotlib" or name.startswith("hedgerow.orchestrator.report."):
            monkeypatch.delitem(sys.modules, name)
    for name in ("figures", "page", "style"):
        monkeypatch.delattr(reports, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UserError, match=re.escape("pip install matplotlib")):
        report([paper], tmp_path / "out")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "error: nowhere: there is no such run; name its folder, or its name in runs/"),
        ([], "error: runs/latest: there is no such run"),
        (["empty"], "error: empty: is no folder of a run: there is no topology.yaml in it"),
    ],
)
def test_a_run_that_there_is_not(tmp_path: Path, arguments: list[str], said: str) -> None:
    (tmp_path / "empty").mkdir()
    command = [sys.executable, "-P", "-m", "hedgerow.orchestrator", "report", *arguments]
    tried = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (tried.returncode, tried.stdout) == (2, "")
    assert tried.stderr.startswith(said)


# Documents


def test_every_figure_is_in_report_md() -> None:
    text = (ROOT / "docs/report.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \| `([\w-]+)` \|", text, flags=re.MULTILINE)
    assert listed == [(kind.key, kind.file) for kind in FIGURES]


def test_the_pictures_in_the_documents_are_fresh(paper: Run, tmp_path: Path) -> None:
    """docs/make_report_images.py draws the pictures; those in the documents show the same numbers, and are small."""
    command = [
        sys.executable,
        "-W",
        "error",
        str(ROOT / "docs/make_report_images.py"),
        str(tmp_path),
        "report-authors7",
    ]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    metrics = paper.verdict.content["metrics"]
    of_paper = f"paper7: D {metrics['regret']:.6g}, nominal {metrics['regret_nominal']:.6g}"
    of_paper += f", gain {metrics['gain']:.6g}, {metrics['nodes_right']} right"
    expected = {"report-paper7": of_paper, "report-paper7-ours": of_paper}
    expected["report-authors7"] = made.stdout.strip().partition(": ")[2]
    for path in (ROOT / "docs/images").glob("report-*.png"):
        with Image.open(path) as picture:
            assert picture.info["Description"] == expected.pop(path.stem)
        assert path.stat().st_size < 64 * 1024
    assert expected == {}
    with (
        Image.open(ROOT / "docs/images/report-authors7.png") as old,
        Image.open(tmp_path / "report-authors7.png") as new,
    ):
        assert old.size == new.size
        assert old.convert("RGB").getpixel((0, 0)) == (255, 255, 255)
