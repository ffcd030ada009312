"""`python -m tests.tools.fuzz`: damaged files and messages, and their results.

Each case is drawn from (seed, number) alone, so `--only NUMBER` tries one again. Files go through the commands of a
user; each file is refused with a message or fully accepted. Messages go through the decoders; one is taken, or is a
MessageError. Anything else is a finding: another exception, 20 s of processor time, 4 GB of memory, a death.

The cases run in a separate process, which prints the number of each case first: so a case that dies or hangs is known.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import typer.main

from hedgerow.agents.view import View
from hedgerow.orchestrator.cli import main as cli
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs.files import load_resolved
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.views.event_line import event_line
from hedgerow.orchestrator.views.rerun.opening import _open
from hedgerow.orchestrator.views.rerun.viewer import Viewer
from hedgerow.orchestrator.views.rerun.watch import Happenings, Trail
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.plant.truth import Truth
from hedgerow.topologies import table
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.load import bundled, find, load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import codec
from hedgerow.wire.message import REPORT_ROWS, End, Link, MessageError, Record, RoundTripTimes, Span, Telemetry
from hedgerow.wire.ports import free_port
from hedgerow.wire.stream import Inbox
from tests.tools import fuzz_inputs
from tests.tools.fuzz_bends import bent_bytes, bent_text

ROOT = Path(__file__).parents[2]
CASE_CPU_S = 20.0
CASE_WALL_S = 180.0
"""after this time, the parent counts the case as a hang"""
WORKER_CASES = 1000
"""the maximum number of cases per worker: libraries store parts of damaged files, which is not the subject here"""
MEMORY_BYTES = 4 * 2**30
SHOWN = 20

Random = random.Random


# ---- the damage

FAULTY = b"""\
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
  - {kind: drop, from: hub, to: 2}
  - {kind: delay, from: hub, to: 4, by: 3}
  - {kind: cut, edge: [2, hub], steps: [0, 5]}
  - {kind: partition, groups: [[1, hub], [2, 4]], cut: true}
  - {kind: sensor, node: 1, steps: [5, 9]}
  - {kind: crash, process: 1, at: 4, restart_after: 5}
  - {kind: jump, node: 4, at: 15, a: random}
"""
SAMPLED = b"""\
name: sampled
b: 0.1
steps: 4
nodes: {a: {a: 0.5, candidates: [0.5, 0.3]}, b: {a: 0.3, candidates: [0.3]}}
edges: [[a, b]]
defaults: {disturbance: {kind: samples, file: w.csv}}
"""
RULED = b"""\
name: ruled
b: 0.05
steps: 3
graph: {kind: random_regular, nodes: 10, degree: 3}
nodes: {7: {x0: 3}}
defaults: {candidates: {random: 3}, disturbance: {kind: white, std: 0.1}}
"""
TABLED = b"{name: tabled, b: 0.05, steps: 3, table: t.npz}\n"
SAMPLES = (b"a,b\n1,2\n0.5,-1\n1e-3,4\n0,0\n", b"1,2\n3,4\n5,6\n7,8\n", b'"a","b"\r\n1,2\r\n3,4\r\n1,1\r\n2,2\r\n')


def topology_texts() -> list[bytes]:
    """The bundled networks, the examples of the docs, and one with everything that can go wrong."""
    files = [find(name) for name in bundled()] + sorted((ROOT / "docs/examples").glob("*.yaml"))
    return [FAULTY, SAMPLED, RULED, TABLED, *(file.read_bytes() for file in files)]


def record_folder(directory: Path) -> Path:
    """Return a run folder with everything in it: tables, streams of a live run, a recording, processes."""
    text = directory / "faulty.yaml"
    text.write_bytes(FAULTY)
    topology = resolve(load(str(text)))
    folder = create(topology, directory / "run")
    shards = layout(topology, 2)
    simulate_into(topology, folder, shards, Watching(record=True), Quiet())
    for view in views_of(topology, shards):
        view.write(folder.processes / f"shard-{view.shard}.npz")
    truth_of(topology, shards).write(folder.processes / "plant.npz")
    for name in ("telemetry", "edges"):
        rows = pq.read_table(folder.path / f"{name}.parquet")
        with pa.ipc.new_stream(str(folder.path / f"{name}.arrows"), rows.schema) as stream:
            width = len(topology.ids) if name == "telemetry" else len(topology.edges)
            for first in range(0, len(rows), 5 * width):  # the last state is a separate batch
                stream.write_table(rows.slice(first, 5 * width))
    folder.event("lost", shard=0, who="agent 1", cause="silent", step=7)
    return folder.path


# ---- the cases


@dataclass(frozen=True)
class Finding:
    """A case with a finding."""

    kind: str
    number: int
    what: str

    def __str__(self) -> str:
        return f"{self.kind} {self.number}: {self.what}"


def _worded(error: HedgerowError) -> None:
    """Check that an error has a text that fits on one screen."""
    if not 0 < len(str(error).strip()) < 20_000:
        raise ValueError(f"an error of {len(str(error))} characters")


class SlowError(BaseException):
    """A case took too much of the processor; no `except Exception` is to swallow it."""


class Files:
    """Files of all kinds, each given to the command that reads it."""

    def __init__(self, seed: int, scratch: Path) -> None:
        self._seed, self._scratch = seed, scratch
        self._texts = topology_texts()
        self._command = typer.main.get_command(cli.app)
        self._folder = record_folder(scratch)
        self._table = scratch / "t.npz"
        ruled = scratch / "ruled.yaml"
        ruled.write_bytes(RULED)
        table.write(resolve(load(str(ruled))).network, self._table)
        self._case = scratch / "case"

    @cached_property
    def _viewer(self) -> Viewer:
        """A stand-in for a viewer, which accepts the same calls."""
        import rerun as rr  # noqa: PLC0415

        self._server = rr.RecordingStream("fuzz")
        return Viewer(self._server.serve_grpc(grpc_port=free_port(), server_memory_limit="16MB"))

    def try_one(self, number: int) -> str:
        """Try a case; return `refused` or `good`, and its kind; raise an exception for a finding."""
        rng = Random(f"files {self._seed} {number}")
        shutil.rmtree(self._case, ignore_errors=True)
        self._case.mkdir()
        kind, body = rng.choices(
            (
                ("topology", self._topology),
                ("samples", self._samples),
                ("run folder", self._run_folder),
                ("process file", self._process_file),
                ("table", self._numbers),
            ),
            (46, 10, 32, 6, 6),
        )[0]
        try:
            body(rng)
        except HedgerowError as error:
            _worded(error)
            return f"{kind}: refused"
        return f"{kind}: good"

    def _run(self, *words: str) -> None:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            self._command.main([*words], standalone_mode=False)

    def _topology(self, rng: Random) -> None:
        file = self._case / "bent.yaml"
        file.write_bytes(bent_text(rng.choice(self._texts), rng, self._texts))
        (self._case / "w.csv").write_bytes(SAMPLES[0])
        shutil.copy(self._table, self._case)
        self._check_and_run(file)

    def _check_and_run(self, file: Path) -> None:
        self._run("check", str(file))
        # The checked topology is valid, so it must run. (Its steps and its law may be arbitrary.)
        if len(resolve(load(str(file)), file.parent).ids) < 1000:
            sets = ("--steps", "3", "--set", "faults=[]", "--set", "law=minimax", "--set", "processes=1")
            with contextlib.suppress(HedgerowError):  # samples may be too short for 3 steps
                self._run("simulate", str(file), *sets, "--no-record", "--run-dir", str(self._case / "ran"))

    def _samples(self, rng: Random) -> None:
        file = self._case / "sampled.yaml"
        file.write_bytes(SAMPLED)
        content = rng.choice(SAMPLES)
        bent = bent_bytes(content, rng) if rng.random() < 0.3 else bent_text(content, rng, SAMPLES)
        (self._case / "w.csv").write_bytes(bent)
        self._check_and_run(file)

    def _numbers(self, rng: Random) -> None:
        file = self._case / "tabled.yaml"
        file.write_bytes(TABLED)
        (self._case / "t.npz").write_bytes(bent_bytes(self._table.read_bytes(), rng))
        self._check_and_run(file)

    def _process_file(self, rng: Random) -> None:
        file = rng.choice(sorted((self._folder / "processes").iterdir()))
        bent = self._case / file.name
        bent.write_bytes(bent_bytes(file.read_bytes(), rng))
        (Truth if "plant" in file.name else View).read(bent)

    def _run_folder(self, rng: Random) -> None:
        folder = self._case / "run"
        shutil.copytree(self._folder, folder)
        going_on = rng.random() < 0.3
        for name in ("telemetry", "edges"):
            (folder / f"{name}.{'parquet' if going_on else 'arrows'}").unlink()
        files = [file for file in sorted(folder.iterdir()) if file.is_file()]
        for file in rng.sample(files, rng.choice((1, 1, 1, 2, 3))):
            self._bend(file, rng)
        ways: dict[str, Callable[[], None]] = {
            "export": lambda: self._export(folder, rng),
            "simulate": lambda: self._run(
                "simulate", str(folder), "--no-record", "--run-dir", str(self._case / "ran"), "--steps", "2"
            ),
            "open": lambda: _open(folder, self._viewer, lambda _: None, lambda: True),
            "watch": lambda: self._watch(folder),
            "report": lambda: self._run("report", str(folder), "--figures", "4", "--out", str(self._case / "out")),
        }
        ways[rng.choices([*ways], (50, 15, 20, 12, 3))[0]]()

    def _bend(self, file: Path, rng: Random) -> None:
        whim = rng.random()
        if whim < 0.04:
            file.unlink()
        elif whim < 0.08:
            file.write_bytes(b"")
        elif whim < 0.12:
            file.unlink()
            file.symlink_to(rng.choice(("nowhere", ".", str(file), "/dev/null", "../run", "/etc/hostname")))
        elif whim < 0.15:
            file.unlink()
            file.mkdir()
        elif file.suffix in (".yaml", ".json", ".jsonl") and whim < 0.9:
            file.write_bytes(bent_text(file.read_bytes(), rng, self._texts))
        else:
            file.write_bytes(bent_bytes(file.read_bytes(), rng))

    def _export(self, folder: Path, rng: Random) -> None:
        form = rng.choice(("csv", "parquet", "npz", "npz", "mat"))
        self._run("export", str(folder), "--to", form, "--out", str(self._case / "out"))

    def _watch(self, folder: Path) -> None:
        topology = load_resolved(folder)
        try:
            trail = Trail(folder, topology.graph)
        except FileNotFoundError:
            return
        for event in Happenings(folder / "events.jsonl").new():
            event_line(event)
        observer = Observer(topology)
        while rows := trail.take(64):
            observer.take(rows)


class Payloads:
    """Messages of every kind, each given to every decoder that may meet it."""

    def __init__(self, seed: int, _: Path) -> None:
        self._seed = seed
        k, m, n, e = 3, 5, 4, 6
        x, flags = np.arange(float(k)), np.ones(m, np.uint8)
        back, degrees = np.array([True, False, True]), np.array([2, 1, 2])
        record = Record(9, back, 5, np.ones((4, 2)), np.ones((4, 2)), np.ones((4, 4), np.uint8))
        link = Link(7, 7, x.tobytes(), x.tobytes())
        far = Link(7, 5, np.ones((3, 3)).tobytes(), np.ones((3, 3)).tobytes())
        ones, bits = np.ones(n), np.ones(e, np.uint8)
        row = Telemetry(
            4,
            ones,
            ones,
            ones,
            np.ones((REPORT_ROWS, n)),
            bits,
            np.ones(2 * e, np.uint8),
            np.ones(2 * e, np.uint8),
        )
        self._messages: list[bytes] = [
            codec.encode_state(7, x, flags),
            codec.encode_state(7, x, flags, [Span(2, 1, 0, 0, 3)]),
            codec.encode_record(record),
            codec.encode_input(7, x, np.ones((REPORT_ROWS, k)), flags),
            codec.encode_link(link, k),
            codec.encode_link(far, k),
            codec.join(codec.encode_telemetry(row)),
            codec.join(codec.encode_telemetry(row, whole=True)),
            codec.encode_round_trips(RoundTripTimes(2, np.ones((3, k)))),
            codec.encode_end(End(9, ones, 1.5)),
            codec.encode_seen(12),
            codec.encode_event(3, {"event": "kill", "shard": 1, "life": 0}),
            codec.encode_event(3, {"event": "x", "a": [[[{}]]]}),
            codec.encode_batch(0, [codec.encode_telemetry(row), (codec.encode_seen(12),)]),
        ]
        self._decoders: tuple[Callable[[bytes], object], ...] = (
            lambda message: codec.decode_state(message, k, m),
            lambda message: codec.decode_record(message, degrees),
            lambda message: codec.decode_input(message, k, m),
            lambda message: codec.decode_link(message, k),
            lambda message: codec.decode_telemetry(message, n, e),
            lambda message: codec.decode_round_trips(message, k),
            lambda message: codec.decode_end(message, n),
            lambda message: codec.decode_end(message, 0),
            codec.decode_seen,
            codec.decode_event,
            codec.decode_batch,
            codec.kind_of,
            lambda message: Inbox().put(message),
        )

    def try_one(self, number: int) -> str:
        """Try a case; raise an exception for a finding."""
        rng = Random(f"payloads {self._seed} {number}")
        message = rng.choice(self._messages)
        if rng.random() < 0.3:  # a valid header with any bytes after it
            kind = rng.randrange(10)
            head = codec._HEADER.pack(codec.VERSION, kind, 0, rng.choice((0, 3, 4, 2**32 - 1)), rng.choice((0, 7, -1)))
            depth = rng.choice((1, 100, 100_000))
            tails = (b"[" * depth, b'{"a":' * depth, b"9" * depth, rng.randbytes(rng.randrange(200)), b"null", b"\xff")
            message = head + rng.choice(tails)
        else:
            message = bent_bytes(message, rng)
        taken = False
        for decode in self._decoders:
            try:
                decode(message)
            except MessageError as error:
                _worded(error)
            else:
                taken = taken or decode not in self._decoders[-3:]
        return "good" if taken else "refused"


class Planted:
    """Planted findings: an exception, a hang, a death."""

    def __init__(self, _: int, __: Path) -> None:
        pass

    def try_one(self, number: int) -> str:
        """One of each."""
        match number:
            case 1:
                raise KeyError("planted")
            case 2:
                signal.setitimer(signal.ITIMER_PROF, 0.2)
                while True:
                    with contextlib.suppress(Exception):
                        hash(number)
            case 3:
                os.kill(os.getpid(), signal.SIGSEGV)
        return "good"


KINDS: dict[str, Callable[[int, Path], Files | Payloads | Planted | fuzz_inputs.Inputs | fuzz_inputs.Everything]] = {
    "files": Files,
    "payloads": Payloads,
    "planted": Planted,
    "inputs": fuzz_inputs.Everything,
    **fuzz_inputs.KINDS,
}


# ---- the worker: one case after another, with one line each


def work(kind: str, seed: int, numbers: Sequence[int], scratch: Path) -> None:
    """Try these cases; print each number before its case, and the result after it."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    warnings.simplefilter("ignore")  # the file may cause overflows
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def too_slow(_: int, frame: FrameType | None) -> None:
        raise SlowError

    signal.signal(signal.SIGPROF, too_slow)
    os.chdir(scratch)
    cases = KINDS[kind](seed, scratch)
    for number in numbers:
        out.write(f"{json.dumps([number])}\n")
        signal.setitimer(signal.ITIMER_PROF, CASE_CPU_S)
        try:
            became, wrong = cases.try_one(number), ""
        except (Exception, SlowError) as error:
            last = traceback.extract_tb(error.__traceback__)[-6:]
            where = " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(last))
            became, wrong = "finding", f"{type(error).__name__}: {str(error)[:200]} ({where})"
        signal.setitimer(signal.ITIMER_PROF, 0)
        out.write(f"{json.dumps([number, became, wrong])}\n")
    out.flush()
    os._exit(0)


# ---- the distribution of the cases


def fuzz(kind: str, seed: int, numbers: Sequence[int]) -> tuple[Counter[str], list[Finding]]:
    """Try these cases of a kind; return the counts of the results, and the findings."""
    counts: Counter[str] = Counter()
    findings: list[Finding] = []
    left = list(numbers)
    while left:
        with tempfile.TemporaryDirectory(prefix="hedgerow-fuzz-") as scratch:
            begun: int | None = None
            exit_codes: list[int | None] = []
            for number, *ended in _lines(kind, seed, left[:WORKER_CASES], Path(scratch), exit_codes.append):
                begun = number
                if ended:
                    counts[ended[0]] += 1
                    if ended[1]:
                        findings.append(Finding(kind, number, ended[1]))
                    left.remove(number)
                    begun = None
            if begun is not None:
                (code,) = exit_codes
                how = "hung" if code is None else f"died with exit code {code}"
                findings.append(Finding(kind, begun, f"the process {how}"))
                counts["finding"] += 1
                left.remove(begun)
            elif left and left == [*numbers]:
                raise RuntimeError("the worker does not begin; see its standard error")
    return counts, findings


def _lines(
    kind: str, seed: int, numbers: Sequence[int], scratch: Path, on_end: Callable[[int | None], None]
) -> Iterator[list[Any]]:
    """Yield the lines of a worker, until it ends or is silent for too long; `on_end` gets its exit code, or None."""
    silent = False
    words = [
        sys.executable,
        "-P",
        "-m",
        "tests.tools.fuzz",
        "--worker",
        kind,
        "--seed",
        str(seed),
        "--scratch",
        str(scratch),
    ]
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    worker = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment | {"PYTHONPATH": path}
    )
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write(json.dumps(list(numbers)).encode())
    worker.stdin.close()

    def give_up(_: int, frame: FrameType | None) -> None:
        nonlocal silent
        silent = True
        worker.kill()

    before = signal.signal(signal.SIGALRM, give_up)
    try:
        signal.alarm(int(CASE_WALL_S))
        for line in worker.stdout:
            signal.alarm(int(CASE_WALL_S))
            with contextlib.suppress(ValueError):  # it was killed in the middle of a line
                yield json.loads(line)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        worker.stdout.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            worker.wait(1)  # its output ends a moment before it does
        worker.kill()
        code = worker.wait()
        on_end(None if silent else code)


def main() -> None:
    """Try a number of cases of each kind, and print the results; exit code 1 if any is a finding."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.fuzz", description=main.__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--payloads", type=int, default=10_000)
    for kind in fuzz_inputs.KINDS:
        parser.add_argument(f"--{kind}", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="the number of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="this case of the kinds that are not 0")
    parser.add_argument("--worker", choices=KINDS, help=argparse.SUPPRESS)
    parser.add_argument("--scratch", type=Path, help=argparse.SUPPRESS)
    known = parser.parse_args()
    if known.worker:
        work(known.worker, known.seed, json.load(sys.stdin), known.scratch)
    wrong = 0
    for kind in ("files", "payloads", *fuzz_inputs.KINDS):
        if not (count := getattr(known, kind)):
            continue
        began = time.monotonic()
        counts, findings = fuzz(
            kind, known.seed, range(known.first, known.first + count) if known.only is None else [known.only]
        )
        listed = ", ".join(f"{counts[name]} {name}" for name in sorted(counts))
        print(f"{count} {kind}, seed {known.seed}: {listed}; {time.monotonic() - began:.0f} s", flush=True)
        print(*findings[:SHOWN], sep="\n", end="\n" if findings else "")
        wrong += len(findings)
    print(f"{wrong} findings")
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
