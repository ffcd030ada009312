"""Laws that fail in a run: the line of the law on screen, its traceback in a log, and exit code 2."""

from __future__ import annotations

from pathlib import Path

import pytest

import hedgerow as hg
from hedgerow.agents.loading import LawError
from hedgerow.topologies.errors import Exit
from tests.tools.processes import orchestrator

LAWS = """
import time
import numpy as np
from hedgerow.agents.law import Minimax

class Late(Minimax):
    def act(self, x):
        if (np.abs(x) > 40).any():
            raise ValueError("too\\nfar")  # line 9
        return super().act(x)

class Hangs(Minimax):
    def act(self, x):
        while (np.abs(x) > 40).any():
            time.sleep(0.01)
        return super().act(x)

class AlwaysHangs(Minimax):
    def act(self, x):
        while x is not None:
            time.sleep(0.01)
"""
FAR = "defaults.disturbance={kind: constant, value: 12}"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "failing_laws.py").write_text(LAWS)
    return tmp_path


def test_a_law_that_raises_is_raised_in_python_with_its_cause(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(here)
    with pytest.raises(LawError) as failed:
        hg.simulate("paper7", law="failing_laws:Late", defaults={"disturbance": {"kind": "constant", "value": 12}})
    assert isinstance(failed.value.__cause__, ValueError)
    assert failed.value.method == "act"
    assert "failing_laws.py:9: " in str(failed.value)
    assert hg.load_run("latest").T > 0


@pytest.mark.parametrize("command", ["simulate", pytest.param("up", marks=pytest.mark.slow)])
def test_a_law_that_raises_ends_the_run_with_exit_code_2_and_its_line(here: Path, command: str) -> None:
    quiet = ["--no-record", "--viewer=none"]
    done = orchestrator(command, "paper7", "--law=failing_laws:Late", f"--set={FAR}", *quiet)
    assert done.returncode == Exit.USER_MISTAKE, done.stdout + done.stderr
    assert "failing_laws.py:9: law failing_laws:Late: act()" in done.stdout
    logs = "".join(log.read_text() for log in (here / "runs" / "latest" / "logs").iterdir())
    assert "Traceback" in logs
    assert 'raise ValueError("too' in logs


@pytest.mark.slow
def test_the_deadline_names_the_line_of_a_law_that_hangs(here: Path) -> None:
    done = orchestrator(
        *("up", "paper7", "--law=failing_laws:Hangs", f"--set={FAR}", "--steps=8", "--processes=1"),
        *("--deadline=3", "--no-record", "--viewer=none"),
    )
    assert done.returncode == Exit.UNKNOWN, done.stdout + done.stderr
    assert "failing_laws:Hangs" in done.stdout
    assert "failing_laws.py:1" in done.stdout


def test_a_law_that_never_answers_is_refused_before_the_run(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(here)
    monkeypatch.setattr("hedgerow.orchestrator.ground.laws.CALL_DEADLINE_S", 0.5)
    with pytest.raises(LawError) as refused:
        hg.simulate("paper7", law="failing_laws:AlwaysHangs")
    assert "failing_laws.py:2" in str(refused.value)
    assert not (here / "runs").exists()
