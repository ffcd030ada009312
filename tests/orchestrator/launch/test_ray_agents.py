"""Agents on the machines of a Ray cluster: Ray places them and starts them again, and the run is the same to the bit.

The cluster has two machines, which are network namespaces with an address each. So their messages cross a network.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import psutil
import pytest

from hedgerow.orchestrator.launch.ray_agents import share_of
from hedgerow.topologies.errors import Code
from tests.tools.machines import Machines, Program, machines
from tests.tools.processes import Orchestrator, gone, orchestrator, parquet_bytes, run_here
from tests.tools.refusals import refusal
from tests.tools.verdicts import verdict_of

HAVE_RAY = importlib.util.find_spec("ray") is not None
needs_ray = pytest.mark.skipif(not HAVE_RAY, reason="Ray is not installed: pip install 'hedgerow[ray]'")
START = (sys.executable, "-c", "from ray.scripts.scripts import main; main()", "start", "--block")
# Each program of Ray that a machine does without is a second of processor time less.
SMALL = ("--object-store-memory", "80000000", "--include-log-monitor", "false")
HEAD = ("--include-dashboard", "false", "--no-monitor")
ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # A user's token for other clusters is not for ours, which no other program can reach.
    "RAY_AUTH_MODE": "disabled",
    # Ray's server for clients starts processes; gRPC, in between fork and exec, may abort them otherwise.
    "GRPC_ENABLE_FORK_SUPPORT": "0",
    # A worker that starts before a task needs it is not used here.
    "RAY_enable_worker_prestart": "0",
    "RAY_prestart_worker_first_driver": "0",
    # The silence after which Ray counts a machine as gone; by default that takes more than half a minute.
    "RAY_health_check_period_ms": "500",
    "RAY_health_check_timeout_ms": "2000",
    "RAY_health_check_failure_threshold": "2",
}
UP = ("--viewer", "none", "--no-record", "--verify")
START_DEADLINE_S = 120.0


def runs(program: Program) -> None:
    """Wait until a machine of the cluster reports that it runs."""
    by, pause = time.monotonic() + START_DEADLINE_S, Event()
    while "will now block forever" not in (printed := program.log.read_text()):
        assert time.monotonic() < by, printed
        assert program.process.poll() is None, printed
        pause.wait(0.05)


@pytest.fixture(scope="module")
def kept_by_ray() -> Iterator[Path]:
    """Provide the folder of Ray's files; its Unix sockets are below it, and their paths must be short."""
    with tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


@dataclass
class Cluster:
    """Two machines of a cluster, `head` and `other`; and `bench`, outside of the cluster."""

    lab: Machines
    other: Program

    @property
    def address(self) -> dict[str, str]:
        return self.lab.address

    def on(self, name: str) -> tuple[str, ...]:
        return self.lab.on(name)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory, kept_by_ray: Path) -> Iterator[Cluster]:
    """Provide the cluster; `head` has two CPUs, and so has room for the agents of `other`."""
    place = tmp_path_factory.mktemp("ray")
    with ExitStack() as stack:
        head = ("--head", "--port", "6379", "--ray-client-server-port", "10001", "--temp-dir", str(kept_by_ray))
        lab = stack.enter_context(machines("head", "other", "bench"))
        stack.callback(ended, joined(lab, "head", place, "--num-cpus", "2", *head, *HEAD))
        other = joined(lab, "other", place, "--num-cpus", "1", "--address", f"{lab.address['head']}:6379")
        stack.callback(ended, other)
        yield Cluster(lab, other)


def joined(lab: Machines, name: str, place: Path, *how: str) -> Program:
    """A machine's part of the cluster, once it runs."""
    words = (*START, *how, *SMALL, "--node-ip-address", lab.address[name])
    program = Program(lab.on(name), words, place / name, ENVIRONMENT)
    runs(program)
    return program


def ended(program: Program) -> None:
    """End a machine's part of the cluster, unless it has died: SIGTERM ends all of its processes."""
    if program.process.poll() == -signal.SIGKILL:
        return
    assert program.process.poll() is None, program.log.read_text()
    children = {str(one.pid): one.pid for one in psutil.Process(program.process.pid).children(recursive=True)}
    program.process.terminate()
    assert gone(children, START_DEADLINE_S), program.log.read_text()
    program.end()


def cut_off(program: Program) -> None:
    """A machine's part of the cluster dies."""
    own = psutil.Process(program.process.pid)
    everybody = [*own.children(recursive=True), own]
    for one in everybody:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()
    program.end()
    assert gone({str(one.pid): one.pid for one in everybody})


@pytest.fixture
def environment(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)


def events(kind: str) -> list[dict[str, Any]]:
    lines = Path("runs/latest/events.jsonl").read_text().splitlines()
    return [event for event in map(json.loads, lines) if event["event"] == kind]


@needs_ray
@pytest.mark.slow
def test_agents_on_two_machines_of_a_cluster_change_nothing(
    cluster: Cluster, kept_by_ray: Path, environment: None
) -> None:
    """The network is secure; the next test has an open one."""
    arguments = ("paper7", "--processes", "2", "--secure", "--on", "ray://head:10001")
    with Orchestrator("up", *arguments, *UP, inside=cluster.on("bench")) as network:
        assert network.wait() == 0, network.output
        assert network.children.keys() == {"plant"}
    assert verdict_of()["verdict"] == "valid"
    assert verdict_of()["checks"]["reference"]["ok"]
    assert gone({event["process"]: event["pid"] for event in events("placed")})
    assert {event["machine"] for event in events("placed")} == {cluster.address["head"], cluster.address["other"]}
    for shard in range(2):
        log = Path(f"runs/latest/logs/shard-{shard}.log").read_text()
        assert "end: 30 steps answered, 0 messages refused" in log, log
    assert orchestrator("simulate", "paper7", "--run-dir", "local", "--no-record").returncode == 0
    assert parquet_bytes(Path("local")) == parquet_bytes(Path("runs/latest"))
    assert events("start")[0]["endpoint"].startswith("tls/")
    written = [path for path in kept_by_ray.rglob("*") if path.is_file()]
    assert len(written) > 10
    assert [path for path in written if b"PRIVATE KEY" in path.read_bytes()] == []


@needs_ray
@pytest.mark.slow
def test_the_sweep_on_that_cluster_is_the_same_table(cluster: Cluster, environment: None) -> None:
    command = ("sweep", "paper7", "--seeds", "0:6", "--set", "law=minimax,nominal")
    where = ("--out", "there", "--on", "ray://head:10001", "--jobs", "2")
    on = Orchestrator(*command, *where, inside=cluster.on("bench"))
    with on as sweep:
        assert sweep.wait() == 0, sweep.output
    assert orchestrator(*command, "--out", "here").returncode == 0
    assert Path("there/sweep.parquet").read_bytes() == Path("here/sweep.parquet").read_bytes()


@needs_ray
@pytest.mark.slow
def test_ray_restarts_a_killed_agent_and_those_of_a_lost_machine(
    cluster: Cluster, environment: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All processes of the machine are killed at once, Ray's included, without a farewell message.

    This test is the last of the cluster, which then has one machine left.
    """
    monkeypatch.setenv("RAY_ADDRESS", f"{cluster.address['head']}:6379")
    arguments = ("paper7", "--processes", "2", "--steps", "3000", "--rate", "50", "--deadline", "2", "--on", "ray")
    with Orchestrator("up", *arguments, *UP, inside=cluster.on("head")) as network:
        network.wait_for("Ray has placed")
        victim = next(event for event in events("placed") if event["machine"] == cluster.address["head"])
        network.wait_for_log(victim["process"], "ready: shard")  # its log comes through Ray, with a delay
        network.wait_for_event("first_step")  # an agent that dies before is waited for, and never lost
        os.kill(victim["pid"], signal.SIGKILL)
        network.wait_for("going on without shard")
        network.wait_for_event("back")
        assert network.wait_for_event("restarted")["process"] == victim["process"]
        place = {event["process"]: event["machine"] for event in (*events("placed"), *events("restarted"))}
        lost = {process for process, machine in place.items() if machine == cluster.address["other"]}
        assert len(lost) == 1
        assert victim["process"] not in lost
        cut_off(cluster.other)
        network.wait_for_event("back", times=1 + len(lost))
        printed = Program(
            cluster.on("head"), (sys.executable, "-P", "-m", "hedgerow.orchestrator", "rate", "0"), Path("rate")
        )
        assert printed.process.wait() == 0, printed.log.read_text()
        assert network.wait() == 0, network.output
    assert verdict_of()["verdict"] == "valid"
    assert verdict_of()["checks"]["reference"]["ok"]
    assert events("start")[0]["endpoint"].startswith("tcp/")
    first, *rest = events("restarted")
    assert first["process"] == victim["process"]
    assert {event["process"] for event in rest} == lost
    assert {event["machine"] for event in rest} == {cluster.address["head"]}
    assert verdict_of()["restarts"] == 1 + len(lost)
    log = Path(f"runs/latest/logs/{victim['process']}.log").read_text()
    assert log.count("looking for") == 2, log


@needs_ray
@pytest.mark.slow
def test_ctrl_c_leaves_nothing_of_a_cluster_that_we_started(environment: None) -> None:
    with Orchestrator(
        "up", "paper7", "--processes", "1", "--steps", "100000", "--rate", "50", "--on", "ray", *UP
    ) as up:
        up.wait_for("Ray has placed")
        up.wait_for("running: first step")
        started = {str(one.pid): one.pid for one in psutil.Process(up.pid).children(recursive=True)}
        assert len(started) > 4
        up.send(signal.SIGINT)
        assert up.wait() == 3, up.output
        assert gone(started)
    assert verdict_of()["steps_done"] > 0


@needs_ray
def test_a_cluster_that_is_not_there_is_a_mistake_in_words(environment: None) -> None:
    done = orchestrator("up", "paper7", "--on", "ray://127.0.0.1:1")
    assert done.returncode == 2
    printed = "no cluster: Connection refused; is `ray start --head` running there? clients use port 10001"
    assert done.stderr.startswith(f"error: --on ray://127.0.0.1:1: {printed}"), done.stderr
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        (("--on", "mars"), "error: --on mars: is no cluster; write ray, or ray://HOST:PORT"),
        (("--on", "ray://head"), "error: --on ray://head: names no port; write ray://HOST:10001"),
        (("--on", "ray", "--external", "3"), "error: --external --on: choose one; on a cluster, Ray starts all agents"),
    ],
)
def test_an_invalid_cluster_is_refused_at_once(here: Path, arguments: tuple[str, ...], printed: str) -> None:
    done = run_here("up", "paper7", *arguments)
    assert done.returncode == 2
    assert done.stderr == f"{printed}\n"


@pytest.mark.parametrize("command", [("up", "paper7"), ("sweep", "paper7", "--seeds", "0:2")])
def test_without_ray_the_message_names_the_package(
    here: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    (here / "ray.py").write_text("raise ModuleNotFoundError('there is no ray', name='ray')\n")
    monkeypatch.setenv("PYTHONPATH", str(here))
    done = orchestrator(*command, "--on", "ray")
    assert done.returncode == 2
    assert done.stderr == "error: --on ray: Ray is not installed; install it with: pip install 'hedgerow[ray]'\n"


def test_a_machine_of_a_cluster_needs_only_the_packages_of_an_agent() -> None:
    """The module that Ray loads there imports numpy and Zenoh, but no packages of the operator."""
    code = """
import sys
from hedgerow.orchestrator.launch.ray_agents import RemoteAgent
import hedgerow.agents.standalone
print([name for name in ("pydantic", "yaml", "scipy", "pyarrow", "rerun", "rich", "typer") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_every_agent_has_a_cpu_where_there_are_enough_and_else_a_part_of_one() -> None:
    assert share_of(4, 4.0, 2) == 1.0
    for agents, cpus in ((7, [2, 2]), (5, [1, 1, 2]), (38, [2]), (100, [3, 5])):
        share = share_of(agents, float(sum(cpus)), len(cpus))
        assert sum(cpu // share for cpu in cpus) >= agents
    with refusal(Code.OPTION, "--on ray") as refused:
        share_of(1000, 2.0, 2)
    assert share_of(int(str(refused.value).split("--processes ")[1]), 2.0, 2) <= 1.0, "the fix is an option that works"
    with refusal(Code.OPTION, "--on ray"):
        share_of(1, 0.0, 2)
