"""The gallery shows what its command prints: every number of the page, and its pictures."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.fuzz import ROOT
from tests.tools.importing import needs

PAGE = ROOT / "docs" / "gallery.md"


def test_every_picture_of_the_gallery_is_there() -> None:
    named = [line.split("](")[1].rstrip(")") for line in PAGE.read_text().splitlines() if line.startswith("![")]
    assert len(named) == 3
    assert all((PAGE.parent / name).stat().st_size > 10_000 for name in named)


@pytest.mark.slow
@pytest.mark.parametrize("package", ["wntr", "topohub", "pandapower"])
def test_the_command_of_the_gallery_prints_the_numbers_of_the_page(package: str, tmp_path: Path) -> None:
    needs(package)
    command = [sys.executable, str(PAGE.parent / "make_gallery.py"), str(tmp_path), package]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    header, row = done.stdout.splitlines()
    page = PAGE.read_text().splitlines()
    assert header in page
    assert row in page
    assert [picture.stat().st_size > 10_000 for picture in tmp_path.iterdir()] == [True]
