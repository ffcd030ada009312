"""Separate agents: the run waits for them by name, checks their versions, and takes them back when they die."""

from __future__ import annotations

import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hedgerow.wire.session import open_router
from tests.tools.processes import DEADLINE_S, Orchestrator, gone, orchestrator, parquet_bytes
from tests.tools.standalone import UP, bundle, endpoint, start
from tests.tools.verdicts import verdict_of

__all__ = ["endpoint", "start"]


def test_two_agents_started_elsewhere_change_nothing(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint)
    agents = [start("agents", "--config", f"lab/agent-{name}.toml") for name in (3, 5)]
    with Orchestrator("up", "paper7", "--external", "3, agent-5", "--listen", endpoint, *UP) as network:
        assert network.wait() == 0, network.output
        assert network.children.keys() == {"plant", *(f"agent-{name}" for name in (1, 2, 4, 6, 7))}
    assert verdict_of()["checks"]["reference"]["ok"]
    assert [agent.wait()[0] for agent in agents] == [0, 0]


def test_all_processes_separate_except_the_observer(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--processes", "2", "--steps", "20")
    with open_router(endpoint):
        with Orchestrator(
            "up",
            "lab/topology.yaml",
            "--external",
            "plant,all",
            "--router",
            endpoint,
            "--namespace",
            "hedgerow/paper7",
            *UP,
        ) as network:
            network.wait_for("waiting for plant, shard-0, shard-1")
            others = [start("plant", "--config", "lab/plant.toml")]
            others += [start("agents", "--config", f"lab/shard-{p}.toml") for p in (0, 1)]
            assert network.wait() == 0, network.output
            assert network.children == {}
        assert [one.wait()[0] for one in others] == [0, 0, 0]
    assert orchestrator("simulate", "lab/topology.yaml", "--run-dir", "here", "--no-record").returncode == 0
    assert parquet_bytes(Path("here")) == parquet_bytes(Path("runs/latest"))


def test_a_restarted_agent_continues_at_the_current_step(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--steps", "300")
    arguments = ("agents", "--config", "lab/agent-3.toml")
    first = start(*arguments)
    with Orchestrator(
        "up", "paper7", "--steps", "300", "--rate", "100", "--external", "3", "--listen", endpoint, *UP
    ) as network:
        network.wait_for("running")
        second = start(*arguments)
        second.wait_for("agent 3 is there already")
        first.send(signal.SIGKILL)
        network.wait_for("going on without agent 3: its process died")
        network.wait_for("agent 3 is back")
        assert network.wait() == 0, network.output
    assert verdict_of()["verdict"] == "valid"
    assert verdict_of()["checks"]["reference"]["ok"]
    assert second.wait()[0] == 0


def test_a_planned_crash_of_an_agent_elsewhere_ends_no_process(here: Path, endpoint: str, start: Any) -> None:
    crash = "faults=[{kind: crash, node: 3, at: 5, restart_after: 5}]"
    bundle(endpoint, "--set", crash)
    agent = start("agents", "--config", "lab/agent-3.toml")
    with Orchestrator("up", "paper7", "--set", crash, "--external", "3", "--listen", endpoint, *UP) as network:
        assert network.wait() == 0, network.output
    assert verdict_of()["checks"]["reference"]["ok"]
    assert agent.wait()[0] == 0


def test_another_release_and_another_network_are_refused_at_both_ends(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--seed", "8")
    old = (
        "import hedgerow.wire.handshake as h; h.release = lambda _: '0.0.1';"
        "from hedgerow.agents.standalone import main; main()"
    )
    with Orchestrator("up", "paper7", "--external", "3", "--listen", endpoint, "--wait", "30", *UP) as network:
        network.wait_for("waiting for agent-3")
        code, printed = start("agents", "--config", "lab/agent-3.toml").wait()
        assert code == 2
        assert "agent-3: network " in printed
        assert "`orchestrator bundle`" in printed, "the fix is a command"
        done = subprocess.run(
            [sys.executable, "-P", "-c", old, "--config", "lab/agent-3.toml"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2
        assert "hedgerow 0.0.1" in done.stderr
        network.wait_for("agent 3 is refused: hedgerow 0.0.1 there, ")
        network.send(signal.SIGINT)
        network.wait()


def test_an_agent_that_a_killed_run_left_behind_makes_room_for_the_next(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--steps", "300")
    command = ("up", "lab/topology.yaml", "--external", "3", "--listen", endpoint, *UP)
    left_behind = start("agents", "--config", "lab/agent-3.toml")
    with Orchestrator(*command, "--rate", "5") as network:
        network.wait_for("running")
        children = network.children
        network.send(signal.SIGKILL)
        network.wait()
    assert gone(children)
    with Orchestrator(*command) as network:
        code = left_behind.wait()[0]
        assert code == 3
        again = start("agents", "--config", "lab/agent-3.toml")
        assert network.wait() == 0, network.output
        assert again.wait()[0] == 0
    assert verdict_of()["verdict"] == "valid"
    assert verdict_of()["checks"]["reference"]["ok"]


def test_an_agent_that_waits_at_the_end_of_a_run_does_not_join_the_next(here: Path, endpoint: str, start: Any) -> None:
    def up(seed: int) -> Orchestrator:
        bundle(endpoint, "--seed", str(seed))
        return Orchestrator("up", "lab/topology.yaml", "--external", "3,5", "--listen", endpoint, *UP)

    with up(1) as network:
        of_seed_1 = start("agents", "--config", "lab/agent-3.toml")
        of_seed_1.wait_for("has its place")
        network.send(signal.SIGINT)
        network.wait()
    shutil.rmtree("lab")
    with up(2) as network:
        others = [start("agents", "--config", f"lab/agent-{name}.toml") for name in (5, 3)]
        assert network.wait() == 0, network.output
        assert [one.wait()[0] for one in others] == [0, 0]
    # It was refused; or, where that run was over before it asked, it waits for the next.
    of_seed_1.send(signal.SIGTERM)
    assert "ready" not in of_seed_1.wait()[1]
    assert verdict_of()["checks"]["reference"]["ok"]


def test_one_of_two_agents_for_one_place_gets_it(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint)
    with Orchestrator("up", "lab/topology.yaml", "--external", "3,5", "--listen", endpoint, *UP) as network:
        twice = [start("agents", "--config", "lab/agent-3.toml") for _ in range(2)]
        network.wait_for("waiting for agent-3")
        for one in twice:
            one.wait_for("looking for")
        five = start("agents", "--config", "lab/agent-5.toml")
        assert network.wait() == 0, network.output
        assert five.wait()[0] == 0
    assert verdict_of()["verdict"] == "valid"
    assert verdict_of()["checks"]["information"]["ok"], "every received message was sent"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_a_plant_that_must_end_sends_end_to_all(here: Path, endpoint: str, start: Any, number: int) -> None:
    bundle(endpoint, "--processes", "2", "--steps", "100000")
    up = ("up", "lab/topology.yaml", "--external", "plant,all", "--router", endpoint, "--namespace", "hedgerow/paper7")
    with open_router(endpoint), Orchestrator(*up, "--viewer", "none", "--no-record") as network:
        plant = start("plant", "--config", "lab/plant.toml", "--rate", "20")
        agents = [start("agents", "--config", f"lab/shard-{p}.toml") for p in (0, 1)]
        network.wait_for("running")
        plant.send(number)
        assert network.wait() == 3, network.output
        assert [one.wait()[0] for one in (plant, *agents)] == [0, 0, 0]
    assert re.search(r"unknown \(stopped at step [1-9][0-9]*: stopped on request\)", network.output), network.output


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["int", "term"])
@pytest.mark.parametrize(("module", "config"), [("agents", "agent-1"), ("plant", "plant")])
def test_a_process_that_waits_for_a_router_ends_on_request(
    here: Path, start: Any, module: str, config: str, number: int, code: int
) -> None:
    """Another program has the port, and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as mute:
        mute.settimeout(DEADLINE_S)
        bundle(f"tcp/127.0.0.1:{mute.getsockname()[1]}")
        waiting = start(module, "--config", f"lab/{config}.toml")
        waiting.wait_for("looking for")
        connection, _ = mute.accept()
        with connection:
            waiting.send(number)
            assert waiting.wait()[0] == code


def test_a_missing_process_is_named(here: Path, endpoint: str) -> None:
    with Orchestrator("up", "paper7", "--external", "3,5", "--listen", endpoint, "--wait", "2", *UP) as network:
        assert network.wait() == 3, network.output
    assert "agent 3, agent 5" in network.output
