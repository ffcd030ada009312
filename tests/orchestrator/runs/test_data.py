"""A run in other people's tools: `load_run`, `orchestrator export`, docs/data.md and the notebook.

telemetry -> tables of the folder -> load_run -> csv, parquet, npz, mat -> what reads them: the same bits all the way.
"""

from __future__ import annotations

import contextlib
import csv
import importlib
import itertools
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from scipy.io import loadmat, whosmat
from traitlets.config import Config

from hedgerow import simulate
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.launch.recording import Recording, Watching
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.metrics.verdict import Ending
from hedgerow.orchestrator.runs.export import FORMS, NAMES, PLACES, arrays, export
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.runs.writer import Recorder, to_parquet
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.schema import Topology
from tests.test_docs import ROOT, blocks, table
from tests.test_faults import faulty
from tests.tools import networks
from tests.tools.networks import Trajectory, observe, read
from tests.tools.processes import COMMAND, DEADLINE_S, Orchestrator, orchestrator

NAMED = """
name: named
b: 0.1
steps: 12
seed: 5
defaults: {x0: 3, disturbance: {kind: white, std: 0.1}}
nodes: {upper_dam: {candidates: {random: 2}}, NA: {}, 3: {}}
edges: [[upper_dam, 3], [3, NA]]
faults:
- {kind: drop, from: 3, to: upper_dam, steps: [2, 5]}
- {kind: actuator, node: upper_dam, steps: [4, 6]}
- {kind: crash, node: 3, at: 6, restart_after: 2}
"""
HUGE = f"{{name: huge, b: 0.1, steps: 3, nodes: [{2**62 + 1}, {-(2**62) - 1}], edges: [[{2**62 + 1}, {-(2**62) - 1}]]}}"
ALONE = "{name: alone, b: 0.1, steps: 3, nodes: [1]}"
NETWORKS: dict[str, Callable[[], Topology]] = {
    "paper7": lambda: resolve(load("paper7")),
    "named": lambda: read(NAMED),
    "huge": lambda: read(HUGE),
    "alone": lambda: read(ALONE),
}


def ran(topology: Topology, folder: Path) -> Run:
    """A run of a network in this process, to its end."""
    simulate_into(topology, create(topology, folder), layout(topology, 1), Watching(record=False), Quiet())
    return load_run(folder)


@pytest.fixture(scope="module", params=NETWORKS)
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of each of the networks."""
    return ran(NETWORKS[request.param](), tmp_path_factory.mktemp("runs") / request.param)


@pytest.fixture
def paper7(here: Path) -> Run:
    return ran(NETWORKS["paper7"](), here / "paper7")


def same(one: Any, other: Any) -> bool:
    """Every bit; a NaN is a NaN."""
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype != other.dtype or one.shape != other.shape:
        return False
    if one.dtype.kind == "f":
        return bool((np.isnan(one) == np.isnan(other)).all()) and same(
            *(np.nan_to_num(values, nan=0.5).view(np.int64) for values in (one, other))
        )
    return bool((one == other).all())


# Loaded arrays equal the live ones.

OBSERVED = ("x", "u", "w", "x_oracle", "x_nominal", "regret", "nominal_gap")
"""The arrays of Run that may also have the final state."""
COMPUTED = (
    "a",
    "ahat",
    "index",
    "a_ls",
    "beta",
    "right",
    "cost",
    "cost_oracle",
    "cost_sum",
    "cost_oracle_sum",
    "energy_sum",
)


def assert_as_live(run: Run, live: Batch, observer: Observer) -> None:
    """Check that the run has the bits of the observer at the steps of `live`."""
    for name in OBSERVED:
        assert same(getattr(run, name)[live.t], getattr(live, name)), name
    for name in (*COMPUTED, "u_edge", "cost_regret"):
        assert same(getattr(run, name)[live.t], getattr(live, name)), name
    assert same(run.edge_open[live.t], live.edge_open)
    assert same(run.gain[live.t], live.gain())
    assert same(run.gain_less_x0[live.t], live.gain(observer.v0))
    assert same(run.regret_sum[live.t], live.regret_sum)
    assert same(run.nominal_regret_sum[live.t], live.nominal_regret_sum)
    assert (run.regret_sum[-1], run.nominal_regret_sum[-1]) == (observer.regret_sum, observer.nominal_regret_sum)
    assert run.gamma_star == observer.gamma_star
    if observer.end is not None:
        assert same(run.x[-1], observer.end.x)
        assert same(run.x_oracle[-1], observer.x_oracle_end)


@settings(max_examples=10)
@given(topology=faulty())
def test_every_array_equals_the_live_one(topology: Topology) -> None:
    """The network has any faults: jumps, crashes, cuts, lost messages."""
    with tempfile.TemporaryDirectory() as folder:
        run = ran(topology, Path(folder) / "run")
        observer, live = observe(topology, networks.simulate(topology))
        assert (run.T, run.ids, list(run.lost)) == (topology.steps, topology.ids, [])
        assert_as_live(run, live, observer)
        ended = {name: None if value is None else float(value) for name, value in run.metrics.items()}
        assert ended == run.verdict.content["metrics"]


def test_identifiable_models_are_estimated(paper7: Run) -> None:
    """Without missing samples, (7) chooses the candidate nearest to a_LS, which is a + beta."""
    known = np.isfinite(paper7.a_ls)
    assert (paper7.identifiable == (paper7.ahat == paper7.a))[known].all()
    assert 0 < paper7.identifiable[known].sum() < known.sum()
    np.testing.assert_allclose(paper7.a_ls[known], (paper7.a + paper7.beta)[known], rtol=1e-12)
    assert paper7.faultless


def test_a_run_has_the_received_messages(run: Run) -> None:
    """Arrays of edges have the ends where the file has them."""
    for k, (i, j) in enumerate(run.edges):
        assert (run.ids[i], run.ids[j]) == run.topology.pairs[k]
        flows = np.where(run.edge_open[:, k], run.u[:, j] - run.u[:, i], 0.0)
        assert same(run.u_edge[:, k], flows)
    if run.name == "named":
        assert np.flatnonzero(~run.i_hears[:, 0]).tolist() == [2, 3, 4, 6, 7]  # messages of 3, until it dies
        assert np.flatnonzero(~run.edge_open[:, 0]).tolist() == [4, 5, 6, 7]
        assert (
            np.flatnonzero(np.isnan(run.u[:, 2])).tolist() == np.flatnonzero(run.index[:, 2] == -1).tolist() == [6, 7]
        )
    else:
        assert run.i_hears.all()
        assert run.j_hears.all()


def test_a_run_cannot_be_changed(run: Run) -> None:
    found = 0
    for name in dir(run):
        if not name.startswith("_") and isinstance(values := getattr(run, name), np.ndarray):
            found += 1
            assert not values.flags.writeable, name
            assert getattr(run, name) is values, f"{name} is read twice"
    assert found >= 30
    with pytest.raises(AttributeError):
        run.folder = Path()  # type: ignore[misc]


# The tables as frames.


def test_frames_equal_the_table(run: Run) -> None:
    """Whole numbers stay whole beside missing ones, and null is the missing value of each library."""
    pandas = importlib.import_module("pandas")
    for arrow, frames in (
        (run.telemetry(), {kind: run.telemetry(kind) for kind in ("pandas", "polars")}),
        (run.edges_table(), {kind: run.edges_table(kind) for kind in ("pandas", "polars")}),
    ):
        assert frames["polars"].to_arrow().cast(arrow.schema).equals(arrow)
        for name in arrow.schema.names:
            column = frames["pandas"][name]
            assert column.isna().to_numpy().tolist() == arrow[name].is_null().to_pylist()
            assert column.dropna().tolist() == arrow[name].drop_null().to_pylist()
    assert isinstance(run.telemetry("pandas").dtypes["index"], pandas.Int32Dtype)


def test_to_record_a_run_loads_no_library_of_frames(here: Path) -> None:
    """An import would take half a second of the first steps."""
    told = [sys.executable, "-X", "importtime", *COMMAND[1:], "simulate", "paper7", "--no-record"]
    done = subprocess.run(told, capture_output=True, text=True, check=True, timeout=DEADLINE_S)
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time")}
    assert "hedgerow.orchestrator.runs.writer" in loaded
    assert not {"pandas", "polars"} & loaded


def test_a_frame_of_a_missing_library(paper7: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UserError, match=r"pandas is not installed; install it with: pip install pandas"):
        paper7.telemetry("pandas")
    with pytest.raises(UserError, match=r"'excel' is no kind of table; there are arrow, pandas, polars"):
        paper7.edges_table("excel")


# Exported arrays equal the loaded ones.


def test_csv_is_read_back_to_the_bit(run: Run, tmp_path: Path) -> None:
    """By Arrow, polars and pandas, and each number by Python's float."""
    pandas, polars = importlib.import_module("pandas"), importlib.import_module("polars")
    files = export(run, "csv", tmp_path / "tables")
    assert [file.name for file in files] == ["telemetry.csv", "edges.csv", "summary.csv"]
    for file, arrow in zip(files, (run.telemetry(), run.edges_table(), run.summary()), strict=True):
        types = pa.csv.ConvertOptions(column_types=arrow.schema, null_values=[""], strings_can_be_null=False)
        if len(arrow):
            assert pa.csv.read_csv(file, convert_options=types).equals(arrow)
        schema = polars.from_arrow(arrow).schema
        assert polars.read_csv(file, schema=schema).to_arrow().cast(arrow.schema).equals(arrow)
        frame = pandas.read_csv(file, keep_default_na=False, na_values=[""])
        for name in arrow.schema.names:
            assert frame[name].dropna().tolist() == arrow[name].drop_null().to_pylist()
        with file.open(encoding="utf-8", newline="") as lines:
            rows = list(csv.DictReader(lines))
        for name in arrow.schema.names:
            said = [None if row[name] == "" else row[name] for row in rows]
            if pa.types.is_floating(arrow.schema.field(name).type):
                said = [None if one is None else float(one).hex() for one in said]
                assert said == [None if one is None else one.hex() for one in arrow[name].to_pylist()]


@pytest.mark.parametrize("value", [5e-324, -0.0, 0.1, 1e16, 1e22, 123456789.0, 2**53 + 1.0, 1.7976931348623157e308])
def test_a_number_in_csv_is_the_number(value: float, tmp_path: Path) -> None:
    """Arrow writes numbers of any size and sign, and float reads them back."""
    pa.csv.write_csv(pa.table({"x": [value]}), tmp_path / "x.csv")
    assert float((tmp_path / "x.csv").read_text().splitlines()[1]).hex() == value.hex()


def test_parquet_equals_the_tables_of_the_run(run: Run, tmp_path: Path) -> None:
    for file in export(run, "parquet", tmp_path / "tables"):
        assert file.read_bytes() == (run.folder / file.name).read_bytes()


def test_npz_is_read_back_to_the_bit(run: Run, tmp_path: Path) -> None:
    (file,) = export(run, "npz", tmp_path / "run.npz")
    with np.load(file, allow_pickle=False) as content:
        assert tuple(content) == NAMES
        for name in NAMES:
            assert same(content[name], arrays(run)[name]), name
            value = getattr(run, name)
            if isinstance(value, np.ndarray):
                assert same(content[name], value), name
        assert content["ids"].tolist() == [*run.ids] if run.name != "named" else ["upper_dam", "NA", "3"]
        assert (content["name"], content["verdict"], content["T"]) == (run.name, run.verdict.verdict, run.T)
        for k, node in enumerate(run.topology.nodes.values()):
            listed = content["candidates"][k]
            assert tuple(listed[~np.isnan(listed)]) == node.candidates


def test_mat_is_read_back_to_the_bit(run: Run, tmp_path: Path) -> None:
    """Numbers are doubles, flags logical, names cells of text; positions count from 1."""
    (file,) = export(run, "mat", tmp_path / "run.mat")
    kinds = {name: kind for name, _, kind in whosmat(file)}
    content = loadmat(file)
    assert [*kinds] == [*NAMES]
    for name, values in arrays(run).items():
        found = content[name]
        match values.dtype.kind:
            case "b":
                assert (kinds[name], found.shape) == ("logical", values.shape)
                assert same(found.astype(bool), values)
            case "U" if values.ndim:
                assert kinds[name] == "cell"
                assert [cell[0] for (cell,) in found] == values.tolist()
            case "U":
                assert kinds[name] == "char"
                assert found.tolist() == [str(values)]
            case _ if name == "ids":
                assert kinds[name] == "int64"
                assert found[:, 0].tolist() == values.tolist()
            case _ if values.size:
                assert kinds[name] == "double"
                shape = {0: (1, 1), 1: (-1, 1)}.get(values.ndim, values.shape)
                assert same(found - (name in PLACES), values.astype(float).reshape(shape)), name
    index, ahat = content["index"].astype(int), content["ahat"]
    for t, i in zip(*np.nonzero(index), strict=True):
        assert ahat[t, i] == content["candidates"][i, index[t, i] - 1]


def test_every_name_is_one_that_matlab_takes() -> None:
    words = "break case catch classdef continue else elseif end for function global if otherwise parfor persistent"
    for name in NAMES:
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", name)
        assert name not in f"{words} return spmd switch try while".split()


# Runs that did not end, or have not.


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


# Which run is meant.


def test_a_run_is_named_by_its_folder_its_name_or_its_network(here: Path) -> None:
    for name, steps in (("paper7-20260102-030405", 3), ("paper7-20260102-030405-2", 4), ("paper7-x", 5)):
        topology = resolve(load("paper7", [f"steps={steps}"]))
        ran(topology, here / "runs" / name)
    (here / "runs/latest").symlink_to("paper7-x", target_is_directory=True)
    assert load_run().T == 5
    assert load_run("runs/paper7-20260102-030405").T == load_run("paper7-20260102-030405").T == 3
    assert load_run("paper7").name == "paper7-20260102-030405-2"
    assert load_run(here / "runs" / "latest").name == "paper7-x"
    with pytest.raises(UserError, match=r"^paper: there is no such run; .*; runs/ has .*paper7-20260102-030405-2"):
        load_run("paper")


# Mistakes.


def without(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).unlink()
    return folder


def test_a_folder_that_is_not_a_run_is_reported(paper7: Run, here: Path) -> None:
    def copy() -> Path:
        shutil.rmtree(here / "copy", ignore_errors=True)
        return shutil.copytree(paper7.folder, here / "copy")

    (here / "empty").mkdir()
    for folder, complaint in (
        (here / "nowhere", r"nowhere: there is no such run; name its folder, or its name in runs/$"),
        (here / "empty", r"empty: is no folder of a run: there is no topology.yaml in it"),
        (Path("x" * 300), r"xxx: File name too long; check the path and its permissions"),
    ):
        with pytest.raises(UserError, match=complaint):
            load_run(folder)
    for name in ("telemetry.parquet", "edges.parquet"):
        with pytest.raises(UserError, match=f"no step of the run is recorded yet: there is no {name}"):
            load_run(without(copy(), name))
    for name, content, complaint in (
        ("telemetry.parquet", b"PAR1", r"telemetry.parquet: cannot be read"),
        ("verdict.json", b"{", r"verdict.json: cannot be read"),
        ("topology.yaml", b"name: [", r"topology.yaml"),
    ):
        folder = copy()
        (folder / name).write_bytes(content)
        with pytest.raises(UserError, match=complaint):
            load_run(folder)
    folder = without(copy(), "telemetry.parquet")
    (folder / "telemetry.arrows").write_bytes(b"")
    with pytest.raises(UserError, match="no step of the run is recorded yet"):
        load_run(folder)
    pq.write_table(paper7.telemetry().drop(["x_oracle"]), folder / "telemetry.parquet")
    with pytest.raises(UserError, match="has no column x_oracle: another version of hedgerow wrote it"):
        load_run(folder).regret  # noqa: B018


def test_a_file_that_is_not_of_this_run_is_noticed(paper7: Run, here: Path) -> None:
    """The reader refuses numbers that were computed for another network."""
    text = (paper7.folder / "topology.yaml").read_text()
    (paper7.folder / "topology.yaml").write_text(text.replace("b: 0.1", "b: 0.101"))
    with pytest.raises(HedgerowError, match=r"topology.yaml is not that of this telemetry"):
        load_run(paper7.folder).cost  # noqa: B018
    (here / "three.yaml").write_text(ALONE.replace("[1]", "[1, 2, 3]"))
    (paper7.folder / "topology.yaml").write_text(to_yaml(resolve(load(str(here / "three.yaml")))))
    with pytest.raises(HedgerowError, match=r"217 rows are no whole steps of 3"):
        load_run(paper7.folder)


def test_a_text_that_came_to_harm_is_not_read_from_elsewhere(paper7: Run) -> None:
    """An Arrow stream stores the start of each text. Here that number is too large and points into foreign memory."""
    table, stream = paper7.telemetry(), paper7.folder / "telemetry.arrows"
    table = table.set_column(1, "node", table["node"].cast(pa.string()))  # as of nodes that have names
    with pa.ipc.new_stream(str(stream), table.schema) as writer:
        writer.write_table(table)
    begins = np.arange(8, dtype=np.int32).tobytes()  # of the first texts, one character each
    content = stream.read_bytes()
    assert begins in content
    stream.write_bytes(content.replace(begins, begins[:4] + b"\xff\xff\xff\x7f" + begins[8:]))
    without(paper7.folder, "telemetry.parquet")
    with pytest.raises(UserError, match=r"telemetry.arrows: cannot be read: .* damaged"):
        load_run(paper7.folder)


def test_a_run_without_a_complete_step_is_reported(here: Path) -> None:
    """One row is there, and the state after it is not."""
    topology = NETWORKS["paper7"]()
    folder, rows = create(topology, here / "run"), networks.simulate(topology).rows
    Recorder(topology, folder.path).write(Observer(topology).take(rows[:1]))
    with pytest.raises(UserError, match="no whole step of the run is recorded yet"):
        load_run(folder.path)


def refused(*arguments: str) -> str:
    """Return the message about a mistake."""
    done = orchestrator("export", *arguments)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr


def test_mistakes_at_the_command_line(paper7: Run, here: Path) -> None:
    assert refused("nix", "--to", "csv").startswith("error: nix: there is no such run; name its folder")
    with pytest.raises(UserError, match=r"--to xlsx: is no form of a run; there are csv, parquet, npz, mat"):
        export(paper7, "xlsx")
    assert not list(here.glob("paper7*[.-]*"))
    first = orchestrator("export", "paper7", "--to", "mat")
    assert (first.returncode, first.stdout) == (0, "30 steps of paper7: paper7.mat\n")
    assert refused("paper7", "--to", "mat").startswith("error: paper7.mat: already exists; --force replaces it")


def test_nothing_is_overwritten_unasked(paper7: Run, here: Path) -> None:
    (here / "tables").mkdir()
    (here / "tables/edges.csv").write_text("mine")
    with pytest.raises(UserError, match=r"tables/edges.csv: is there already"):
        export(paper7, "csv", Path("tables"))
    assert [path.name for path in (here / "tables").iterdir()] == ["edges.csv"]
    assert (here / "tables/edges.csv").read_text() == "mine"
    export(paper7, "csv", Path("tables"), force=True)
    assert (here / "tables/edges.csv").read_text().startswith('"step"')
    before = (paper7.folder / "telemetry.parquet").read_bytes()
    with pytest.raises(UserError, match=r"telemetry.parquet: is the run's own; --out names another folder"):
        export(paper7, "parquet", paper7.folder, force=True)
    assert (paper7.folder / "telemetry.parquet").read_bytes() == before
    with pytest.raises(UserError, match=r"tables: is a folder; --out names the file to write"):
        export(paper7, "npz", Path("tables"), force=True)
    (here / "file").write_text("")
    for to in FORMS:
        with pytest.raises(UserError, match=r"is not written: (File exists|Not a directory)"):
            export(paper7, to, here / "file" / "deeper", force=True)


def small_files_only() -> None:
    """The limit is in the command's process alone, because this process may write a large report."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))


@pytest.mark.parametrize("to", FORMS)
def test_a_full_disk_leaves_nothing_half_written(to: str, paper7: Run, here: Path) -> None:
    """Neither a piece of a new file, nor the loss of an old one."""
    (here / "old").mkdir()
    for name in ("telemetry.csv", "edges.csv", "telemetry.parquet", "edges.parquet", "run.npz", "run.mat"):
        (here / "old" / name).write_text("old")
    for place in (here / "new", here / "old"):
        out = place if to in ("csv", "parquet") else place / f"run.{to}"
        command = [*COMMAND, "export", str(paper7.folder), "--to", to, "--out", str(out), "--force"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=small_files_only)
        assert done.returncode == 2
        assert re.search(r"is not written: .*File too large", done.stderr)
    assert not (here / "new").exists()
    assert len(left := list((here / "old").iterdir())) == 6
    assert all(path.read_text() == "old" for path in left)


# The time of the load.


def test_a_run_is_made_as_by_the_command(paper7: Run, here: Path) -> None:
    bundled = str(ROOT / "topologies/paper7.yaml")  # a run of the same name lies here
    run = simulate(bundled, "steps=30", run_dir="mine")
    assert run.folder == here / "mine"
    assert all(
        (run.folder / name).read_bytes() == (paper7.folder / name).read_bytes()
        for name in ("topology.yaml", "telemetry.parquet", "edges.parquet")
    )
    with pytest.raises(UserError, match="mine: holds something already"):
        simulate(bundled, run_dir="mine")


def test_a_run_of_no_step_is_none(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "bad.py").write_text(
        "from hedgerow.agents.law import Minimax\n\n"
        "class Bad(Minimax):\n    def act(self, x): raise ValueError('no')\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(here)
    with pytest.raises(HedgerowError, match=r"law bad:Bad: act\(\) raised ValueError: no") as failed:
        simulate("ring6", "law=bad:Bad")
    assert failed.value.code == Code.LAW
    with pytest.raises(UserError, match=r"law bad:Good: cannot be loaded"):
        simulate("ring6", "law=bad:Good", run_dir="never")
    assert not (here / "never").exists()


def test_the_package_itself_loads_nothing() -> None:
    """Every command and every process imports it."""
    program = "import sys; before = set(sys.modules); import hedgerow.orchestrator; print({*sys.modules} - before)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(eval(loaded.stdout)) <= {"hedgerow", "hedgerow.orchestrator", "__future__"}


# The examples of docs/data.md and the notebook.


def test_the_page_names_every_array_and_its_shape(run: Run) -> None:
    """The table of arrays is that of the files, and of load_run."""
    rows = {row["name"]: row["shape"] for row in table("data.md", "Arrays")}
    sizes = {
        "T": run.T,
        "n": len(run.ids),
        "E": len(run.edges),
        "M": run.candidates.shape[1],
        "L": len(run.lost),
        "K": len(run.rows),
    }
    assert tuple(rows) == NAMES
    for name, values in arrays(run).items():
        shape = eval(rows[name], {}, sizes) if rows[name] != "—" else ()
        assert values.shape == (shape if isinstance(shape, tuple) else (shape,)), name


def test_the_page_names_every_attribute() -> None:
    """The page also names the attributes of Run beside the arrays."""
    public = {name for name in vars(Run) if not name.startswith("_")}
    public |= Run.__dataclass_fields__.keys()
    tables = (table("data.md", "In Python"), table("data.md", "Runs with some rows only"))
    named = {row["attribute"].split("(")[0] for rows in tables for row in rows}
    assert named == public - set(NAMES)


def test_the_examples_agree(paper7: Run, here: Path) -> None:
    """All print the same of the same run; that for MATLAB too, where there is an Octave to run it."""
    page = list(blocks(ROOT / "docs/data.md"))
    said = [(code, text) for code, text in itertools.pairwise(page) if text.text.startswith("node ")]
    assert [code.language for code, _ in said] == ["python", "python", "python", "matlab"]
    assert len({text.text for _, text in said}) == 1
    if octave := shutil.which("octave-cli"):
        export(paper7, "mat", Path("run.mat"))
        program, shown = said[-1]
        command = [octave, "--norc", "--eval", program.text]
        assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == shown.text


NOTEBOOK = ROOT / "docs/figure4.ipynb"


@pytest.mark.slow
def test_the_notebook_ends_with_figure_4(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The notebook runs in an empty folder; its last picture shows r_i(t) of all nodes."""
    nbformat, nbclient = importlib.import_module("nbformat"), importlib.import_module("nbclient")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(name, str(here / name.lower()))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    shown = "print(json.dumps([line.get_ydata().tolist() for line in axes.lines]))"
    notebook.cells.append(nbformat.v4.new_code_cell(f"import json\n{shown}"))
    through_files = Config(KernelManager={"transport": "ipc"})
    nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3", config=through_files).execute()
    *_, figure, drawn = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert any("image/png" in output.get("data", {}) for output in figure.outputs)
    lines = np.array(json.loads(drawn.outputs[-1].text))
    run = load_run(here / "runs/latest")
    assert same(lines.T, run.regret)
