"""The look of a report's figures: their width, the user's style on top, and the formats of the files."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from PIL import Image

from hedgerow.orchestrator.report import report
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
