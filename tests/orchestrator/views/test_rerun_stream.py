"""A run streamed to Rerun: run.rrd has every bit of it, for any behaviour of the viewer.

batches -> run.rrd            all of them, always
       \\-> queue -> viewer    live, late, frozen, or never there
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import socket
import statistics
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.views.rerun.stream import RerunStream
from hedgerow.orchestrator.views.rerun.viewer import Viewer, choose, listening, native, start
from hedgerow.topologies.errors import Code
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.ports import free_port
from tests.tools.networks import simulate
from tests.tools.refusals import refusal
from tests.tools.schedules import with_faults
from tests.tools.viewers import begin_headless, draws, kill, last_step, until

Array = NDArray[np.float64]
ROWS = 120_000
BATCH_ROWS = 200


def paper7() -> Topology:
    return resolve(load("paper7"))


def batches_of(observer: Observer, rows: int) -> list[Batch]:
    """Return the whole run in batches of some rows, including its end."""
    ran = simulate(observer.topology)
    batches = [observer.take(ran.rows[k : k + rows]) for k in range(0, len(ran.rows), rows)]
    observer.finish(ran.end)
    return batches


def whole(batches: list[Batch]) -> Batch:
    return Batch(**{f.name: np.concatenate([getattr(batch, f.name) for batch in batches]) for f in fields(Batch)})


def long_batches(observer: Observer) -> Iterator[Batch]:
    """Batches of BATCH_ROWS steps without end: one real batch again and again, its steps counted on."""
    (short,) = batches_of(observer, 1000)
    picked = {
        f.name: np.resize(getattr(short, f.name), (BATCH_ROWS, *getattr(short, f.name).shape[1:]))
        for f in fields(Batch)
    }
    batch = Batch(**picked)
    for first in itertools.count(0, BATCH_ROWS):
        yield replace(batch, t=np.arange(first, first + BATCH_ROWS))


def read(path: Path, entity: str) -> tuple[list[int], Array]:
    """The steps of an entity's rows in run.rrd, in order, and its values, (rows, series)."""
    component = "Scalars:scalars"
    chunks = RrdReader(path).stream().filter(content=f"/{entity}", is_static=False, components=component)
    steps, values = [], []
    for chunk in chunks:
        table = chunk.to_record_batch()
        steps += table.column("step").to_pylist()
        values += table.column(component).to_pylist()
    order = np.argsort(steps, kind="stable")
    return [int(steps[k]) for k in order], np.array([values[k] for k in order], dtype=float)


@pytest.fixture
def stranger() -> Iterator[tuple[socket.socket, str]]:
    """A socket on loopback that accepts and never reads, and its address as a viewer's."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening, f"rerun+http://127.0.0.1:{listening.getsockname()[1]}/proxy"


@pytest.fixture
def headless() -> Iterator[Viewer]:
    viewer = begin_headless()
    yield viewer
    kill(viewer)


def test_the_recording_holds_every_step_bit_for_bit(tmp_path: Path) -> None:
    observer = Observer(paper7())
    path = tmp_path / "run.rrd"
    stream = RerunStream(observer.topology, observer, "story", path, None)
    batches = batches_of(observer, 7)
    for batch in batches:
        stream.log(batch)
    stream.end(observer)
    assert stream.close(60.0)

    ran, end = whole(batches), observer.end
    assert end is not None
    steps = list(range(observer.topology.steps))
    expected = {
        "u": ran.u,
        "u_edge": ran.u_edge,
        "w": ran.w,
        "ahat": ran.ahat,
        "truth": ran.a,
        "a_ls": ran.a_ls,
        "margin": np.where(np.isinf(ran.margin), np.nan, ran.margin),
        "nodes_right": ran.right[:, None],
        "cost_regret": ran.cost_regret[:, None],
        "cost_ratio": ran.ratio[:, None],
        "gain": np.stack([ran.gain(), ran.ceiling, np.full(len(steps), observer.gamma_star)], axis=1),
    }
    for entity, values in expected.items():
        found = read(path, entity)
        assert found[0] == steps, entity
        np.testing.assert_array_equal(found[1], values, err_msg=entity)

    to_the_end = {
        "x": (ran.x, end.x),
        "x_oracle": (ran.x_oracle, observer.x_oracle_end),
        "regret": (ran.regret, np.abs(end.x - observer.x_oracle_end)),
        "nominal_gap": (ran.nominal_gap, np.abs(observer.x_oracle_end - observer.x_nominal_end)),
        "regret_sum": (
            np.stack([ran.regret_sum, ran.nominal_regret_sum], axis=1),
            np.array([observer.regret_sum, observer.nominal_regret_sum]),
        ),
    }
    for entity, (values, last) in to_the_end.items():
        found = read(path, entity)
        assert found[0] == [*steps, observer.topology.steps], entity
        np.testing.assert_array_equal(found[1], np.vstack([values, last]), err_msg=entity)


def test_a_node_without_rival_has_an_infinite_margin_and_the_plot_a_gap(tmp_path: Path) -> None:
    observer = Observer(resolve(load("paper7", ["law=hinf"])))
    stream = RerunStream(observer.topology, observer, "story", tmp_path / "run.rrd", None)
    (batch,) = batches_of(observer, 1000)
    assert np.isinf(batch.margin).all()
    stream.log(batch)
    assert stream.close(60.0)
    assert np.isnan(read(tmp_path / "run.rrd", "margin")[1]).all()


def test_missing_values_are_gaps_and_a_jump_is_a_step(tmp_path: Path) -> None:
    """Node 4 is dead for three steps, node 1 blind for two; then the a of node 2 is another."""
    candidates = paper7().nodes[2].candidates
    assert isinstance(candidates, tuple)
    faults: list[dict[str, Any]] = [
        {"kind": "crash", "node": 4, "at": 10, "restart_after": 3},
        {"kind": "sensor", "node": 1, "steps": [15, 17]},
        {"kind": "jump", "node": 2, "at": 20, "a": candidates[0]},
    ]
    observer = Observer(with_faults(paper7(), faults))
    stream = RerunStream(observer.topology, observer, "story", tmp_path / "run.rrd", None)
    batches = batches_of(observer, 7)
    for batch in batches:
        stream.log(batch)
    stream.end(observer)
    assert stream.close(60.0)
    ran = whole(batches)
    for entity, values in {"u": ran.u, "ahat": ran.ahat, "margin": ran.margin, "truth": ran.a}.items():
        np.testing.assert_array_equal(read(tmp_path / "run.rrd", entity)[1], values, err_msg=entity)
    gaps = np.argwhere(np.isnan(read(tmp_path / "run.rrd", "u")[1]))
    assert gaps.tolist() == [[10, 3], [11, 3], [12, 3], [15, 0], [16, 0]]
    assert (ran.a[20:, 1] == candidates[0]).all()
    assert np.isfinite(read(tmp_path / "run.rrd", "x")[1]).all()


def growth_mb(path: Path) -> float:
    """Return the usual growth of this process over 100 writes [MB]: the median of eight times.

    Late or returned memory makes some of them large, but is not growth.
    """
    observer = Observer(paper7().model_copy(update={"steps": 10**9}))
    stream = RerunStream(observer.topology, observer, "story", path, None)
    assert stream._file is not None
    sizes = []
    for number, batch in enumerate(itertools.islice(long_batches(Observer(paper7())), 1001)):
        stream.log(batch)
        if number >= 200 and number % 100 == 0:
            stream._file._stream.flush(timeout_sec=60.0)
            sizes.append(psutil.Process().memory_info().rss / 1e6)
    assert stream.close(60.0)
    return statistics.median(later - earlier for earlier, later in itertools.pairwise(sizes))


@pytest.mark.slow
def test_a_long_run_holds_no_written_data_in_memory(tmp_path: Path) -> None:
    """The index that shorter runs end with would cost 3 to 5 MB; without it, 0.3 at most.

    It is measured in a separate process, because memory of earlier tests would disturb it.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as alone:
        assert alone.submit(growth_mb, tmp_path / "run.rrd").result() < 1.5


def test_events_stand_at_their_steps(tmp_path: Path) -> None:
    observer = Observer(paper7())
    stream = RerunStream(observer.topology, observer, "story", tmp_path / "run.rrd", None)
    stream.event("node 3 fell silent", "WARN", 4)
    assert stream.close(60.0)
    (chunk,) = RrdReader(tmp_path / "run.rrd").stream().filter(content="/events")
    batch = chunk.to_record_batch()
    (row,) = batch.drop_columns(["wall"]).to_pylist()  # nanoseconds fit no datetime
    assert (row["step"], row["TextLog:text"], row["TextLog:level"]) == (4, ["node 3 fell silent"], ["WARN"])


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    observer = Observer(paper7())
    with refusal(Code.OUTPUT, str(tmp_path / "missing/run.rrd")):
        RerunStream(observer.topology, observer, "story", tmp_path / "missing" / "run.rrd", None)


def test_without_a_viewer_nothing_waits_and_nothing_is_lost(tmp_path: Path) -> None:
    url = f"rerun+http://127.0.0.1:{free_port()}/proxy"
    observer = Observer(paper7())
    stream = RerunStream(observer.topology, observer, "story", tmp_path / "run.rrd", Viewer(url))
    batches = batches_of(observer, 7)
    began = time.monotonic()
    for batch in batches:
        stream.log(batch)
    assert stream.close(60.0)
    assert time.monotonic() - began < 15.0
    assert stream.missed == len(batches)
    np.testing.assert_array_equal(read(tmp_path / "run.rrd", "x")[1], whole(batches).x)


def stream_all(path: Path, viewer: Viewer) -> tuple[RerunStream, float]:
    """Log ROWS steps; the stream, and the longest call [s]."""
    observer = Observer(paper7())
    stream = RerunStream(observer.topology, observer, "story", path, viewer)
    longest = 0.0
    for batch in itertools.islice(long_batches(observer), ROWS // BATCH_ROWS):
        began = time.monotonic()
        stream.log(batch)
        longest = max(longest, time.monotonic() - began)
    return stream, longest


def closes_late(stream: RerunStream) -> bool:
    """Close within 2 s, or a little more on a busy machine; return True if a thread remains."""
    began = time.monotonic()
    clean = stream.close(2.0)
    assert time.monotonic() - began < 15.0
    return not clean


@pytest.mark.slow
def test_a_viewer_that_never_reads_costs_nothing(tmp_path: Path, stranger: tuple[socket.socket, str]) -> None:
    path = tmp_path / "run.rrd"
    stream, longest = stream_all(path, Viewer(stranger[1]))
    assert longest < 10.0
    assert closes_late(stream)
    assert stream.missed > 0
    stranger[0].close()
    assert read(path, "x")[0] == list(range(ROWS))


@pytest.mark.slow
def test_a_frozen_viewer_costs_nothing(tmp_path: Path, headless: Viewer) -> None:
    assert headless.process is not None
    os.kill(headless.process.pid, signal.SIGSTOP)
    path = tmp_path / "run.rrd"
    stream, longest = stream_all(path, headless)
    assert longest < 10.0
    assert closes_late(stream)
    headless.process.kill()
    assert read(path, "x")[0] == list(range(ROWS))


def test_a_viewer_keeps_a_run_that_ended_before_it_had_started(headless: Viewer) -> None:
    kill(headless)  # there is a driver: the next one starts too
    viewer = native("--headless")
    try:
        observer = Observer(paper7())
        stream = RerunStream(observer.topology, observer, "story", None, viewer)
        for batch in batches_of(observer, 7):
            stream.log(batch)
        stream.end(observer)
        assert stream.close(60.0)
        assert stream.missed == 0
        until(lambda: draws(viewer) and last_step(viewer.url) == observer.topology.steps)
    finally:
        kill(viewer)


def test_a_viewer_may_come_late_and_come_back() -> None:
    port = free_port()
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    observer = Observer(paper7())
    stream = RerunStream(observer.topology, observer, "story", None, Viewer(url))
    first, second, third, *_ = batches_of(observer, 10)
    stream.log(first)
    late = begin_headless(port)
    until(lambda: last_step(url) == 9)
    kill(late)
    stream.log(second)
    late = begin_headless(port)
    stream.log(third)
    until(lambda: last_step(url) == 29)
    assert stream.close(60.0)
    assert last_step(url) == 29
    kill(late)


def test_a_page_is_served_on_loopback_until_the_run_ends() -> None:
    viewer = start("web")
    assert viewer is not None
    assert viewer.process is not None
    assert viewer.link is not None
    pid = viewer.process.pid
    until(lambda: viewer.listens() and len(listening(pid)) == 2)
    assert {address for address, _ in listening(pid)} == {"127.0.0.1"}
    with urllib.request.urlopen(viewer.link, timeout=60) as page:
        assert page.status == 200
    viewer.end()
    assert viewer.gone


def test_our_viewer_never_is_a_stranger_on_its_port(stranger: tuple[socket.socket, str]) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert not Viewer(stranger[1], process=process).listens()
        assert Viewer(stranger[1]).listens()
        process.kill()


@pytest.mark.parametrize(
    "asked",
    ["", "nativ", "rerun+http://127.0.0.1/proxy", "rerun+http://127.0.0.1:99999/proxy", "http://127.0.0.1:9876/proxy"],
)
def test_an_address_that_is_not_a_viewer_is_refused(asked: str) -> None:
    with refusal(Code.OPTION, f"--viewer {asked}"):
        choose(asked)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there always is a display")
def test_a_window_needs_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert choose("auto") == "none"
    with refusal(Code.OPTION, "--viewer native"):
        choose("native")
    monkeypatch.setenv("DISPLAY", ":0")
    assert choose("auto") == "native"
