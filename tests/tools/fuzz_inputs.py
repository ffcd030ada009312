"""Inputs of the fuzzer: TOML, tables, sweeps, keys, the list of running networks, JSON from the network.

Each case may use 5 s of processor time and 256 MB above the process before it, under a cap of 200 MB
(HEDGEROW_MEMORY_MB). An estimate that is too low is a finding.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import typer.main

from hedgerow.agents.view import View
from hedgerow.orchestrator.cli import main as cli
from hedgerow.orchestrator.experiments.sweep.folder import SweepFolder
from hedgerow.orchestrator.experiments.sweep.plan import plan
from hedgerow.orchestrator.experiments.sweep.runs import METRICS
from hedgerow.orchestrator.ground.assignment import layout, places, truth_of, views_of
from hedgerow.orchestrator.launch.certificates import carried
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.export import export
from hedgerow.orchestrator.runs.files import load_events, load_resolved, read_verdict
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.views.rerun.watch import Trail
from hedgerow.plant import request as requests
from hedgerow.plant.fault_entry import FaultEntries
from hedgerow.plant.truth import Truth
from hedgerow.topologies import budget
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import bounded_json, codec, config, keys, standalone
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.message import MessageError
from hedgerow.wire.session import _rules_in
from tests.tools.fuzz_bends import bent_bytes, bent_text

Random = random.Random
CPU_S, GROWTH_BYTES, CAP_MB = 5.0, 256 * 10**6, 200
PAIR = "{name: pair, b: 0.1, steps: 6, seed: 3, nodes: [p, q], edges: [[p, q]]}"


class CostlyError(Exception):
    """A case took too much memory or time."""


@contextlib.contextmanager
def measured() -> Iterator[None]:
    """Raise CostlyError if the block uses more memory or processor time than permitted."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    before, began = _memory("VmRSS"), time.process_time()
    try:
        yield
    finally:
        took, grown = time.process_time() - began, _memory("VmHWM") - before
        if took > CPU_S or grown > GROWTH_BYTES:
            raise CostlyError(f"{took:.1f} s, {grown / 1e6:.0f} MB")


def _memory(name: str) -> int:
    status = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in status if line.startswith(name)).split()[1])


def run(*words: str) -> None:
    """Run a command of the command line in this process."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        typer.main.get_command(cli.app).main([*words], standalone_mode=False)


def spoiled(file: Path, rng: Random, others: list[bytes]) -> None:
    """Change the content of a file, or its type."""
    content, whim = file.read_bytes(), rng.random()
    if whim < 0.15:
        file.unlink()
        match rng.randrange(6):
            case 0:
                os.mkfifo(file)
            case 1:
                file.symlink_to("/dev/zero")
            case 2:
                file.mkdir()
            case 3:
                file.symlink_to("/etc/hostname")
            case 4:
                file.symlink_to(file.name)
            case _:
                pass
    elif whim < 0.25:
        file.write_bytes(large_json(rng))
    elif whim < 0.6:
        file.write_bytes(bent_text(content, rng, others))
    else:
        file.write_bytes(bent_bytes(content, rng))


def large_json(rng: Random) -> bytes:
    """Return a text of some megabytes that becomes much more."""
    piece = rng.choice((b"[]", b"{}", b'{"a":0}', b"[[[]]]", b"0", b'""', b'"\\u0000"', '"\U0001f600"'.encode()))
    count = rng.choice((10, 10**4, 10**6))
    whole = b"[" + b",".join([piece] * count) + b"]"
    match rng.randrange(4):
        case 0:
            return whole
        case 1:
            return b"[" * count + b"]" * count
        case 2:
            return b'{"set": ' + whole + b', "versions": {}, "networks": []}'
        case _:
            return b"{" + b",".join(b'"k%d":%s' % (k, piece) for k in range(min(count, 10**5))) + b"}"


class Inputs:
    """Inputs of one kind; a subclass makes one and reads it."""

    def __init__(self, seed: int, scratch: Path) -> None:
        os.environ[budget.VARIABLE] = str(CAP_MB)
        scratch.mkdir(exist_ok=True)
        self._seed, self._scratch, self._case = seed, scratch, scratch / "case"
        self.prepare()

    def prepare(self) -> None:
        """Make the originals of the cases."""

    def make(self, rng: Random) -> Callable[[], object]:
        """Make a case, and return the function that reads it."""
        raise NotImplementedError

    def try_one(self, number: int) -> str:
        """Return `refused` or `good`; raise what a case should not."""
        rng = Random(f"{type(self).__name__} {self._seed} {number}")
        shutil.rmtree(self._case, ignore_errors=True)
        self._case.mkdir()
        try:
            reads = self.make(rng)
            pa.default_memory_pool().release_unused()
            with measured():
                reads()
        except HedgerowError as error:
            if not 0 < len(str(error).strip()) < 20_000:
                raise ValueError(f"an error of {len(str(error))} characters") from None
            return "refused"
        return "good"


class Toml(Inputs):
    """The configs of separate processes."""

    def prepare(self) -> None:
        file = self._scratch / "pair.yaml"
        file.write_text(FAULTY)
        run("bundle", str(file), "--router", "tcp/127.0.0.1:7447", "--out", str(self._scratch / "lab"))
        self._texts = [path.read_bytes() for path in sorted((self._scratch / "lab").rglob("*.toml"))]

    def make(self, rng: Random) -> Callable[[], object]:
        file = self._case / "config.toml"
        file.write_bytes(rng.choice(self._texts))
        if rng.random() < 0.1:
            file.write_bytes(large_toml(rng))
        else:
            spoiled(file, rng, self._texts)
        return lambda: self._take(file)

    @staticmethod
    def _take(file: Path) -> None:
        found = config.find(file, "config.toml")
        is_plant = found.process == keys.PLANT
        standalone.part(found, Truth.from_dict if is_plant else View.from_dict)
        standalone.part(found, lambda known: standalone.token(found.process, known))


def large_toml(rng: Random) -> bytes:
    """Return a text that becomes much more, or is deep."""
    count = rng.choice((100, 10**4, 3 * 10**5))
    return rng.choice(
        (
            b"a = [" + b"[]," * count + b"]",
            b"a = " + b"[" * count,
            b"a = " + b"{a=" * count,
            b".".join([b"a"] * min(count, 10**4)) + b" = 1",
            b"[" + b".".join([b"a"] * min(count, 10**4)) + b"]",
            b"".join(b"[k%d]\n" % k for k in range(count)),
            b"".join(b"k%d = 1\n" % k for k in range(count)),
            b"[[a]]\n" * count,
            b"a = " + b"9" * count,
        )
    )


FAULTY = """
name: faulty
b: 0.1
steps: 20
seed: 3
processes: 2
defaults: {x0: {random: [-1, 1]}, candidates: {random: 3}, disturbance: {kind: white, std: 0.1}}
nodes: [1, 2, hub, 4]
edges: [[1, hub], [hub, 2], [4, hub]]
faults:
  - {kind: drop, link: [1, hub], steps: [3, 9], probability: 0.5}
  - {kind: delay, from: hub, to: 4, by: 3}
  - {kind: crash, process: 1, at: 4, restart_after: 5}
"""


class OfARun(Inputs):
    """Inputs that are made of the folder of one run."""

    def prepare(self) -> None:
        file = self._scratch / "faulty.yaml"
        file.write_text(FAULTY)
        self._run = self._scratch / "run"
        run("simulate", str(file), "--no-record", "--run-dir", str(self._run))


class Tables(OfARun):
    """The tables of a run, rewritten with other columns, types, codings and lengths, or with changed bytes."""

    def make(self, rng: Random) -> Callable[[], object]:
        folder = self._case / "run"
        shutil.copytree(self._run, folder)
        for name in rng.sample(("telemetry", "edges", "summary"), rng.choice((1, 1, 2))):
            file = folder / f"{name}.parquet"
            table = pq.read_table(file)
            if rng.random() < 0.7:
                table = self._changed(table, rng)
            elif rng.random() < 0.3:  # few bytes, many rows
                rows = rng.choice((10**5, 5 * 10**5))
                table = pa.table({name: pa.repeat(table[name][0], rows) for name in table.column_names})
            if rng.random() < 0.5:
                file.unlink()
                file = folder / f"{name}.arrows"
                self._stream(file, table, rng)
            else:
                self._parquet(file, table, rng)
            if rng.random() < 0.4:
                file.write_bytes(bent_bytes(file.read_bytes(), rng))
        form = rng.choice(("csv", "parquet", "npz"))
        return rng.choice(
            (
                lambda: self._follow(folder),
                lambda: self._all(folder),
                lambda: export(load_run(folder), form, self._case / "out"),
            )
        )

    @staticmethod
    def _all(folder: Path) -> None:
        recorded = load_run(folder)
        _ = recorded.x, recorded.u, recorded.open, recorded.regret, recorded.metrics
        recorded.telemetry()
        recorded.edges_table()

    @staticmethod
    def _follow(folder: Path) -> None:
        topology = load_resolved(folder)
        with contextlib.suppress(FileNotFoundError):
            trail = Trail(folder, topology.graph)
            while trail.take(64):
                pass

    @staticmethod
    def _changed(table: Any, rng: Random) -> Any:
        k, rows = rng.randrange(table.num_columns), len(table)
        name, column = table.column_names[k], table.column(k).combine_chunks()
        kind = rng.choice((pa.int8(), pa.float16(), pa.string(), pa.bool_(), pa.float32(), pa.large_string()))
        others: tuple[Callable[[], Any], ...] = (
            lambda: pa.array([None] * rows, column.type),
            lambda: pa.array(["x" * rng.choice((1, 10**4))] * rows),
            lambda: pa.array([[1.0] * rng.choice((0, 100))] * rows),
            lambda: pa.array([{"a": 1}] * rows),
            lambda: column.cast(kind, safe=False),
            column.dictionary_encode,
        )
        match rng.randrange(4):
            case 0:
                return table.remove_column(k)
            case 1:
                return table.slice(0, rng.randrange(rows + 1))
        with contextlib.suppress(pa.ArrowException, NotImplementedError):
            return table.set_column(k, name, rng.choice(others)())
        return table

    @staticmethod
    def _parquet(file: Path, table: Any, rng: Random) -> None:
        kinds = rng.choice(("none", "zstd", "snappy", "gzip"))
        with contextlib.suppress(pa.ArrowException, NotImplementedError):
            pq.write_table(table, file, compression=kinds, store_schema=rng.random() < 0.5)

    @staticmethod
    def _stream(file: Path, table: Any, rng: Random) -> None:
        compression = rng.choice((None, None, "zstd", "lz4"))
        options = pa.ipc.IpcWriteOptions(compression=compression)
        with pa.ipc.new_stream(str(file), table.schema, options=options) as stream:
            stream.write_table(table, max_chunksize=rng.choice((20, 10**7)))


class Sweeps(Inputs):
    """The folder of a sweep to continue."""

    def prepare(self) -> None:
        file = self._scratch / "pair.yaml"
        file.write_text(PAIR)
        self._plan = plan(str(file), "0:3", ["defaults.x0=1,2"], "in-process")
        row = {**dict.fromkeys((*METRICS, "share_right"), 0.5), "nodes_right": 2, "verdict": "valid", "reasons": ""}
        self._rows = b"".join(
            json.dumps({"setting": k, "seed": seed, **row}).encode() + b"\n" for k in range(2) for seed in range(3)
        )

    def make(self, rng: Random) -> Callable[[], object]:
        folder = self._case / "sweep"
        folder.mkdir()
        about = json.dumps(self._plan.identity).encode()
        (folder / "sweep.json").write_bytes(about)
        (folder / "runs.jsonl").write_bytes(self._rows)
        for name in rng.choice((("sweep.json",), ("runs.jsonl",), ("runs.jsonl", "sweep.json"))):
            spoiled(folder / name, rng, [about, self._rows])
        return lambda: self._go_on(folder)

    def _go_on(self, folder: Path) -> None:
        with SweepFolder(self._plan, folder) as sweep:
            if sweep.there == 6:
                sweep.write_table()


class Keys(Inputs):
    """The folders of keys that were carried."""

    def prepare(self) -> None:
        file = self._scratch / "pair.yaml"
        file.write_text(PAIR)
        self._keys = self._scratch / "keys"
        run("keys", str(file), "--router", "tls/127.0.0.1:7447", "--out", str(self._keys))
        topology = resolve(load(str(file)))
        self._places = places(views_of(topology, layout(topology, None)))
        self._texts = [path.read_bytes() for path in sorted(self._keys.rglob("*")) if path.is_file()]

    def make(self, rng: Random) -> Callable[[], object]:
        folder = self._case / "keys"
        shutil.copytree(self._keys, folder)
        read = ("observer/settings.json", "router/access.json", "agent-p/key.pem", "agent-p/ca.pem", "router/cert.pem")
        for name in rng.sample(read, rng.choice((1, 2, 4))):
            file = folder / name
            spoiled(file, rng, self._texts)
        own = folder / rng.choice(("agent-p", "router"))
        return rng.choice(
            (
                lambda: carried(folder, self._places),
                lambda: _rules_in(folder / "router"),
                lambda: Credentials.read(own).tls(),
            )
        )


class Registry(Inputs):
    """The list of running networks."""

    def prepare(self) -> None:
        os.environ["XDG_RUNTIME_DIR"] = str(self._scratch)
        (self._scratch / f"hedgerow-{os.getuid()}").mkdir(mode=0o700, exist_ok=True)

    def make(self, rng: Random) -> Callable[[], object]:
        folder = self._scratch / f"hedgerow-{os.getuid()}"
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:  # rmtree would open a FIFO, and wait
                path.unlink()
        with registry.announced("mine", self._case, "tcp/127.0.0.1:1", "mine") as listed:
            content = listed.read_bytes()
        for k in range(3):
            other = folder / f"other-{k}.json"
            other.write_bytes(content)
            spoiled(other, rng, [content])
        name = rng.choice((None, "m", "other", str(self._case)))
        return lambda: self._look(name)

    def _look(self, name: str | None) -> None:
        with registry.announced("mine", self._case, "tcp/127.0.0.1:1", "mine"):
            if not any(entry.run == "mine" for entry in registry.running()):
                raise ValueError("a running network is not listed")
            registry.find("mine")
            registry.find(name)


class Requests(Inputs):
    """JSON from the network: commands, answers and events."""

    def prepare(self) -> None:
        file = self._scratch / "faulty.yaml"
        file.write_text(FAULTY)
        topology = resolve(load(str(file)))
        self._graph = topology.graph
        truth = truth_of(topology, layout(topology, None))
        self._entries = FaultEntries(topology.graph, truth.ids, truth.shards, truth.candidates)
        entry = {"kind": "drop", "link": [1, "hub"], "steps": [3, 9], "at": {"3": 1}}
        self._texts = [
            json.dumps(one).encode()
            for one in (
                {"entry": entry, "name": "it"},
                {"entry": {"kind": "drop", "link": [1, "hub"], "steps": [3, 9], "probability": 0.5}},
                {"entry": {"kind": "drop", "at": {"3": [[1, "hub"]], "5": []}}},
                {"entry": {"kind": "jump", "node": 1, "at": 3, "a": 0.5}},
                {"entry": {"kind": "partition", "groups": [[1], ["hub"]], "cut": True}},
                {"rate": 50, "steps": 3, "fault": 1},
                {"event": "kill", "shard": 1, "life": 0},
                {"process": "agent-1", "number": 5, "release": "1", "network": "x"},
            )
        ]

    def make(self, rng: Random) -> Callable[[], object]:
        text = rng.choice(self._texts)
        if rng.random() < 0.1:
            payload = large_json(rng)
        else:
            payload = bent_text(text, rng, self._texts) if rng.random() < 0.6 else bent_bytes(text, rng)
        return lambda: self._ask(payload)

    def _ask(self, payload: bytes) -> None:
        with contextlib.suppress(ValueError):
            json.dumps(bounded_json.decode(payload)).encode()
        with contextlib.suppress(MessageError):
            codec.decode_event(codec.encode_event(3, {})[: codec._SIZE] + payload)
        request = requests.read(payload, self._graph)
        for reads in (
            lambda: self._entries.effects(requests.entry(request), 1),
            lambda: requests.integer(request, "steps", 0, 10**9),
            lambda: requests.number(request, "rate", 0.0, 1e9),
            lambda: requests.text(request, "name"),
        ):
            try:
                reads()
            except HedgerowError as error:
                json.dumps({"error": str(error)}).encode()


class Words(OfARun):
    """verdict.json and events.jsonl of a run."""

    def make(self, rng: Random) -> Callable[[], object]:
        names = ("verdict.json", "events.jsonl")
        for name in names:
            shutil.copy(self._run / name, self._case)
        spoiled(self._case / rng.choice(names), rng, [(self._run / name).read_bytes() for name in names])
        return lambda: (read_verdict(self._case), load_events(self._case))


class Everything:
    """All kinds in turn, in one process."""

    def __init__(self, seed: int, scratch: Path) -> None:
        self._kinds = [kind(seed, scratch / name) for name, kind in KINDS.items()]

    def try_one(self, number: int) -> str:
        """Return the result of a case."""
        kind = self._kinds[number % len(self._kinds)]
        return f"{type(kind).__name__}: {kind.try_one(number)}"


KINDS: dict[str, type[Inputs]] = {
    "toml": Toml,
    "tables": Tables,
    "sweeps": Sweeps,
    "keys": Keys,
    "registry": Registry,
    "requests": Requests,
    "words": Words,
}
