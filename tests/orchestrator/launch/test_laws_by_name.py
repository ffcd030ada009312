"""Laws by their names: another law in a run, and laws that fail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hedgerow.orchestrator.runs.reader import load_run
from tests.tools.processes import QUIET, orchestrator
from tests.tools.verdicts import CHECKS, OF_THE_PAPERS_LAW, verdict_of

LAWS = """
import numpy as np
class Idle:
    def __init__(self, b, candidates): self.k = candidates.shape[1]; self.memory = np.zeros((0, self.k))
    def act(self, x): return np.zeros(self.k)
    def learn(self, x, flow, x_next): pass
    def report(self): return np.full((2, self.k), np.nan)
class Undefined(Idle):
    def act(self, x): return x * np.nan
class Tired(Idle):
    def learn(self, x, flow, x_next): raise RuntimeError("I am tired")
class Late(Idle):
    def act(self, x, now):
        if now.t == 19: raise RuntimeError("I am late")
        return np.zeros(self.k)
class Unstable(Idle):
    def act(self, x): return -180 * x
"""


def test_another_law_comes_in_by_its_name(here: Path) -> None:
    """A law that never acts: x_i is its own disturbed a_i, and no claim of the paper's law is made for it."""
    (here / "laws.py").write_text(LAWS)
    done = orchestrator("up", "paper7", *QUIET, "--law", "laws:Idle", "--verify")
    assert done.returncode == 0, done.stdout + done.stderr
    verdict = verdict_of(here / "runs/latest")
    assert set(verdict["checks"]) == CHECKS - OF_THE_PAPERS_LAW | {"reference"}
    assert pq.read_table(here / "runs/latest/telemetry.parquet")["u"].to_numpy(zero_copy_only=False)[0] == 0.0


@pytest.mark.parametrize("command", ["simulate", "up"])
def test_steps_before_a_failure_of_the_law_are_recorded(here: Path, command: str) -> None:
    (here / "laws.py").write_text(LAWS)
    quiet = QUIET if command == "up" else ["--no-record"]
    done = orchestrator(command, "ring6", *quiet, "--law", "laws:Late", "--set", "processes=1")
    assert done.returncode == 2
    why = verdict_of(here / "runs/latest")["reasons"][0]
    assert why.startswith("stopped at step 19: ")
    assert "law laws:Late: act() of nodes 0, 1, 2, 3, 4, 5 raised RuntimeError: I am late" in why
    run = load_run("runs/latest")
    assert run.T == 19
    assert all(np.isfinite(values).all() for values in (run.x, run.u))


@pytest.mark.parametrize(
    ("law", "code", "named"),
    [
        ("no.such:Law", 2, "law no.such:Law: cannot be loaded"),
        ("laws:Missing", 2, "has no attribute 'Missing'"),
        ("laws:LAWS", 2, "law laws:LAWS"),
        ("laws:Undefined", 2, "nan"),
        ("laws:Tired", 2, "I am tired"),
    ],
)
def test_a_failing_law_is_refused_with_its_reason(here: Path, law: str, code: int, named: str) -> None:
    (here / "laws.py").write_text(LAWS + "LAWS = 3\n")
    for command in (("up", "paper7", *QUIET), ("simulate", "paper7", "--no-record")):
        done = orchestrator(*command, "--law", law)
        assert done.returncode == code
        assert named in done.stdout + done.stderr
        assert "Traceback" not in done.stdout + done.stderr
