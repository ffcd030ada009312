"""The fixtures of these tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.orchestrator.runs.run import Run
from tests.tools.recorded import NETWORKS, ran


@pytest.fixture(scope="session", params=NETWORKS)
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of each of the networks."""
    return ran(NETWORKS[request.param](), tmp_path_factory.mktemp("runs") / request.param)


@pytest.fixture
def paper7(here: Path) -> Run:
    return ran(NETWORKS["paper7"](), here / "paper7")
