"""Agents and plants that are killed or frozen: the run continues, waits or ends, and names the process."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from hedgerow.orchestrator.launch.live import Live
from tests.tools.processes import LONG, QUIET, Orchestrator, gone, orchestrator, parquet_bytes
from tests.tools.verdicts import verdict_of

SHORT = ("up", "paper7", "--steps", "600", "--rate", "100", *QUIET, "--verify")
"""a run that lasts until its processes are back; `hurry` ends it sooner"""


def hurry() -> None:
    """Make the remaining steps as fast as possible."""
    with Live() as live:
        live.rate(0)


def repeats_from_its_folder(here: Path) -> bool:
    """Return True if the run's folder, with all changes during the run, gives the same tables again."""
    folder = here / "runs/latest"
    done = orchestrator("simulate", str(folder), "--run-dir", "again", "--no-record")
    assert done.returncode == 0, done.stdout + done.stderr
    return parquet_bytes(here / "again") == parquet_bytes(folder)


def test_a_killed_agent_returns_with_its_knowledge(here: Path) -> None:
    """The trajectory is the same as with a crash in the file, and the estimates continue as without a crash."""
    with Orchestrator(*SHORT) as network:
        network.wait_for("running")
        os.kill(network.children["agent-4"], signal.SIGKILL)
        network.wait_for_event("back")
        hurry()
        assert network.wait() == 0, network.output
        assert [network.wait_for_event(kind)["who"] for kind in ("lost", "back")] == ["agent 4"] * 2
        assert gone(network.children)
    assert verdict_of(here / "runs/latest")["restarts"] == 1
    assert repeats_from_its_folder(here)


def test_an_agent_that_dies_repeatedly_stays_down_and_the_run_continues(here: Path) -> None:
    with Orchestrator(*LONG) as network:
        network.wait_for("running")
        network.kill_until_it_stays_down("agent-4")
        step = network.wait_for_event("lost")["step"]
        network.wait_for_step(step + 50)
        network.send(signal.SIGINT)
        assert network.wait() == 3
    assert any("agent-4 was killed by SIGKILL" in reason for reason in verdict_of(here / "runs/latest")["reasons"])


def test_an_agent_that_stays_down_before_the_first_step_ends_the_run_with_its_name(here: Path) -> None:
    """agent-3 was never started, and is not the cause."""
    where = ("--external", "3", "--listen", f"unixsock-stream/{here}/lab.sock")
    with Orchestrator("up", "paper7", *QUIET, *where) as network:
        network.wait_for_event("start")
        network.kill_until_it_stays_down("agent-4")
        assert network.wait() == 3
    assert "agent-4 was killed by SIGKILL" in str(verdict_of(here / "runs/latest")["reasons"])
    assert "agent-3" not in str(verdict_of(here / "runs/latest")["reasons"])


def test_a_network_without_agents_waits_for_them(here: Path) -> None:
    """One process runs all agents: when it dies, the plant does not continue without control."""
    with Orchestrator(*SHORT, "--processes", "1") as network:
        network.wait_for("running")
        os.kill(network.children["shard-0"], signal.SIGKILL)
        network.wait_for_event("back")
        hurry()
        assert network.wait() == 0, network.output
        lost, back = (network.wait_for_event(kind) for kind in ("lost", "back"))
    assert back["at"] - lost["step"] <= 2
    assert repeats_from_its_folder(here)


def test_all_agents_killed_at_once_come_back(here: Path) -> None:
    with Orchestrator(*SHORT) as network:
        network.wait_for("running")
        for name, pid in network.children.items():
            if name != "plant":
                os.kill(pid, signal.SIGKILL)
        network.wait_for_event("restarted", times=7)
        hurry()
        assert network.wait() == 0, network.output
    assert verdict_of(here / "runs/latest")["restarts"] == 7
    assert repeats_from_its_folder(here)


def test_a_killed_plant_is_named(here: Path, paper7: Orchestrator) -> None:
    os.kill(paper7.children["plant"], signal.SIGKILL)
    assert paper7.wait() == 3
    assert "plant was killed by SIGKILL" in str(verdict_of(here / "runs/latest")["reasons"])
    assert gone(paper7.children)


def test_a_run_continues_without_a_frozen_agent_and_takes_it_back(here: Path) -> None:
    with Orchestrator(*SHORT, "--deadline", "1") as network:
        network.wait_for("running")
        os.kill(network.children["agent-4"], signal.SIGSTOP)
        network.wait_for("no input from agent 4 (alive: yes) for ")
        os.kill(network.children["agent-4"], signal.SIGCONT)
        network.wait_for("agent 4 is back")
        hurry()
        assert network.wait() == 0, network.output
    assert repeats_from_its_folder(here)


def test_a_network_with_silent_agents_ends_with_their_names(here: Path) -> None:
    with Orchestrator(*LONG, "--deadline", "1", "--processes", "2") as network:
        network.wait_for("running")
        assert orchestrator("pause").returncode == 0  # otherwise one of them would be late a step before the other
        for name in ("shard-0", "shard-1"):
            os.kill(network.children[name], signal.SIGSTOP)
        assert orchestrator("resume").returncode == 0
        assert network.wait() == 3
        assert "no input from shard 0 of agents 1, 2, 3, 4 (alive: yes), shard 1 of agents 5, 6, 7" in network.output
