"""A law on its neighbours' states, in seven processes with lost messages, has the bits of one process."""

from __future__ import annotations

from pathlib import Path

import pytest

import hedgerow as hg
from tests.tools.processes import orchestrator

LAW = """
from hedgerow.agents.law import Minimax
import numpy as np


class Consensus(Minimax):
    def __init__(self, b, candidates, *, share: float = 0.2, local):
        super().__init__(b, candidates)
        self.share, self.local = share, local

    def act(self, x, now):
        apart = np.nan_to_num(now.x - x[self.local.node])
        return super().act(x + self.share * self.local.sums(self.local.weight * apart))
"""
FAULTS = "faults=[{kind: drop, link: [2, 4], probability: 0.4}, {kind: drop, link: [1, 2], probability: 0.2}]"


@pytest.mark.parametrize("processes", ["7", "3"])
def test_a_consensus_law_over_processes_with_drops_is_verified(
    processes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "consensus_law.py").write_text(LAW)
    words = ("--law", "consensus_law:Consensus(share=0.1)", "--set", FAULTS, "--set", "steps=60")
    options = ("--processes", processes, "--viewer", "none", "--no-record", "--run-dir", "run", "--verify")
    done = orchestrator("up", "paper7", *words, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    run = hg.load_run("run")
    assert run.verdict.content["checks"]["reference"]["ok"]
    assert run.verdict.content["lost_messages"] > 10
    assert run.u.tolist() != hg.simulate("paper7", FAULTS, steps=60).u.tolist()
