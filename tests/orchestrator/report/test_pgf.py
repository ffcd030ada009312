"""The format pgf: LaTeX reads the figure, and the file is the same on every computer."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import matplotlib as mpl
import pytest

from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.runs.run import Run

DOCUMENT = r"\documentclass{article}\usepackage{pgf}\begin{document}\input{gain.pgf}\end{document}"


@pytest.mark.skipif(shutil.which("xelatex") is None, reason="LaTeX is not installed")
def test_latex_reads_a_figure(paper: Run, tmp_path: Path) -> None:
    out = tmp_path / "report"
    report([paper], out, figures="gain", formats=["pgf"])
    drawn = (out / "gain.pgf").read_text(encoding="utf-8")
    assert mpl.get_data_path() not in drawn
    assert not re.search(r"\\setmainfont\{STIXGeneral\}", drawn)
    (out / "paper.tex").write_text(DOCUMENT, encoding="utf-8")
    command = ["xelatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    made = subprocess.run(command, cwd=out, capture_output=True, text=True, check=False, timeout=120)
    assert made.returncode == 0, made.stdout[-2000:]
