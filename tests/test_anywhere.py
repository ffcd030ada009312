"""Agents that somebody else starts: they are waited for by name, known by their versions, and taken back when they die.

Each runs as `agent` or `plant` does on another machine, with the file that `orchestrator bundle` wrote and no more.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.processes import DEADLINE_S, Orchestrator, orchestrator, parquet_bytes
from wire.session import open_router

UP = ("--viewer", "none", "--no-record", "--verify")


class Started:
    """A process of a run that `up` did not start."""

    def __init__(self, module: str, *arguments: str) -> None:
        program = f"from {module}.anywhere import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", program, *arguments], stderr=subprocess.PIPE, text=True
        )

    def wait(self) -> tuple[int, str]:
        """Its exit code and its log, once it has ended."""
        _, said = self.process.communicate(timeout=DEADLINE_S)
        return self.process.returncode, said

    def wait_for(self, text: str) -> None:
        """Read its log until that was said."""
        assert self.process.stderr is not None
        assert any(text in line for line in self.process.stderr), text


@pytest.fixture
def start() -> Iterator[Any]:
    """Start agents and plants; those that still run at the end are killed."""
    with contextlib.ExitStack() as stack:

        def one(module: str, *arguments: str) -> Started:
            started = Started(module, *arguments)
            stack.enter_context(started.process)
            stack.callback(started.process.kill)
            return started

        yield one


@pytest.fixture
def endpoint(here: Path) -> str:
    """Where a run is reached: a socket, so that tests never meet on a port."""
    return f"unixsock-stream/{here}/lab.sock"


def bundle(endpoint: str, *arguments: str) -> None:
    done = orchestrator("bundle", "paper7", "--out", "lab", "--router", endpoint, *arguments)
    assert done.returncode == 0, done.stderr


def verdict() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path("runs/latest/verdict.json").read_text())
    return found


def test_two_agents_started_elsewhere_change_nothing(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint)
    agents = [start("agents", "--config", f"lab/agent-{name}.toml") for name in (3, 5)]
    with Orchestrator("up", "paper7", "--external", "3, agent-5", "--listen", endpoint, *UP) as network:
        assert network.wait() == 0, network.output
        assert "waiting for agent-3, agent-5" in network.output
        assert network.children.keys() == {"plant", *(f"agent-{name}" for name in (1, 2, 4, 6, 7))}
    assert verdict()["checks"]["reference"]["ok"]
    assert [agent.wait()[0] for agent in agents] == [0, 0]


def test_everybody_elsewhere_and_only_the_observer_here(here: Path, endpoint: str, start: Any) -> None:
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


def test_one_that_dies_and_is_started_again_goes_on_where_it_would_be(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--steps", "300")
    arguments = ("agents", "--config", "lab/agent-3.toml")
    first = start(*arguments)
    with Orchestrator(
        "up", "paper7", "--steps", "300", "--rate", "100", "--external", "3", "--listen", endpoint, *UP
    ) as network:
        network.wait_for("running")
        second = start(*arguments)
        second.wait_for("agent 3 is there already")
        first.process.send_signal(signal.SIGKILL)
        network.wait_for("going on without agent 3: its process died")
        network.wait_for("agent 3 is back")
        assert network.wait() == 0, network.output
    assert verdict()["verdict"] == "valid"
    assert verdict()["checks"]["reference"]["ok"]
    assert second.wait()[0] == 0


def test_a_planned_crash_of_an_agent_elsewhere_ends_no_process(here: Path, endpoint: str, start: Any) -> None:
    crash = "faults=[{kind: crash, node: 3, at: 5, restart_after: 5}]"
    bundle(endpoint, "--set", crash)
    agent = start("agents", "--config", "lab/agent-3.toml")
    with Orchestrator("up", "paper7", "--set", crash, "--external", "3", "--listen", endpoint, *UP) as network:
        assert network.wait() == 0, network.output
    assert verdict()["checks"]["reference"]["ok"]
    assert agent.wait()[0] == 0


def test_another_release_and_another_network_are_refused_at_both_ends(here: Path, endpoint: str, start: Any) -> None:
    bundle(endpoint, "--seed", "8")
    old = "import wire.handshake as h; h.version = lambda _: '0.0.1'; from agents.anywhere import main; main()"
    with Orchestrator("up", "paper7", "--external", "3", "--listen", endpoint, "--wait", "30", *UP) as network:
        network.wait_for("waiting for agent-3")
        code, said = start("agents", "--config", "lab/agent-3.toml").wait()
        assert code == 2
        assert "the plant refuses agent-3: network " in said
        assert "one `orchestrator bundle` of one file, seed and --set" in said
        done = subprocess.run(
            [sys.executable, "-P", "-c", old, "--config", "lab/agent-3.toml"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2
        assert "hedgerow 0.0.1 there, " in done.stderr
        assert "install the same release on both machines" in done.stderr
        network.wait_for("agent-3 is refused: hedgerow 0.0.1 there, ")
        network.send(signal.SIGINT)
        network.wait()


def test_who_does_not_come_is_named(here: Path, endpoint: str) -> None:
    with Orchestrator("up", "paper7", "--external", "3,5", "--listen", endpoint, "--wait", "2", *UP) as network:
        assert network.wait() == 3, network.output
    assert "agent 3, agent 5 not " in network.output, network.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--external", "9"), "there is no 9; name nodes, `plant` or `all`; the processes are plant, agent-1"),
        (("--external", "3"), "--external: how do they reach us? --listen tcp/0.0.0.0:7447"),
        (("--external", "plant"), "--external plant: say where it is with --router"),
        (("--listen", "tcp/0.0.0.0:7447"), "name them, --external"),
    ],
)
def test_what_cannot_work_is_said_at_once(here: Path, arguments: tuple[str, ...], said: str) -> None:
    done = orchestrator("up", "paper7", *arguments)
    assert done.returncode == 2
    assert said in done.stderr


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "lab.toml: does not say process, namespace, router, network"),
        ("a = ", "lab.toml: is not TOML"),
        ('process = "agent-3"\nnamespace = "h"\nrouter = "tcp/x:1"\nnetwork = "0"\n', "config of agent-3: KeyError"),
        ('process = "plant"\nnamespace = "h"\nrouter = "tcp/x:1"\nnetwork = "0"\n', "start it with `plant`"),
        (None, "lab.toml: No such file or directory; `orchestrator bundle` writes it"),
    ],
)
def test_a_wrong_file_is_a_mistake_and_no_traceback(here: Path, start: Any, text: str | None, said: str) -> None:
    if text is not None:
        Path("lab.toml").write_text(text)
    code, log = start("agents", "--config", "lab.toml").wait()
    assert code == 2, log
    assert said in log
    assert "Traceback" not in log
