"""A law that hangs in a run of one process is named with its line, while it hangs."""

from __future__ import annotations

import sys
import threading
import types
from pathlib import Path
from typing import Any

import pytest

from hedgerow.orchestrator.launch import law_watch

LAW = """
class Law:
    def act(self, until):
        return until()  # line 4
    def often(self, until):
        return until()
"""


@pytest.fixture
def law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(law_watch, "SLOW_S", 0.05)
    monkeypatch.setattr(law_watch, "LOOK_EVERY_S", 0.01)
    file = tmp_path / "hanging_law.py"
    file.write_text(LAW)
    module = types.ModuleType("hanging_law")
    monkeypatch.setitem(sys.modules, "hanging_law", module)
    module.__file__ = str(file)
    exec(compile(LAW, str(file), "exec"), vars(module))
    return module.Law


def test_a_call_that_does_not_end_is_named(law: Any) -> None:
    said, heard = list[str](), threading.Event()

    def say(text: str) -> None:
        said.append(text)
        heard.set()

    with law_watch.LawWatch(law, "hanging_law:Law", say):
        assert law().act(lambda: heard.wait(30))
    assert len(said) == 1
    assert "hanging_law.py:4: law hanging_law:Law: " in said[0]


def test_many_short_calls_are_not_one_long_call(law: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(law_watch, "SLOW_S", 1.0)
    said, looks = list[str](), threading.Event()
    with law_watch.LawWatch(law, "hanging_law:Law", said.append):
        for _ in range(60):
            law().often(lambda: looks.wait(0.02))
    assert said == []
