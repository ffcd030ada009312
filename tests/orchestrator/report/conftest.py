"""The fixtures of these tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.figures import ROOT, ran


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="session")
def paper(folder: Path) -> Run:
    return ran(resolve(load("paper7")), folder / "paper")


@pytest.fixture(scope="session")
def fixed(folder: Path) -> Run:
    return ran(resolve(load("paper7", ["law=nominal"])), folder / "fixed")


@pytest.fixture(scope="session")
def faulty(folder: Path) -> Run:
    return ran(resolve(load(str(ROOT / "docs/examples/faulty.yaml"))), folder / "faulty")


@pytest.fixture(scope="session")
def grid(folder: Path) -> Run:
    return ran(resolve(load("grid16")), folder / "grid")


@pytest.fixture(scope="session")
def written(paper: Run, folder: Path) -> dict[str, Path]:
    """All of the report of `paper`."""
    return {path.name: path for path in report([paper], folder / "paper-report")}


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures take time only if they are wanted."""
    monkeypatch.setattr("hedgerow.orchestrator.report.style.save_and_embed", lambda *_: b"<svg/>")
