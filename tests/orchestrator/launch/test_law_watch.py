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
    monkeypatch.setattr(law_watch, "REPORT_AFTER_S", 0.05)
    monkeypatch.setattr(law_watch, "LOOK_EVERY_S", 0.01)
    file = tmp_path / "hanging_law.py"
    file.write_text(LAW)
    module = types.ModuleType("hanging_law")
    monkeypatch.setitem(sys.modules, "hanging_law", module)
    module.__file__ = str(file)
    exec(compile(LAW, str(file), "exec"), vars(module))
    return module.Law


def test_a_call_that_does_not_end_is_named(law: Any) -> None:
    messages, heard = list[str](), threading.Event()

    def say(text: str) -> None:
        messages.append(text)
        heard.set()

    with law_watch.LawWatch(law, "hanging_law:Law", say):
        assert law().act(lambda: heard.wait(30))
    assert len(messages) == 1
    assert "hanging_law.py:4: law hanging_law:Law: " in messages[0]


def test_many_short_calls_are_not_one_long_call(law: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(law_watch, "REPORT_AFTER_S", 1.0)
    messages, looks = list[str](), threading.Event()
    with law_watch.LawWatch(law, "hanging_law:Law", messages.append):
        for _ in range(60):
            law().often(lambda: looks.wait(0.02))
    assert messages == []
