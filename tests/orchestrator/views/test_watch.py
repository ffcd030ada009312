"""Watchers of a run that is under way: they see every step from 0, and delay no process.

up ---> run folder ---> watch ---> viewer      what the viewer was sent equals telemetry.parquet
"""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs.writer import Recorder
from hedgerow.orchestrator.views.rerun.watch import ArrowTail, Trail
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.networks import simulate
from tests.tools.processes import Orchestrator, orchestrator
from tests.tools.viewers import (
    Saver,
    assert_shows,
    begin_headless,
    draws,
    kill,
    last_step,
    recorded,
    until,
)

pytestmark = [
    pytest.mark.usefixtures("without_display"),
    pytest.mark.filterwarnings("ignore:RRD file has no footer"),  # its writer was ended
]

LONG = ("--processes", "1", "--steps", "100000", "--rate", "100", "--viewer", "none", "--no-record")


def test_a_stream_is_read_while_it_grows(tmp_path: Path) -> None:
    """For any number of bytes at a time, each batch arrives once and complete, and the end is known."""
    folder = tmp_path / "run"
    folder.mkdir()
    topology = resolve(load("paper7", ["steps=20"]))
    observer, ran = Observer(topology), simulate(topology)
    recorder = Recorder(topology, folder)
    for first in range(0, 20, 7):
        recorder.write(observer.take(ran.rows[first : first + 7]))
    whole = tmp_path / "whole"
    recorder._telemetry._writer.close()
    (folder / "telemetry.arrows").rename(whole)
    content, growing = whole.read_bytes(), tmp_path / "growing"
    growing.touch()
    tail, steps = ArrowTail(growing), []
    with growing.open("ab") as file:
        for first in range(0, len(content), 97):
            file.write(content[first : first + 97])
            file.flush()
            while (batch := tail.next()) is not None:
                steps += batch["step"].to_pylist()[::7]
            assert tail.over == (first + 97 >= len(content))
    assert steps == list(range(20))


def test_a_trail_is_the_telemetry_that_made_it(tmp_path: Path) -> None:
    """Recorded rows are read back, including links that were down and failed readings."""
    faults = [
        {"kind": "drop", "from": 1, "to": 2, "steps": [5, 9]},
        {"kind": "cut", "edge": [2, 3], "steps": [8, 12]},
        {"kind": "sensor", "node": 3, "steps": [10, 12]},
        {"kind": "crash", "node": 4, "at": 14, "restart_after": 3},
    ]
    topology = resolve(load("paper7", ["steps=30", f"faults={json.dumps(faults)}"]))
    observer, ran = Observer(topology), simulate(topology)
    recorder = Recorder(topology, tmp_path)
    trail = Trail(tmp_path, topology.graph)
    found = []
    for first in range(0, 30, 4):
        recorder.write(observer.take(ran.rows[first : first + 4]))
        found += trail.take(1000)
        assert len(found) == min(first + 4, 30)
    observer.finish(ran.end)
    recorder.write_end(observer, ran.end)
    assert trail.take(1000) == []
    assert trail.end is not None
    assert trail.end.t == 30
    recorder.close()
    assert trail.take(1000) == []
    assert trail.over
    for row, was in zip(found, ran.rows, strict=True):
        for name in ("t", "x", "u", "w", "edge_open", "link_up"):
            np.testing.assert_array_equal(getattr(row, name), getattr(was, name), err_msg=f"{name}({was.t})")
        np.testing.assert_array_equal(row.report[0], was.report[0])


@pytest.mark.slow
def test_a_late_watcher_sees_the_whole_run(saver: Saver) -> None:
    """Two watch a run that began long ago; a fault begins meanwhile; both were shown every step, and the verdict."""
    with Orchestrator("up", "paper7", *LONG) as up:
        up.wait_for("running")
        up.wait_for_step(50)
        with Orchestrator("watch", "--viewer", saver.url) as one, Orchestrator("watch", "--viewer", saver.url) as two:
            one.wait_for("watch it at")
            two.wait_for("watch it at")
            cut = orchestrator("fault", "cut", "1-2", "--for", "5", "--json")
            assert cut.returncode == 0, cut.stderr
            up.wait_for_step(json.loads(cut.stdout)["step"] + 10)
            assert orchestrator("stop").returncode == 0
            assert one.wait() == 0, one.output
            assert two.wait() == 0, two.output
        assert up.wait() == 3, up.output
    saver.close()
    files = list(saver.stores().values())
    assert len(files) == 2
    for file in files:
        assert_shows(file, Path("runs/latest"))
    texts = [
        text
        for chunk in RrdReader(files[0]).stream().filter(content="/events")
        for (text,) in chunk.to_record_batch().column("TextLog:text").to_pylist()
    ]
    assert any("fault 1" in text for text in texts), texts
    assert any("unknown" in text for text in texts), texts


@pytest.mark.slow
def test_a_watcher_reports_a_closed_viewer_and_the_run_continues() -> None:
    viewer = begin_headless()
    try:
        with Orchestrator(
            "up", "paper7", "--processes", "1", "--steps", "100000", "--rate", "100", "--no-record"
        ) as up:
            up.wait_for("running")
            with Orchestrator("watch", "--viewer", viewer.url) as watching:
                until(lambda: draws(viewer) and last_step(viewer.url) > 0)
                kill(viewer)
                assert watching.wait() == 3
                assert viewer.url in watching.output
            before = json.loads(orchestrator("status", "--json").stdout)["step"]
            up.wait_for_step(before + 1)
    finally:
        kill(viewer)


@pytest.mark.slow
def test_a_frozen_viewer_delays_no_process() -> None:
    """`up` and `watch` feed a viewer, which freezes: the steps continue, Ctrl-C works, run.rrd has every step."""
    viewer = begin_headless()
    assert viewer.process is not None
    try:
        with Orchestrator(
            "up", "paper7", "--processes", "1", "--steps", "100000", "--rate", "200", "--viewer", viewer.url
        ) as up:
            up.wait_for("running")
            with Orchestrator("watch", "--viewer", viewer.url) as watching:
                watching.wait_for("watch it at")
                until(lambda: last_step(viewer.url) > 0)
                viewer.process.send_signal(signal.SIGSTOP)
                before = json.loads(orchestrator("status", "--json").stdout)["step"]
                up.wait_for_step(before + 400)
                watching.send(signal.SIGINT)
                assert watching.wait() == 0, watching.output
            up.wait_for_step(json.loads(orchestrator("status", "--json").stdout)["step"] + 50)
            up.send(signal.SIGINT)
            assert up.wait() == 3, up.output
            assert "Traceback" not in up.output + watching.output
    finally:
        kill(viewer)
    folder = Path("runs/latest")
    assert len(recorded(folder, "x")) > 450
    assert_shows(folder / "run.rrd", folder)


def test_watch_needs_a_running_network_and_a_display() -> None:
    alone = orchestrator("watch")
    assert alone.returncode == 2
    assert "`orchestrator open`" in alone.stderr, "the fix is a command"
    with Orchestrator("up", "line5", *LONG) as up:
        up.wait_for("running")
        refused = orchestrator("watch")
        assert refused.returncode == 2
        assert "--viewer web" in refused.stderr
