"""Every reader of a file in a folder of ours refuses a FIFO, a device, a link out and a bomb with a message."""

import contextlib
import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hedgerow.orchestrator.experiments.sweep.folder import SweepFolder
from hedgerow.orchestrator.experiments.sweep.plan import plan
from hedgerow.orchestrator.launch.certificates import carried
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.arrow_stream import batches
from hedgerow.orchestrator.runs.table import Table
from hedgerow.orchestrator.views.rerun.opening import _unreadable
from hedgerow.orchestrator.views.rerun.watch import ArrowTail
from hedgerow.topologies import budget, json_file, toml
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.wire import config
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.session import open_router

PAIR = "{name: pair, b: 0.1, steps: 6, seed: 3, nodes: [p, q], edges: [[p, q]]}"


@pytest.fixture(autouse=True)
def _nothing_waits() -> Iterator[None]:
    """End a test that waits for a FIFO."""

    def give_up(_: int, __: FrameType | None) -> None:
        raise TimeoutError("it waits")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def sweep(folder: Path) -> None:
    file = folder.with_name("pair.yaml")
    file.write_text(PAIR)
    with SweepFolder(plan(str(file), "0:2", [], "in-process"), folder):
        pass


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "config.toml": ("config.toml", lambda folder: config.find(folder / "config.toml", "")),
    "keys": ("ca.pem", Credentials.read),
    "rules of a router": ("access.json", lambda folder: open_router("pair", "tcp/127.0.0.1:1", folder)),
    "settings of keys": ("observer/settings.json", lambda folder: carried(folder, [])),
    "sweep.json": ("sweep.json", sweep),
    "runs.jsonl": ("runs.jsonl", sweep),
    "verdict.json": ("verdict.json", lambda folder: json_file.read_json(folder / "verdict.json", folder)),
    "run.rrd": ("run.rrd", lambda folder: _raise(_unreadable([folder / "run.rrd"]))),
    "telemetry.arrows": ("telemetry.arrows", lambda folder: ArrowTail(folder / "telemetry.arrows")),
}


def _raise(why: str) -> None:
    if why:
        raise UserError(why)


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("what", ["FIFO", "device", "folder"])
def test_a_file_that_is_not_regular_is_refused(name: str, what: str, here: Path) -> None:
    file, read = READERS[name]
    path = here / "folder" / file
    path.parent.mkdir(parents=True)
    {"FIFO": os.mkfifo, "device": lambda path: path.symlink_to("/dev/zero"), "folder": Path.mkdir}[what](path)
    with pytest.raises(HedgerowError):
        read(here / "folder")


@pytest.mark.parametrize("name", ["sweep.json", "runs.jsonl", "verdict.json", "run.rrd", "telemetry.arrows"])
def test_a_link_out_of_the_folder_is_refused(name: str, here: Path) -> None:
    file, read = READERS[name]
    (here / "elsewhere").write_text("{}\n")
    path = here / "folder" / file
    path.parent.mkdir()
    path.symlink_to(here / "elsewhere")
    with pytest.raises(UserError):
        read(here / "folder")
    assert (here / "elsewhere").read_text() == "{}\n"


@pytest.mark.parametrize(
    "text",
    [b"[" * 100_000, b"{}", b"[]", b"null", b'{"set": 1}', b'{"set": {}, "versions": {}}', b"\xff", b'"\\ud800"'],
)
@pytest.mark.parametrize("name", ["sweep.json", "runs.jsonl", "settings of keys", "rules of a router", "config.toml"])
def test_other_content_is_refused(name: str, text: bytes, here: Path) -> None:
    file, read = READERS[name]
    path = here / "folder" / file
    path.parent.mkdir(parents=True)
    path.write_bytes(text + b"\n")
    with pytest.raises(HedgerowError):
        read(here / "folder")


@pytest.mark.parametrize(
    "odd",
    [{"until": "2999-01-01"}, {"until": "2999-01-01T00:00"}, {"namespace": 3}, {"endpoint": []}, {"rules": {}}],
)
def test_odd_settings_of_keys_are_refused(odd: dict[str, object], here: Path) -> None:
    good = {"endpoint": "tls/h:1", "namespace": "a", "rules": "x", "until": "2999-01-01T00:00:00+00:00"}
    (here / "observer").mkdir()
    (here / "observer/settings.json").write_text(json.dumps({**good, **odd}))
    with pytest.raises(UserError):
        carried(here, [])


def test_a_strange_list_of_running_networks_is_passed_over(here: Path) -> None:
    with registry.announced("mine", here, "tcp/127.0.0.1:1", "mine") as listed:
        good = json.loads(listed.read_text())
        others: list[object] = [
            {},
            [],
            *({**good, **odd} for odd in ({"pid": "1"}, {"traces": "/"}, {"run": 3}, {"more": 1})),
        ]
        for k, strange in enumerate(others):
            (listed.parent / f"strange-{k}.json").write_text(json.dumps(strange))
        (listed.parent / "zero.json").symlink_to("/dev/zero")
        os.mkfifo(listed.parent / "fifo.json")
        (listed.parent / "deep.json").write_text("[" * 100_000)
        assert [entry.run for entry in registry.running()] == ["mine"]


@pytest.mark.parametrize("text", ["a = " + "[" * 100_000, "a = " + "9" * 10_000, "a = [1\n", "a = 1\na = 2", "a\0 = 1"])
def test_text_that_is_no_toml_is_refused(text: str) -> None:
    with pytest.raises(UserError) as error:
        toml.loads(text, "config.toml")
    assert error.value.code == Code.FILE_FORMAT


def test_toml_and_json_count_their_parsed_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(budget.VARIABLE, "1")
    for read in (
        lambda: toml.loads("a = [" + "[]," * 20_000 + "]", "config.toml"),
        lambda: toml.loads("".join(f"[k{k}]\na = 1\n" for k in range(5000)), "config.toml"),
        lambda: json_file.loads("x.json", b"[" + b"{}," * 5000 + b"{}]"),
    ):
        with pytest.raises(UserError) as error:
            read()
        assert error.value.code == Code.FILE_TOO_LARGE


def test_a_text_that_repeats_counts_for_every_row(here: Path) -> None:
    """600,000 rows of one text of 2 kB are 1.2 GB of memory, and little of the file."""
    node = pa.DictionaryArray.from_arrays(pa.array([0] * 600_000, pa.int32()), pa.array(["x" * 2000]))
    table = pa.table({"step": pa.array(range(600_000)), "node": node})
    pq.write_table(table.replace_schema_metadata(None), here / "telemetry.parquet", store_schema=False)
    assert (here / "telemetry.parquet").stat().st_size < 10**7
    read = Table(here, "telemetry")
    for refused in (read.whole, lambda: read.column("node", 1)):
        with pytest.raises(UserError) as error:
            refused()
        assert error.value.code == Code.FILE_TOO_LARGE
    assert max(batch.nbytes for batch in read.batches()) < 2 * 64 * 2**20


def test_a_column_of_lists_is_refused(here: Path) -> None:
    pq.write_table(pa.table({"step": [[1, 2], [3]]}), here / "telemetry.parquet")
    with pytest.raises(UserError) as error:
        Table(here, "telemetry").whole()
    assert error.value.code == Code.FILE_FORMAT


def test_a_compressed_batch_is_refused_before_it_is_unpacked(here: Path) -> None:
    """One batch of zeros: 160 MB from 10 kB."""
    table = pa.table({"x": pa.array([0.0]).take(pa.array([0] * 20_000_000, pa.int32()))})
    file = here / "telemetry.arrows"
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.ipc.new_stream(str(file), table.schema, options=options) as stream:
        stream.write_batch(table.combine_chunks().to_batches()[0])
    del table
    before = pa.total_allocated_bytes()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(budget.VARIABLE, "100")
        for read in (lambda: list(batches(file)[1]), lambda: ArrowTail(file).next(), lambda: Table(here, "telemetry")):
            with pytest.raises(UserError) as error:
                read()
            assert error.value.code == Code.FILE_TOO_LARGE
    assert pa.total_allocated_bytes() - before < 10**6


def test_a_damaged_head_of_a_batch_is_refused(here: Path) -> None:
    """For every changed byte of the heads, there is an error of one type, or rows."""
    table = pa.table({"x": [1.0, 2.0], "n": ["a", "b"]})
    file = here / "telemetry.arrows"
    options = pa.ipc.IpcWriteOptions(compression="lz4")
    with pa.ipc.new_stream(str(file), table.schema, options=options) as stream:
        stream.write_table(table)
    content = file.read_bytes()
    for k in range(len(content)):
        file.write_bytes(content[:k] + bytes([content[k] ^ 0xFF]) + content[k + 1 :])
        with contextlib.suppress(UserError):
            Table(here, "telemetry").whole()
