"""The files of a report: formats, fonts, the same bytes, and whole or none."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.report.figures import FIGURES
from hedgerow.orchestrator.report.style import save_and_embed
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code
from tests.tools.figures import DRAWN
from tests.tools.refusals import refusal


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


@pytest.mark.usefixtures("quick")
def test_existing_files_are_replaced_only_on_request(paper: Run, tmp_path: Path) -> None:
    """Foreign files are never replaced."""
    out = tmp_path / "deep" / "out"
    report([paper], out, "2")
    with refusal(Code.OUTPUT):
        report([paper], out, "4")
    (out / "report.html").write_text("old", encoding="utf-8")
    report([paper], out, "4", force=True)
    assert "Figure 4" in (out / "report.html").read_text(encoding="utf-8")
    (out / "thesis.tex").touch()
    with refusal(Code.OUTPUT):
        report([paper], out, "4", force=True)
    with refusal(Code.OUTPUT):
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
        return save_and_embed(figure, folder, name, title, formats)

    monkeypatch.setattr("hedgerow.orchestrator.report.style.save_and_embed", full)
    with refusal(Code.OUTPUT):
        report([paper], out, "cost,gain", force=True)
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "report.html"]
    assert (out / "report.html").read_text(encoding="utf-8") == "old"
