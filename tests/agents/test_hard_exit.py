"""A law that calls os._exit: an error of the law that names its line, and no end of the command without a word."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import hedgerow as hg
from hedgerow.agents.loading import LawError
from tests.tools.processes import orchestrator

QUITS = """
import os
from os import _exit
from hedgerow.agents.law import Minimax

class InLearn(Minimax):
    def learn(self, x, flow, x_next):
        os._exit(0)

class ByAnotherName(Minimax):
    def act(self, x):
        _exit(3)

class Late(Minimax):
    def learn(self, x, flow, x_next, sample):
        if sample.t == 20:
            os._exit(7)

class Forks(Minimax):
    def act(self, x):
        if (child := os.fork()) == 0:
            os._exit(7)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        return super().act(x)
"""


@pytest.fixture
def quits(here: Path) -> Path:
    file = here / "quits.py"
    file.write_text(QUITS, encoding="utf-8")
    return file


@pytest.mark.parametrize("law", ["InLearn", "ByAnotherName"])
def test_a_command_names_the_line_and_exits_as_for_any_law_that_fails(law: str, quits: Path) -> None:
    done = orchestrator("simulate", "paper7", "--no-record", f"--law={quits.stem}:{law}")
    assert (done.returncode, "quits.py:" in done.stderr, "os._exit" in done.stderr) == (2, True, True)


def test_a_run_ends_at_the_step_of_the_call_and_keeps_its_rows(quits: Path) -> None:
    done = orchestrator("simulate", "paper7", "--no-record", "--run-dir=run", f"--law={quits.stem}:Late")
    assert done.returncode == 2
    assert hg.load_run(quits.parent / "run").T >= 20


@pytest.mark.usefixtures("quits")
def test_in_python_it_is_a_law_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "_exit", os._exit)  # the guard ends with this test
    with pytest.raises(LawError, match=r"quits\.py:8"):
        hg.simulate("paper7", law="quits:InLearn")


@pytest.mark.usefixtures("quits")
def test_calls_outside_of_a_law_and_in_its_own_children_are_as_before() -> None:
    code = (
        "import hedgerow as hg, os\n"
        "run = hg.simulate('paper7', law='quits:Forks', steps=3)\n"
        "os._exit(9 if run.verdict.verdict == 'valid' else 1)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 9
