"""`status` names the process of every agent, so that a test or a person can end one."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from tests.tools.processes import Orchestrator, orchestrator


def test_status_has_the_pids_of_the_agents_and_follows_a_restart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    long = ("--steps=100000", "--rate=100", "--viewer=none", "--no-record", "--plain")
    with Orchestrator("up", "paper7", *long) as up:
        up.wait_for("running")
        pids = json.loads(orchestrator("status", "--json").stdout)["pids"]
        assert pids.keys() >= {f"agent-{node}" for node in range(1, 8)}
        assert str(pids["agent-3"]) in orchestrator("status").stdout
        os.kill(pids["agent-3"], signal.SIGKILL)
        up.wait_for("agent 3")
        now = json.loads(orchestrator("status", "--json").stdout)["pids"]
        assert now.get("agent-3") != pids["agent-3"]
        assert now["agent-2"] == pids["agent-2"]
        up.send(signal.SIGINT)
        up.wait()
