"""Every change to agents, plant or network is found and named, or has no effect."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.tools import tampering
from tests.tools.processes import DEADLINE_S, orchestrator
from tests.tools.tampering import ALL, Tampering
from tests.tools.watched_network import FORGETFUL, SILENT, UNLEARNING, WATCHED


def verdict_of(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))
    return content


def test_the_untampered_run_is_valid() -> None:
    for topology in (WATCHED, FORGETFUL, SILENT, *UNLEARNING):
        content = Tampering("", "", topology=topology).verdict().content
        assert content["verdict"] == "valid", content["reasons"]
        assert content["checks"]["law"]["steps"] == 30


@pytest.mark.parametrize("change", ALL, ids=lambda change: change.name)
def test_a_change_is_found_or_changes_nothing(change: Tampering) -> None:
    """INVALID with the node and the step, unknown with its cause, or valid with equal tables."""
    content = change.verdict().content
    failed = [check for check in content["checks"].values() if not check["ok"]]
    if content["verdict"] == "valid":
        assert change.run().same_bits(Tampering("", "", topology=change.topology).run())
    elif content["verdict"] == "unknown":
        assert (content["reasons"], failed) != ([], [])
    else:
        named = [check for check in failed if check.get("why")]
        assert named, content["reasons"]
        assert all(check["step"] is not None for check in named)
        assert change.rows is tampering.twice or all(check["node"] is not None for check in named)
    json.dumps(content, allow_nan=False)


def test_the_table_of_the_page_agrees_with_the_verdicts() -> None:
    """Written by `python -m tests.tools.tampering --write`."""
    assert tampering.written() == tampering.table()


TWO_FACED = """
import threading
from hedgerow.agents.law import Minimax

class TwoFaced(Minimax):
    "Scales its inputs wherever the observer does not run it."
    def act(self, x):
        honest = threading.current_thread().name == "replay"
        return super().act(x) * (1.0 if honest else 1.0 + 1e-9)
"""


def test_agents_that_run_another_law_than_the_file_names(here: Path) -> None:
    """There are seven processes over Zenoh, with other code than the observer loads by that name."""
    (here / "two_faced.py").write_text(TWO_FACED)
    done = orchestrator(
        "up", "paper7", "--law", "two_faced:TwoFaced", "--no-record", "--viewer", "none", "--run-dir", "run"
    )
    check = verdict_of(here / "run")["checks"]["law"]
    assert (done.returncode, check["ok"], check["step"], check["node"]) == (1, False, 0, 1)


IMMORTAL = """
from hedgerow.orchestrator.__main__ import main
from hedgerow.orchestrator.launch.supervisor import Processes

def kill(self, shard, life, restart):
    "Claim that the process has ended, and leave it alone."
    _, agent = self._agent(shard)
    agent.killed, agent.alive, agent.reported, agent.again = True, False, False, False

Processes.kill = kill
main()
"""


def test_a_crash_without_a_death(here: Path) -> None:
    """The supervisor reports to the plant a death that did not happen."""
    faults = "faults=[{kind: crash, node: 3, at: 10}]"
    command = [sys.executable, "-P", "-c", IMMORTAL, "up", "paper7", "--no-record", "--viewer", "none"]
    done = subprocess.run(
        [*command, "--run-dir", "run", "--set", faults], capture_output=True, timeout=DEADLINE_S, check=False
    )
    content = verdict_of(here / "run")
    check = content["checks"]["deaths"]
    assert (done.returncode, check["ok"], check["step"], check["node"]) == (1, False, 10, 3)
    assert content["checks"]["law"]["ok"]


def test_processes_that_die_as_their_faults_say(here: Path) -> None:
    """An agent that crashes twice, and one that begins dead."""
    faults = "faults=[{kind: crash, node: 3, at: 5, restart_after: 2}, {kind: crash, node: 3, at: 20}"
    done = orchestrator(
        "up", "paper7", "--no-record", "--viewer", "none", "--run-dir", "run",
        "--set", f"{faults}, {{kind: crash, node: 5, at: 0, restart_after: 4}}]",
    )  # fmt: skip
    content = verdict_of(here / "run")
    assert (done.returncode, content["checks"]["deaths"]["ok"]) == (0, True), content["reasons"]
    assert content["checks"]["law"]["steps"] == 30
