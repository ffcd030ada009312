"""Ctrl-C, signals and a killed `up`: the run ends, nothing of it remains, and its steps are recorded."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import pytest

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.orchestrator.launch.options import Options
from hedgerow.orchestrator.launch.up import Network
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.processes import LONG, Orchestrator, gone, orchestrator
from tests.tools.verdicts import verdict_of


def test_ctrl_c_ends_cleanly_with_the_recorded_steps(here: Path, paper7: Orchestrator) -> None:
    paper7.send(signal.SIGINT)
    assert paper7.wait() == 3
    assert "Ctrl-C" in paper7.output
    folder = here / "runs/latest"
    verdict = verdict_of(folder)
    assert verdict["verdict"] == "unknown"
    assert pq.read_metadata(folder / "telemetry.parquet").num_rows == 7 * (verdict["steps_done"] + 1)
    assert not list(folder.glob("*.sock*"))
    assert gone(paper7.children)


def test_a_signal_after_the_last_word_changes_nothing(here: Path) -> None:
    """All files are written, and only the end of the processes remains: a signal has no more effect."""
    topology = resolve(load("paper7"), here)
    options, shards = Options(watching=Watching(record=False)), layout(topology, 2)
    heard: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: heard.append(number))
    try:
        with contextlib.ExitStack() as stack:
            fork_client = stack.enter_context(contextlib.closing(ForkClient()))
            stack.callback(signal.raise_signal, signal.SIGTERM)
            network = Network(topology, create(topology, None), shards, options, Quiet(), fork_client, time.monotonic())
            verdict = network.run(at_last=stack)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert verdict.content["verdict"] == "valid", verdict.content
    assert heard == []


def test_ctrl_c_twice_ends_at_once_even_with_a_frozen_plant(here: Path, paper7: Orchestrator) -> None:
    os.kill(paper7.children["plant"], signal.SIGSTOP)
    paper7.send(signal.SIGINT)
    paper7.wait_for_event("stopping")
    paper7.send(signal.SIGINT)
    assert paper7.wait() == 3
    assert "a second Ctrl-C" in paper7.output
    assert gone(paper7.children)
    assert (here / "runs/latest/telemetry.parquet").exists()


def test_sigkill_of_up_leaves_no_process(here: Path, paper7: Orchestrator) -> None:
    paper7.wait_for("\nstep ")
    children = paper7.children
    paper7.send(signal.SIGKILL)
    assert paper7.wait() == -signal.SIGKILL
    assert gone(children)
    assert {path.name for path in (here / "runs/latest").iterdir()} == {
        "topology.yaml", "telemetry.arrows", "edges.arrows", "summary.arrows", "round_trips.arrows",
        "events.jsonl", "logs", "processes",
    }  # fmt: skip
    assert orchestrator("ps").stdout == "no network is running\n"


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Provide a folder for temporary files of the test, with a path short enough for a socket."""
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("TMPDIR", folder)
        yield Path(folder)


def test_a_look_for_networks_removes_the_sockets_of_dead_ones(
    here: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The path of the run's folder is too long for a socket; `up`, its fork server and the plant are killed at once."""
    deep = here / ("d" * 100)
    deep.mkdir()
    monkeypatch.chdir(deep)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))
    with Orchestrator(*LONG) as network:
        network.wait_for("running")
        assert gone(network.kill_all_who_could_clean_up())
    assert list(temporary.glob("hedgerow-*/router.sock"))
    assert orchestrator("ps").stdout == "no network is running\n"
    assert not list(temporary.glob("hedgerow-*"))


def end(listed: list[dict[str, Any]]) -> None:
    for entry in listed:
        with contextlib.suppress(ProcessLookupError):
            os.kill(entry["pid"], signal.SIGKILL)


def test_ps_status_and_stop_see_a_detached_network(here: Path, request: pytest.FixtureRequest) -> None:
    started = orchestrator(*LONG, "--detach")
    assert started.returncode == 0, started.stdout
    listed = json.loads(orchestrator("ps", "--json").stdout)
    request.addfinalizer(lambda: end(listed))
    assert [entry["folder"] for entry in listed] == [str((here / "runs/latest").resolve())]
    status = json.loads(orchestrator("status", "--json").stdout)
    assert status["steps"] == 1000000
    assert status["step"] > 0
    stopped = orchestrator("stop", listed[0]["run"])
    assert stopped.returncode == 0, stopped.stderr
    assert orchestrator("ps").stdout == "no network is running\n"
    assert gone({"up": listed[0]["pid"]})
    assert "stopped on request" in verdict_of(here / "runs/latest")["reasons"][0]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_before_the_first_step_ends_a_detached_run(here: Path, number: int, code: int) -> None:
    with Orchestrator(*LONG, "--detach") as starting:
        starting.wait_for("paper7: 7 nodes")
        command = psutil.Process(starting.pid)
        # The other child relays standard error, with the words of its parent.
        (network,) = [one for one in command.children() if one.cmdline() != command.cmdline()]
        starting.send(number)
        assert starting.wait() == code, starting.output
        assert gone({"up": network.pid})
    assert orchestrator("ps").stdout == "no network is running\n"
