"""The look of a report's figures: their width, the user's style on top, and the formats of the files."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.report.estimates import draw_estimates
from hedgerow.orchestrator.report.nodes import states
from hedgerow.orchestrator.report.style import Look, look
from hedgerow.orchestrator.report.totals import cost, gain, marked, slack, sums
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code, UserError
from tests.tools.processes import orchestrator


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("look") / "run"
    assert orchestrator("simulate", "line5", "--no-record", "--run-dir", str(folder)).returncode == 0
    return load_run(folder)


def test_figures_have_the_width_that_is_asked_for(run: Run, tmp_path: Path) -> None:
    for width_in in (3.5, 7.16):
        report([run], tmp_path / f"{width_in}", "2,gain", width_in=width_in, formats=["png"])
        for name in ("figure-2-states", "gain"):
            with Image.open(tmp_path / f"{width_in}" / f"{name}.png") as image:
                assert image.width == pytest.approx(300 * width_in, abs=1)


def test_each_format_is_a_file_beside_the_page(run: Run, tmp_path: Path) -> None:
    files = report([run], tmp_path / "out", "2", formats=["svg"])
    assert [file.name for file in files] == ["report.html", "figure-2-states.svg"]
    assert ET.parse(files[1]).getroot().tag.endswith("svg")
    assert not list((tmp_path / "out").glob("*.pdf"))


def test_a_style_is_applied_on_top_of_ours(run: Run, tmp_path: Path) -> None:
    (tmp_path / "mine.mplstyle").write_text("savefig.dpi: 50\n")
    report([run], tmp_path / "out", "2", style=str(tmp_path / "mine.mplstyle"), formats=["png"])
    with Image.open(tmp_path / "out" / "figure-2-states.png") as image:
        assert image.width == 175


@pytest.mark.parametrize(
    "asked",
    [
        {"width_in": 0.0},
        {"width_in": float("nan")},
        {"formats": ["jpeg"]},
        {"formats": [""]},
        {"formats": []},
        {"style": "no such style"},
    ],
    ids=str,
)
def test_a_look_that_cannot_be_is_refused_and_writes_nothing(
    run: Run, tmp_path: Path, asked: dict[str, object]
) -> None:
    with pytest.raises(UserError) as refused:
        report([run], tmp_path / "out", "2", **asked)  # type: ignore[arg-type]
    assert refused.value.code == Code.OPTION
    assert not (tmp_path / "out").exists()


def lines_of(figure: Figure) -> list[Line2D]:
    return [line for axis in figure.axes for line in axis.get_lines()]


def test_a_style_of_colours_alone_keeps_the_line_styles(run: Run) -> None:
    with look(Look(style="grayscale")):
        figure = states([run])
    drawn = [line for line in figure.axes[0].get_lines() if line.get_zorder() >= 2]
    looks = {(str(line.get_color()), str(line._dash_pattern)) for line in drawn}  # type: ignore[attr-defined]
    assert len(looks) == len(run.ids)


def test_a_dark_style_draws_no_line_in_black(run: Run) -> None:
    with look(Look(style="dark_background")):
        figures = [sums([run, run]), gain([run, run])]
        legends = [handle for figure in figures for handle in figure.legends[0].get_lines()]
        shown = [line for figure in figures for line in lines_of(figure)] + legends
    assert not [line for line in shown if to_rgb(line.get_color()) == (0, 0, 0)]


@pytest.mark.parametrize("draw", [sums, cost, gain, slack, draw_estimates])
def test_compared_runs_differ_without_colour(run: Run, draw: Callable[[list[Run]], Figure]) -> None:
    with look():
        figure = draw([run, run])
    markers = [handle.get_marker() for handle in figure.legends[0].get_lines()][:2]
    assert len(set(markers) - {"None", ""}) == 2
    assert set(markers) <= {line.get_marker() for line in lines_of(figure)}


def test_the_markers_of_equal_runs_are_at_different_steps() -> None:
    one, other = (set(marked(30, place, 2)) for place in range(2))
    assert one
    assert other
    assert not one & other


def test_a_gain_of_zero_is_above_the_axis(run: Run) -> None:
    with look():
        assert gain([run]).axes[0].get_ylim()[0] < 0
