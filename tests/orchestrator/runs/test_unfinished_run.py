"""Runs that are still in progress, were interrupted or killed, or lost telemetry."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat

from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.verdict import Ending
from hedgerow.orchestrator.runs.export import NAMES, arrays, export
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.runs.writer import Recorder, to_parquet
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.schema import Topology
from tests.tools import networks
from tests.tools.networks import Trajectory, observe
from tests.tools.processes import DEADLINE_S, Orchestrator
from tests.tools.recorded import NETWORKS, assert_as_live, same


@pytest.fixture
def lively(here: Path) -> Iterator[Orchestrator]:
    """paper7 over Zenoh, running for ever, past its first steps; node 4 may become another."""
    network = ("paper7", "--set", "nodes.4={a: 0.6, candidates: [0.3, 0.6]}", "--steps", "1000000", "--rate", "200")
    with Orchestrator("up", *network, "--viewer", "none", "--no-record") as up:
        up.wait_for("running")
        come_to(20)
        yield up


def come_to(step: int) -> Run:
    """Return the latest run, once this step is recorded."""
    by, pause = time.monotonic() + DEADLINE_S, threading.Event()
    while time.monotonic() < by:
        with contextlib.suppress(UserError):  # not a step yet
            if step <= (run := load_run()).T:
                return run
        pause.wait(0.02)
    raise AssertionError(f"no step {step} after {DEADLINE_S:g} s")


def continues(before: Run, after: Run) -> bool:
    """Return True if a later reading of a run has the same steps, and more."""
    states = ("x", "x_oracle", "x_nominal", "regret", "regret_sum")
    assert before.T <= after.T
    return all(
        same(getattr(before, name), getattr(after, name)[: before.T + (name in states)])
        for name in (*states, "u", "w", "ahat", "index", "a", "a_ls", "cost", "gain", "u_edge", "edge_open", "i_hears")
    )


def test_a_run_that_continues_and_then_is_killed(lively: Orchestrator, here: Path) -> None:
    """The run is read while it grows, and after its end: earlier numbers do not change, and the twins continue from
    them.
    """
    running = load_run("paper7")
    assert (running.verdict.content, running.events[0]["event"]) == ({}, "start")
    (file,) = export(running, "npz")
    with np.load(file) as exported:
        assert (exported["T"], exported["verdict"]) == (running.T, "")
        assert same(exported["x"], running.x)
    come_to(running.T + 50)
    lively.send(signal.SIGKILL)
    assert lively.wait() == -signal.SIGKILL
    killed = load_run()
    assert (killed.folder / "telemetry.arrows").exists()
    assert killed.T >= running.T + 50
    assert (killed.verdict.content, len(killed.x), len(killed.u)) == ({}, killed.T + 1, killed.T)
    assert continues(running, killed)
    again = networks.simulate(killed.topology.model_copy(update={"steps": killed.T}))
    observer, live = observe(killed.topology, again)
    assert_as_live(killed, live, observer)
    assert len(killed.telemetry()) in (7 * (killed.T + 1), 7 * (killed.T + 2))
    for file in export(killed, "parquet"):
        assert pq.read_table(file).equals(killed.tables[file.stem].whole())


def test_a_run_that_is_interrupted_after_a_jump(lively: Orchestrator, here: Path) -> None:
    """The changes during the run are in its folder: the numbers are those of the verdict."""
    with Live() as live:
        step = live.fault.jump(4, to=0.3).step
    come_to(step + 20)
    lively.send(signal.SIGINT)
    assert lively.wait() == 3
    run = load_run()
    assert (run.verdict.verdict, run.verdict.content["steps_done"]) == ("unknown", run.T)
    assert run.metrics == run.verdict.content["metrics"]
    assert np.flatnonzero(run.a[:, run.ids.index(4)] == 0.3).tolist() == list(range(step, run.T))
    assert run.telemetry()["u"][-7:].null_count == 7


def test_a_simulation_that_is_interrupted(tmp_path: Path) -> None:
    """Its tables are closed, and the state after the last input is missing."""
    topology = NETWORKS["named"]()
    ran, folder = networks.simulate(topology), create(topology, tmp_path / "run")
    recording = Recording(topology, folder, Watching(record=False), Ending("run", "in-process", 0, stopped="by SIGINT"))
    recording.take(ran.rows[:9])
    recording.close()
    run = load_run(folder.path)
    assert (run.T, run.verdict.verdict, run.telemetry()["u"][-3:].null_count) == (8, "unknown", 0)
    assert same(run.x, ran.x[:9])
    assert same(run.u, ran.u[:8])
    assert (len(run.telemetry()), len(run.edges_table())) == (9 * 3, 9 * 2)


def streamed(topology: Topology, folder: Path) -> tuple[Trajectory, Path]:
    """Return a run that has only the streams, as after a killed `up`: 12 steps in batches of 5."""
    ran = networks.simulate(topology)
    place = create(topology, folder)
    place.event("start", engine="zenoh")
    recorder, observer = Recorder(topology, place.path), Observer(topology)
    for first in range(0, len(ran.rows), 5):
        recorder.write(observer.take(ran.rows[first : first + 5]))
    return ran, place.path


@pytest.mark.parametrize("kept", [1.0, 0.99, 0.8, 0.6])
def test_a_truncated_stream_is_complete_up_to_its_last_batch(kept: float, tmp_path: Path) -> None:
    topology = NETWORKS["named"]()
    ran, folder = streamed(topology, tmp_path / "run")
    for stream in folder.glob("*.arrows"):
        size = stream.stat().st_size
        os.truncate(stream, int(size * kept))
    with (folder / "events.jsonl").open("a") as events:
        events.write('{"time": "2026-01-02T03:04:05.678", "event": {"kind": "fa')
    run = load_run(folder)
    assert [event["event"] for event in run.events] == ["start"]
    for file in export(run, "parquet", tmp_path / "tables"):
        to_parquet(folder / f"{file.stem}.arrows", tmp_path / "as.parquet")
        assert file.read_bytes() == (tmp_path / "as.parquet").read_bytes()
    (file,) = export(run, "mat", tmp_path / "run.mat")
    assert (loadmat(file)["verdict"].size, loadmat(file)["T"]) == (0, run.T)
    assert run.T in (4, 9, 11)
    assert kept < 1 or run.T == 11
    assert same(run.x, ran.x[: run.T + 1])
    assert same(run.ahat, ran.report[: run.T, 0])
    observer = Observer(topology)
    live = observer.take(ran.rows[: run.T])
    assert same(run.regret_sum[:-1], live.regret_sum)
    assert same(run.gain, live.gain())


def test_a_table_that_is_behind_the_other(tmp_path: Path) -> None:
    """One table is written before the other, and a reader may come in between."""
    ran, folder = streamed(NETWORKS["named"](), tmp_path / "run")
    os.truncate(folder / "edges.arrows", (folder / "edges.arrows").stat().st_size - 8)
    run = load_run(folder)
    assert run.T == len(run.edge_open) == len(run.u) == 10
    assert same(run.x, ran.x[:11])


def test_steps_without_telemetry(tmp_path: Path) -> None:
    """Row t stays step t: unknown values are NaN, and the others are those of the observer."""
    topology = NETWORKS["named"]()
    ran = networks.simulate(topology)
    folder = create(topology, tmp_path / "run")
    recording = Recording(topology, folder, Watching(record=False), Ending("run", "in-process", 0))
    kept = [*ran.rows[:5], *ran.rows[8:]]
    recording.take(kept)
    recording.finish(ran.end)
    recording.close()
    run = load_run(folder.path)
    assert (run.T, run.lost.tolist()) == (12, [5, 6, 7])
    for name in ("x", "regret", "u", "a", "cost", "gain", "u_edge"):
        assert np.isnan(getattr(run, name)[5:8]).all(), name
    assert not run.edge_open[5:8].any()
    assert (run.index[5:8] == -1).all()
    assert (run.right[5:8] == -1).all()
    observer = Observer(topology)
    live = observer.take(kept)
    observer.finish(ran.end)
    assert_as_live(run, live, observer)
    (file,) = export(run, "npz", tmp_path / "run.npz")
    with np.load(file) as content:
        assert content["lost"].tolist() == [5, 6, 7]
        assert all(same(content[name], arrays(run)[name]) for name in NAMES)
