"""Readers of a run folder open only regular files inside it, within the memory limit."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.runs.files import load_events, load_resolved, read_verdict
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.table import Table
from hedgerow.orchestrator.views.rerun.watch import Happenings
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run that is over."""
    directory = tmp_path_factory.mktemp("recorded")
    topology = resolve(load("ring6", ["steps=8"]))
    folder = create(topology, directory / "run")
    simulate_into(topology, folder, layout(topology, 1), Watching(record=False), Quiet())
    folder.event("lost", shard=0, who="agent 1", cause="silent", step=7)
    return folder.path


@pytest.fixture
def run(recorded: Path, tmp_path: Path) -> Path:
    """Return a copy of the folder, to be changed."""
    return Path(shutil.copytree(recorded, tmp_path / "run"))


def happenings(folder: Path) -> object:
    return list(Happenings(folder / "events.jsonl").new())


READERS: dict[str, list[Callable[[Path], object]]] = {
    "verdict.json": [read_verdict, load_run],
    "events.jsonl": [load_events, load_run, happenings],
    "topology.yaml": [load_resolved],
    "telemetry.parquet": [load_run],
    "edges.parquet": [load_run],
}
CASES = [(name, read) for name, readers in READERS.items() for read in readers]


def fifo(file: Path) -> None:
    os.mkfifo(file)


def device(file: Path) -> None:
    file.symlink_to("/dev/zero")


def folder_instead(file: Path) -> None:
    file.mkdir()


def outside(file: Path) -> None:
    (file.parent.parent / "theirs").write_text("{}\n")
    file.symlink_to("../theirs")


@pytest.mark.parametrize("make", [fifo, device, folder_instead, outside])
@pytest.mark.parametrize(("name", "read"), CASES)
def test_a_file_of_the_folder_that_is_not_regular_is_refused(
    name: str, read: Callable[[Path], object], make: Callable[[Path], None], run: Path
) -> None:
    (run / name).unlink()
    make(run / name)
    with pytest.raises(UserError) as error:
        read(run)
    assert error.value.code == Code.FILE_NOT_REGULAR


def test_a_link_inside_the_folder_is_followed(run: Path) -> None:
    (run / "events.jsonl").rename(run / "kept.jsonl")
    (run / "events.jsonl").symlink_to("kept.jsonl")
    load_run(run)


def test_a_folder_that_is_reached_by_a_link_is_read(run: Path) -> None:
    (run.parent / "latest").symlink_to(run.name)
    load_run(run.parent / "latest")
    load_run(run.parent / "latest")


@pytest.mark.parametrize(("name", "read"), [case for case in CASES if case[0] in ("verdict.json", "events.jsonl")])
def test_json_that_is_too_large_is_refused_unread(name: str, read: Callable[[Path], object], run: Path) -> None:
    os.truncate(run / name, 10**12)
    with pytest.raises(UserError) as error:
        read(run)
    assert error.value.code == Code.FILE_TOO_LARGE


def test_columns_count_together(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = 40_000
    pq.write_table(pa.table({name: pa.array([1.0] * rows) for name in ("x", "u", "w", "v")}), run / "telemetry.parquet")
    monkeypatch.setenv(budget.VARIABLE, "1")
    table = Table(run, "telemetry")
    for name in ("x", "u", "w", "x"):
        table.column(name, 1)
    for refused in (lambda: table.column("v", 1), table.whole):
        with pytest.raises(UserError) as error:
            refused()
        assert error.value.code == Code.FILE_TOO_LARGE


def test_an_unfinished_table_is_held_to_the_same(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (run / "telemetry.parquet").unlink()
    table = pa.table({"x": pa.array([1.0] * 400_000)})
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.ipc.new_stream(str(run / "telemetry.arrows"), table.schema, options=options) as stream:
        stream.write_table(table)
    Table(run, "telemetry").column("x", 1)
    monkeypatch.setenv(budget.VARIABLE, "1")
    with pytest.raises(UserError) as error:
        Table(run, "telemetry")
    assert error.value.code == Code.FILE_TOO_LARGE


@pytest.mark.parametrize("content", [b"", b"{", b"[" * 100_000, b"\xff", b"null\n", b'{"verdict": 1}\n'])
@pytest.mark.parametrize("read", [read_verdict, load_events, load_run])
def test_broken_json_is_refused(read: Callable[[Path], object], content: bytes, run: Path) -> None:
    for name in ("verdict.json", "events.jsonl"):
        (run / name).write_bytes(content + b"\n")
    with pytest.raises(UserError):
        read(run)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" * 100, b"hello"])
@pytest.mark.parametrize("name", ["telemetry", "edges"])
@pytest.mark.parametrize("read", [load_run])
def test_a_broken_table_is_refused(read: Callable[[Path], object], name: str, content: bytes, run: Path) -> None:
    (run / f"{name}.parquet").write_bytes(content)
    with pytest.raises(UserError) as error:
        read(run)
    assert error.value.code == Code.FILE_FORMAT
