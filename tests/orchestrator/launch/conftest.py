"""A network that runs during a test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.tools.processes import LONG, Orchestrator


@pytest.fixture
def paper7(here: Path) -> Iterator[Orchestrator]:
    """paper7 running for ever, past its first step."""
    with Orchestrator(*LONG) as network:
        network.wait_for("running")
        yield network
