"""Every way to see a run, late, afterwards, in parts and beside another: all of it is there, from step 0.

up ---> run folder ---> watch ---> viewer      what the viewer was sent equals telemetry.parquet
                   \\--> open  ---> viewer      and so does run.rrd, however `up` ended
"""

from __future__ import annotations

import contextlib
import json
import re
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import rerun as rr
from numpy.typing import NDArray
from PIL import Image
from rerun.chunk import RrdReader

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.writer import Recorder, to_parquet
from hedgerow.orchestrator.views.rerun.opening import common_nodes, labels, open_runs
from hedgerow.orchestrator.views.rerun.panels import lines
from hedgerow.orchestrator.views.rerun.rrd_file import RrdFile, part_path, parts
from hedgerow.orchestrator.views.rerun.stream import DRAWN_NODES, Pace, RerunStream
from hedgerow.orchestrator.views.rerun.viewer import Viewer, executable, start
from hedgerow.orchestrator.views.rerun.viewer_version import compare
from hedgerow.orchestrator.views.rerun.watch import ArrowTail, Trail
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import Code
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.ports import free_port
from tests.agents.test_view import Seen
from tests.orchestrator.views.test_rerun_stream import begin_headless, draws, kill, last_step, until
from tests.tools.networks import simulate
from tests.tools.processes import Orchestrator, orchestrator
from tests.tools.refusals import refusal

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")  # its writer was ended

Array = NDArray[np.float64]
LOST_S = 2.5
"""the time before a kill that may be missing from run.rrd, as in docs/watching.md [s]"""
LONG = ("--processes", "1", "--steps", "100000", "--rate", "100", "--viewer", "none", "--no-record")
SPLIT = ("--split-recording", "0.1")


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)


class Saver:
    """A viewer that draws nothing and writes all received data to a file."""

    def __init__(self, path: Path) -> None:
        port = free_port()
        self.path, self.url = path, f"rerun+http://127.0.0.1:{port}/proxy"
        command = [str(executable()), "--bind", "127.0.0.1", "--port", str(port), "--save", str(path)]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        Viewer(self.url).wait_until_it_listens()

    def close(self) -> None:
        """End it after it has written its received data: its file then stops growing."""
        sizes = [-1] * 20

        def still() -> bool:
            sizes[:] = [*sizes[1:], self.path.stat().st_size]
            return len(set(sizes)) == 1

        until(still)
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)

    def stores(self) -> dict[str, Path]:
        """Return its received recordings by name, one file each."""
        files = {}
        reader = RrdReader(self.path)
        for number, store in enumerate(reader.recordings()):
            files[store.recording_id] = self.path.with_name(f"{number}.rrd")
            reader.stream(store=store).write_rrd(
                files[store.recording_id], application_id="hedgerow", recording_id=store.recording_id
            )
        return files


@pytest.fixture
def saver(tmp_path: Path) -> Iterator[Saver]:
    saver = Saver(tmp_path / "seen.rrd")
    yield saver
    saver.process.kill()
    saver.process.wait()


def shown(files: list[Path] | Path, entity: str) -> tuple[Array, Array]:
    """The steps and the values, (rows, series), that recordings have of an entity, in the order of the steps."""
    steps: list[int] = []
    values: list[list[float]] = []
    for file in [files] if isinstance(files, Path) else files:
        reader = RrdReader(file)
        for store in reader.recordings():
            some = reader.stream(store=store).filter(
                content=f"/{entity}", is_static=False, has_timeline="step", components="Scalars:scalars"
            )
            for chunk in some:
                table = chunk.to_record_batch()
                steps += table.column("step").to_pylist()
                values += table.column("Scalars:scalars").to_pylist()
    order = np.argsort(steps, kind="stable")
    return np.array(steps, dtype=int)[order], np.array([values[k] for k in order], dtype=float)


def recorded(folder: Path, column: str, nodes: int = 7) -> Array:
    """Return a column of telemetry.parquet, one row per step."""
    values: Array = pq.read_table(folder / "telemetry.parquet")[column].to_numpy().astype(float).reshape(-1, nodes)
    return values


def assert_shows(files: list[Path] | Path, folder: Path, done: int | None = None) -> None:
    """Every column of telemetry.parquet is there, each step and node of it to the bit; up to `done` steps, or all."""
    x, x_oracle, x_nominal = (recorded(folder, name)[:done] for name in ("x", "x_oracle", "x_nominal"))
    for entity, expected in {"regret": np.abs(x - x_oracle), "nominal_gap": np.abs(x_oracle - x_nominal)}.items():
        np.testing.assert_array_equal(shown(files, entity)[1][:done], expected, err_msg=entity)
    step, node, *columns = pq.read_schema(folder / "telemetry.parquet").names
    assert (step, node) == ("step", "node")
    assert {"x", "u", "w", "ahat", "index", "margin", "x_oracle", "x_nominal"} == {*columns}
    np.testing.assert_array_equal(recorded(folder, step)[:, 0], np.arange(len(recorded(folder, step))))
    assert series(files, "x") == [[f"{k:.0f}" for k in recorded(folder, node)[0]]] * len(series(files, "x"))
    for column in columns:
        table = recorded(folder, column)
        if not column.startswith("x"):
            table = table[:-1] if done is None else table  # no input acts at the last step
        steps, values = (rows[:done] for rows in shown(files, column))
        expected = table[:done]
        np.testing.assert_array_equal(steps, np.arange(len(expected)), err_msg=column)
        assert bits(values) == bits(expected), column


def bits(values: Array) -> bytes:
    """Return the bits of values, with -0 distinct from 0, and all NaN equal."""
    return np.where(np.isnan(values), np.nan, values).tobytes()


def series(files: list[Path] | Path, entity: str) -> list[list[str]]:
    """The names of the series of an entity, in each recording; a part that was killed at its start has none."""
    return [
        chunk.to_record_batch().column("SeriesLines:names").to_pylist()[0]
        for file in ([files] if isinstance(files, Path) else files)
        for reader in (RrdReader(file),)
        for store in reader.recordings()
        for chunk in reader.stream(store=store).filter(content=f"/{entity}", is_static=True)
    ]


# ---- the trail of a run, while it is written


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


# ---- watch


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


def test_a_page_on_a_port_that_is_in_use_is_refused_before_the_run_begins() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        page = f"http://127.0.0.1:{other.getsockname()[1]}"
        done = orchestrator("up", "paper7", "--viewer", page)
    assert done.returncode == 2
    assert done.stderr == (
        f"error: --viewer {page}: no page there: Address already in use; choose another port, or an address of ours\n"
    )
    assert not Path("runs").exists()


def test_watch_needs_a_running_network_and_a_display() -> None:
    alone = orchestrator("watch")
    assert alone.returncode == 2
    assert "`orchestrator open`" in alone.stderr, "the fix is a command"
    with Orchestrator("up", "line5", *LONG) as up:
        up.wait_for("running")
        refused = orchestrator("watch")
        assert refused.returncode == 2
        assert "--viewer web" in refused.stderr


# ---- run.rrd, whichever way a run ends


def complete_steps(files: list[Path]) -> int:
    """Return how many steps all entities have; Rerun writes one entity after the other."""
    entities = ("x", "u", "w", "ahat", "index", "margin", "x_oracle", "x_nominal", "regret", "nominal_gap")
    return min(len(shown(files, entity)[0]) for entity in entities)


def is_recorded(path: Path, least_parts: int) -> bool:
    """Return True once a recording that grows has that many parts, and all of 200 steps."""
    files = parts(path)
    if len(files) < least_parts:
        return False
    try:
        return complete_steps(files) > 200
    except (RuntimeError, ValueError):  # Rerun writes the last piece just now
        return False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "split"), [("end", ()), ("Ctrl-C", SPLIT), ("SIGKILL", ()), ("SIGKILL", SPLIT)], ids=str
)
def test_run_rrd_equals_the_tables(ending: str, split: tuple[str, ...]) -> None:
    """To the bit, all columns, steps and nodes, in one file or in parts; of a killed run up to the last LOST_S."""
    rate, steps = 200, 500 if ending == "end" else 1_000_000
    with Orchestrator(
        "up", "paper7", "--processes", "1", "--steps", str(steps), "--rate", str(rate), "--viewer", "none", *split
    ) as up:
        up.wait_for("running")
        if ending != "end":
            until(partial(is_recorded, Path("runs/latest/run.rrd"), 1 + bool(split)), every_s=0.1)
            up.send(signal.SIGINT if ending == "Ctrl-C" else signal.SIGKILL)
        up.wait()
    folder = Path("runs/latest").resolve()
    files = parts(folder / "run.rrd")
    assert (len(files) > 1) == bool(split)
    if ending != "SIGKILL":
        assert len(series(files, "x")) == len(files)
        assert_shows(files, folder)
        return
    for name in ("telemetry", "edges"):
        to_parquet(folder / f"{name}.arrows", folder / f"{name}.parquet")
    kept, done = len(recorded(folder, "x")), complete_steps(files)
    assert kept - done <= LOST_S * rate, (kept, done)
    assert_shows(files, folder, min(kept, done))


# ---- parts


def streams(sink: rr.FileSink) -> rr.RecordingStream:
    stream = rr.RecordingStream("story", recording_id="long")
    stream.set_sinks(sink)
    stream.log("x", rr.SeriesLines(names=["one"]), static=True)
    return stream


def send(stream: rr.RecordingStream, values: Array, first: int) -> None:
    index = [rr.TimeColumn("step", sequence=np.arange(first, first + len(values)))]
    stream.send_columns("x", index, rr.Scalars.columns(scalars=values))


def test_a_recording_continues_in_parts(tmp_path: Path) -> None:
    """Each part has about the requested size and begins with the static data; together they have all rows."""
    path = tmp_path / "run.rrd"
    file = RrdFile(path, streams, part_bytes=200_000)
    values = np.random.default_rng(1).normal(size=(100, 500, 1))
    for k in range(100):
        file.write(partial(send, values=values[k], first=500 * k))
        file._stream.flush(timeout_sec=10.0)
    file.close(5.0)
    written = parts(path)
    assert written[0] == path
    assert written[1] == part_path(path, 1) == tmp_path / "run-001.rrd"
    assert len(written) >= 3
    assert all(part.stat().st_size < 300_000 for part in written)
    for part in written:
        assert len(RrdReader(part).stream().filter(content="/x", is_static=True).to_chunks()) == 1
    steps, found = shown(written, "x")
    np.testing.assert_array_equal(steps, np.arange(50_000))
    np.testing.assert_array_equal(found, values.reshape(-1, 1))

    whole = tmp_path / "whole.rrd"
    command = [str(executable()), "rrd", "merge", *map(str, written), "-o", str(whole)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    np.testing.assert_array_equal(shown(whole, "x")[1], values.reshape(-1, 1))


def test_a_deleted_part_causes_no_error(tmp_path: Path) -> None:
    file = RrdFile(tmp_path / "run.rrd", streams, part_bytes=10**9)
    (tmp_path / "run.rrd").unlink()
    file.write(lambda stream: stream.log("x", rr.Scalars([1.0])))
    file.close(5.0)
    assert parts(tmp_path / "run.rrd") == [tmp_path / "run-001.rrd"]


def test_a_part_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with refusal(Code.OUTPUT, str(tmp_path / "missing/run.rrd")):
        RrdFile(tmp_path / "missing" / "run.rrd", streams)


# ---- open


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


# ---- the page

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = (
    "--no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update"
    " --disable-sync --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --ignore-gpu-blocklist"
)


def drawn(screenshot: Path) -> list[int]:
    """Return the number of pixels in the colour of each node of paper7: zero on a page without a run."""
    pixels = np.asarray(Image.open(screenshot).convert("RGB")).astype(int)
    topology = resolve(load("paper7"))
    (x,) = (quantity for quantity in lines(topology) if quantity.entity == "x")
    return [int((np.abs(pixels - color[:3]).max(axis=2) <= 24).sum()) for color in x.colors]


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM.exists(), reason="there is no Chromium here")
def test_a_page_shows_the_run_while_it_runs(tmp_path: Path) -> None:
    """The link of `up` opens in Chromium: each node's line is drawn, with breaks at lost messages and cuts."""
    api: Any = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    faults = "--set=faults=[{kind: drop, link: [2, 4]}, {kind: cut, edge: [3, 5]}]"
    options = ["--processes", "1", "--steps", "1000000", "--rate", "50", "--viewer", "web", "--no-record", faults]
    with Orchestrator("up", "paper7", *options) as up:
        up.wait_for("watch it at http")
        found = re.search(r"http://\S+", up.output)
        assert found is not None
        with contextlib.ExitStack() as stack:
            playwright = stack.enter_context(api.sync_playwright())
            browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS.split())
            stack.callback(browser.close)
            page = browser.new_page(viewport={"width": 960, "height": 600})
            screenshot = tmp_path / "page.png"

            def look() -> Seen:
                page.screenshot(path=screenshot)
                return Seen(screenshot)

            def until_seen(condition: Callable[[], bool]) -> None:
                by = time.monotonic() + 240.0
                while not condition():
                    assert time.monotonic() < by, drawn(screenshot)
                    page.wait_for_timeout(1000)

            page.goto(f"{found[0]}&renderer=webgl")
            assert page.title() == "Rerun Viewer"
            until_seen(lambda: look().broken and min(drawn(screenshot)) > 60)
            assert page.locator("canvas").count() == 1
            assert "error" not in page.inner_text("body").lower()
        up.send(signal.SIGINT)
        assert up.wait() == 3
