"""Runs that ended are shown in a viewer: from run.rrd, from the tables, and beside each other."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.views.rerun.opening import common_nodes, labels, open_runs
from hedgerow.orchestrator.views.rerun.stream import DRAWN_NODES, Pace, RerunStream
from hedgerow.orchestrator.views.rerun.viewer import Viewer, start
from hedgerow.orchestrator.views.rerun.viewer_version import compare
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import Code
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.ports import free_port
from tests.tools.networks import simulate
from tests.tools.processes import orchestrator
from tests.tools.refusals import refusal
from tests.tools.viewers import (
    Saver,
    assert_shows,
    begin_headless,
    kill,
    last_step,
    shown,
    until,
)

pytestmark = [
    pytest.mark.usefixtures("without_display"),
    pytest.mark.filterwarnings("ignore:RRD file has no footer"),  # its writer was ended
]


def test_a_viewer_of_another_version_is_reported_with_a_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both commands name the two versions and continue; for a viewer too old to answer, they report that."""
    ours = rr.__version__
    monkeypatch.setattr(rr, "__version__", "0.99.0")
    viewer, messages = begin_headless(), list[str]()
    stranger = Viewer(viewer.url)
    expected = f"the viewer at {viewer.url} is Rerun {ours}, and this is 0.99.0: its display may be wrong."
    expected += " Install rerun-sdk==0.99.0 there"
    topology = resolve(load("paper7"))
    observer, run = Observer(topology), simulate(topology)
    try:
        stream = RerunStream(topology, observer, "story", None, stranger, warn=messages.append)
        stream.log(observer.take(run.rows))
        until(lambda: messages == [expected])
        assert stream.close(60.0)
        until(lambda: last_step(viewer.url) == 29)
        ran("run")
        open_runs(["run"], viewer.url, messages.append)
        assert messages[1] == expected
    finally:
        kill(viewer)


def test_a_viewer_without_a_version_is_reported() -> None:
    """Neither a viewer before 0.41 nor a page's server reports its version."""
    server, messages = start("web"), list[str]()
    assert server is not None
    try:
        server.wait_until_it_listens()
        compare(Viewer(server.url), messages.append).join()
        assert messages[0].startswith(f"the viewer at {server.url} does not report its version: it is old")
        assert f"install rerun-sdk=={rr.__version__} there" in messages[0]
        compare(server, messages.append).join()
        assert len(messages) == 1, "we know what we have started"
    finally:
        server.end()


def ran(name: str, source: str = "paper7", *sets: str, record: bool = False) -> Path:
    """The folder of 300 steps of a network."""
    topology = resolve(load(source, ["steps=300", *sets]))
    folder = create(topology, Path(name))
    assert simulate_into(topology, folder, layout(topology, 1), Watching(record=record), Quiet()).exit_code == 0
    return folder.path


@pytest.mark.slow
def test_a_run_opens_from_its_recording_or_its_tables_alike(saver: Saver) -> None:
    """From run.rrd; without one; and from the tables again where a newer Rerun wrote it."""
    folders = [ran("with", record=True), ran("without"), ran("newer", record=True)]
    content = bytearray((folders[2] / "run.rrd").read_bytes())
    content[4:8] = struct.pack("4B", 0, 99, 0, 0)
    (folders[2] / "run.rrd").write_bytes(content)
    messages: list[str] = []
    for folder in folders:
        open_runs([str(folder)], saver.url, messages.append)
    saver.close()
    assert [line for line in messages if "tables" in line] == [
        "without: there is no run.rrd: shown from its tables",
        f"newer: run.rrd was written by Rerun 0.99, newer than {rr.__version__} here: shown from its tables",
    ]
    stores = saver.stores()
    assert stores.keys() == {"with", "without", "newer"}
    for name, file in stores.items():
        assert_shows(file, Path(name))


@pytest.mark.slow
def test_two_runs_share_their_axes(saver: Saver) -> None:
    """Two laws: each run's entities are in a separate folder, with every step."""
    folders = {"minimax": ran("one"), "hinf": ran("two", "paper7", "law=hinf")}
    open_runs(["one", "two"], saver.url, print)
    saver.close()
    for law, folder in folders.items():
        run = load_run(folder)
        for entity, values in {
            "x": run.x,
            "regret_sum": run.regret_sum[:, None],
            "cost_regret": run.cost_regret[:, None],
            "nodes_right": run.right[:, None],
        }.items():
            np.testing.assert_array_equal(shown(saver.path, f"{law}/{entity}")[1], values)


@pytest.mark.parametrize(("steps", "drawn"), [(300, 300), (60_000, 20_000)])
def test_a_past_is_drawn_evenly_however_fast_it_is_read(steps: int, drawn: int) -> None:
    """A live view draws some steps per second; a replay draws all, or every third of very many."""
    pace = Pace(20.0, steps, -(-steps * 7 // DRAWN_NODES))
    picked = np.concatenate([first + pace.pick(2000) for first in range(0, max(steps, 2000), 2000)])[:drawn]
    np.testing.assert_array_equal(picked, np.arange(drawn) * (steps // drawn))
    assert len(pace.pick(2000)) <= 200


def test_runs_without_a_node_in_common_are_refused() -> None:
    ran("one")
    Path("other.yaml").write_text("{name: other, b: 0.1, steps: 5, nodes: [north, south], edges: [[north, south]]}")
    ran("other", "other.yaml")
    with refusal(Code.OPTION):
        common_nodes([load_run("one"), load_run("other")])
    assert labels([load_run("one"), load_run("other")]) == ["one", "other"]
    refused = orchestrator("open", "one", "other", "--viewer", "rerun+http://127.0.0.1:1/proxy")
    assert refused.returncode == 2, refused.stderr


def test_a_viewer_that_is_not_there_is_named_with_its_cure() -> None:
    folder = ran("run")
    nobody = orchestrator("open", "run")
    assert nobody.returncode == 2
    assert f"copy {folder / 'run.rrd'}" in nobody.stderr
    port = free_port()
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    with refusal(Code.VIEWER, url) as refused:
        Viewer(url).wait_until_it_listens(0.1)
    assert f"`rerun --port {port}" in str(refused.value), "the fix is a command"
