"""A machine without a display, and a viewer that keeps what it receives."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.tools.viewers import Saver


@pytest.fixture
def without_display(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)


@pytest.fixture
def saver(tmp_path: Path) -> Iterator[Saver]:
    saver = Saver(tmp_path / "seen.rrd")
    yield saver
    saver.process.kill()
    saver.process.wait()
