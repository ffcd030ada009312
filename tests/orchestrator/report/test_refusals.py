"""`orchestrator report` refuses some folders, and the page about it lists them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from hedgerow.orchestrator import report as reports
from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.report.figures import FIGURES
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code
from tests.tools import preloaded
from tests.tools.figures import ROOT
from tests.tools.processes import orchestrator
from tests.tools.refusals import refusal


@pytest.mark.parametrize(
    "figures",
    [
        "9",
        "2,",  # a name is missing
        "faults",  # the run has none
    ],
)
def test_a_figure_that_does_not_exist_is_refused(paper: Run, tmp_path: Path, figures: str) -> None:
    with refusal(Code.OPTION, f"--figures {figures}"):
        report([paper], tmp_path / "out", figures)
    assert [*tmp_path.iterdir()] == []


def test_without_matplotlib_the_message_names_the_package(
    paper: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [*sys.modules]:
        if name.partition(".")[0] == "matplotlib" or name.startswith("hedgerow.orchestrator.report."):
            monkeypatch.delitem(sys.modules, name)
    for name in ("figures", "page", "style"):
        monkeypatch.delattr(reports, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with refusal(Code.DEPENDENCY) as refused:
        report([paper], tmp_path / "out")
    assert "pip install matplotlib" in str(refused.value), "the fix is a command"


@pytest.mark.parametrize(("arguments", "at"), [(["nowhere"], "nowhere"), ([], "runs/latest"), (["empty"], "empty")])
def test_a_run_that_does_not_exist_is_refused(here: Path, arguments: list[str], at: str) -> None:
    (here / "empty").mkdir()
    tried = orchestrator("report", *arguments)
    assert (tried.returncode, tried.stdout) == (2, "")
    assert tried.stderr.startswith(f"error: {at}: ")


def test_every_figure_is_in_report_md() -> None:
    text = (ROOT / "docs/report.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \| `([\w-]+)` \|", text, flags=re.MULTILINE)
    assert listed == [(kind.key, kind.file) for kind in FIGURES]


def test_the_pictures_in_the_documents_are_fresh(paper: Run, tmp_path: Path) -> None:
    """docs/make_report_images.py draws the pictures; those in the documents show the same numbers, and are small."""
    program = str(preloaded.SESSION.programs / "program")
    command = [program, str(ROOT / "docs/make_report_images.py"), str(tmp_path), "report-authors7"]
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
