"""The documents agree with the code: their tables equal it, and their commands are run.

In a fenced block of README.md or docs/*.md

    ```console          each line `$ orchestrator …` is run, and must exit with 0, or with what `# exit 2` behind it
                        claims; what is shown below it must be what it prints, `...` standing for anything;
                        lines with `# not run`, and other commands, are passed over
    ```python           is run, and must exit with 0; a ```text block right behind it is what it must print
    ```python NAME      the same, kept as a file of that name
    ```yaml NAME        is kept as a file of that name (and so with any other language)

The blocks of one document share a scratch folder, and run in its order.
"""

from __future__ import annotations

import doctest
import importlib
import json
import os
import re
import runpy
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import pyarrow.ipc
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image

from hedgerow.orchestrator.metrics.fault_accounts import Account
from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.orchestrator.runs.writer import to_parquet
from hedgerow.orchestrator.views.rerun.panels import lines, totals
from hedgerow.topologies.errors import Code
from hedgerow.topologies.faults import KINDS
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import codec, keys, session
from hedgerow.wire.message import REPORT_ROWS, End, Flag, Kind, Link, Record, RoundTripTimes, Span, Telemetry
from tests.tools import preloaded
from tests.tools.networks import observe, read, simulate

ROOT = Path(__file__).parents[1]
DOCS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SLOW = {
    "README.md",
    "data.md",
    "faults.md",
    "guarantee.md",
    "import.md",
    "laws.md",
    "machines.md",
    "paper.md",
    "report.md",
    "run-folder.md",
    "security.md",
    "theory.md",
    "watching.md",
    "your-law.md",
    "your-network.md",
    "zoo.md",
}
"""Documents with blocks that take more than five seconds."""
GENERATED = "topology.md"
"""docs/generate.py runs its commands and writes their output: test_topology_md_is_fresh."""
COMMAND_DEADLINE_S = 120.0


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, the file name after it, its first line, and its content."""

    language: str
    name: str
    line: int
    text: str


def blocks(document: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a document, in order; a block of output right after a block is recognised by its
    line.
    """
    fence = re.compile(r"^```(\w+)?[ ]*(\S*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    text = document.read_text(encoding="utf-8")
    for found in fence.finditer(text):
        line = text[: found.start()].count("\n") + 1
        yield Block(found[1] or "", found[2], line, found[3])


def follows(before: Block, block: Block) -> bool:
    """Return True if only an empty line separates two blocks."""
    return block.line == before.line + before.text.count("\n") + 3


def commands(console: str) -> Iterator[tuple[str, int, str]]:
    """Yield each command to run, its expected exit code, and its output on the page."""
    for part in re.split(r"^\$ ", console, flags=re.MULTILINE)[1:]:
        command, _, shown = part.partition("\n")
        command, _, comment = command.partition("#")
        if not command.startswith("orchestrator") or "not run" in comment:
            continue
        claim = re.search(r"exits?(?: code)? (\d+)", comment)
        yield command.strip(), int(claim[1]) if claim else 0, shown


def same_output(shown: str, printed: str) -> bool:
    """Return True if the shown output was printed, up to blanks and with `...` for any text."""
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    return doctest.OutputChecker().check_output(shown.strip(), printed.strip(), flags)


class Scratch:
    """The folder of a document: no command writes or reads outside of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        runtime = folder / ".runtime"
        runtime.mkdir()
        hidden = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")
        self.environment = {key: value for key, value in os.environ.items() if key not in hidden} | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "XDG_RUNTIME_DIR": str(runtime),
            "COLUMNS": "160",
        }
        self.python: tuple[str, ...] = (sys.executable, "-W", "error")

    def preload(self) -> None:
        """Let commands and programs begin in processes that have loaded the modules already."""
        self.python = (str(preloaded.SESSION.programs / "program"),)
        self.environment["PATH"] = f"{preloaded.SESSION.programs}{os.pathsep}{self.environment['PATH']}"

    def run(self, *command: str) -> tuple[int, str]:
        """The exit code of a command, and all that it printed."""
        ran = subprocess.run(
            command,
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=COMMAND_DEADLINE_S,
            check=False,
        )
        return ran.returncode, ran.stdout


def document_parameters() -> list[Any]:
    return [pytest.param(path, id=path.name, marks=[pytest.mark.slow] if path.name in SLOW else []) for path in DOCS]


@pytest.mark.parametrize("document", document_parameters())
def test_a_document_shows_the_real_output(document: Path, tmp_path: Path) -> None:
    """Every command exits as claimed, every program runs, and their outputs equal those on the page."""
    scratch = Scratch(tmp_path)
    if document.name != "README.md":  # its commands start the installed program
        scratch.preload()
    program: tuple[Block, str] | None = None
    for block in blocks(document):
        where = f"{document.name}:{block.line}"
        if block.name:
            (tmp_path / block.name).write_text(block.text, encoding="utf-8")
        match block.language:
            case "python":
                name = block.name or "block.py"
                (tmp_path / name).write_text(block.text, encoding="utf-8")
                code, printed = scratch.run(*scratch.python, name)
                assert code == 0, f"{where}: exit code {code}\n{printed}"
                program = (block, printed)
            case "text" if program is not None and follows(program[0], block):
                assert same_output(block.text, program[1]), f"{where}: printed is\n{program[1]}"
            case "console" if document.name != GENERATED:
                for command, claimed, shown in commands(block.text):
                    code, printed = scratch.run("bash", "-o", "pipefail", "-c", command)
                    assert code == claimed, f"{where}: `{command}`: exit code {code}, not {claimed}\n{printed}"
                    shows = not shown.strip() or same_output(shown, printed)
                    assert shows, f"{where}: `{command}` prints\n{printed}"
    if any(block.language in ("python", "console") for block in blocks(document)):
        code, running = scratch.run("orchestrator", "ps", "--json")
        assert (code, json.loads(running)) == (0, [])


def test_there_is_something_to_run() -> None:
    """An unrecognised fence would make the test above pass."""
    shown = [(block.language, *commands(block.text)) for path in DOCS for block in blocks(path)]
    assert sum(language == "console" and bool(rest) for language, *rest in shown) > 10
    assert sum(language == "python" for language, *_ in shown) > 5


def test_every_example_is_in_a_document() -> None:
    """A block with the name of a file in docs/examples is that file, and no file there is shown nowhere."""
    shown = {block.name: block.text for path in DOCS for block in blocks(path) if block.name}
    examples = {
        path.name: path.read_text(encoding="utf-8") for path in (ROOT / "docs/examples").iterdir() if path.is_file()
    }
    assert {name: shown.get(name) for name in examples} == examples


def test_topology_md_is_fresh() -> None:
    """docs/topology.md is the output of docs/generate.py."""
    page = runpy.run_path(str(ROOT / "docs/generate.py"))
    fresh = page["generate"]([str(preloaded.SESSION.programs / "orchestrator")])
    assert page["RESULT"].read_text(encoding="utf-8") == fresh


def test_the_picture_of_faults_is_fresh(tmp_path: Path) -> None:
    """docs/plot_faults.py draws, and the picture in docs/faults.md has the same numbers."""
    image = tmp_path / "faults.png"
    ran = subprocess.run(
        [str(preloaded.SESSION.programs / "program"), str(ROOT / "docs/plot_faults.py"), str(image)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout
    with Image.open(ROOT / "docs/images/faults.png") as old, Image.open(image) as new:
        assert old.info["Description"] == new.info["Description"] == ran.stdout.strip()
        assert old.size == new.size
        assert len(new.convert("RGB").getcolors(new.width * new.height) or ()) > 100  # something was drawn


def test_links_lead_somewhere() -> None:
    """Every relative link names a file that exists, and a heading in it."""
    wrong = []
    for document in DOCS:
        text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if re.match(r"[a-z]+:", target):
                continue
            file, _, heading = target.partition("#")
            path = (document.parent / file).resolve() if file else document
            if not path.exists() or (heading and heading not in headings(path)):
                wrong.append(f"{document.name}: {target}")
    assert wrong == []


def headings(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


# Tables that are compared with the code.


def table(document: str, heading: str, number: int = 0) -> list[dict[str, str]]:
    """Return the rows of a table of a section, by column name, without backquotes."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    section = re.split(r"^#+ ", text.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    found = re.findall(r"(?:^\|.*\|\n)+", section, flags=re.MULTILINE)[number]
    lines = [re.split(r"(?<!\\)\|", line)[1:-1] for line in found.splitlines()]
    titles, _, *rows = [[cell.strip().replace("`", "").replace("\\|", "|") for cell in line] for line in lines]
    return [dict(zip(titles, row, strict=True)) for row in rows]


K, M, N, E, T, S = 3, 5, 4, 2, 7, 2
BACK = np.array([True, False, True])
R, D = 2, 3
"""The returning nodes, and their incidences."""
ARRAYS = {
    name: np.arange(1.0, 1 + size).reshape(shape) / 7 + offset
    for offset, (name, size, shape) in enumerate(
        [("x", N, (N,)), ("u", N, (N,)), ("w", N, (N,)), ("report", N * REPORT_ROWS, (REPORT_ROWS, N))]
    )
}
FLAGS = {
    "flags": np.array([7, 1, 2, 4, 0], np.uint8),
    "edge_open": np.array([1, 0], np.uint8),
    "link_up": np.array([1, 0, 0, 1], np.uint8),
}
X, U, W, REPORT = ARRAYS["x"], ARRAYS["u"], ARRAYS["w"], ARRAYS["report"]
USED = np.array([3, 0, 1, 3, 2], np.uint8)
SPANS = [Span(1, 0, 3, 0, 0), Span(4, 2, 1, 5, 6)]
ROWS = {"first": np.array(T - 2), "x": np.arange(S * N).reshape(S, N) / 3, "u": np.arange(S * N).reshape(S, N) / 5}
PAST = {
    "x": ROWS["x"][:, :R].copy(),
    "u": ROWS["u"][:, :R].copy(),
    "edge_open": np.array([[1, 0, 1], [0, 1, 1]], np.uint8),
}
TRIPS = np.arange(1.0, 1 + S * N).reshape(S, N) / 9
EVENT = {"event": "lost", "shard": 1}
TEXT = np.frombuffer(json.dumps(EVENT).encode(), np.uint8)
MESSAGES: dict[str, tuple[bytes, dict[str, Any]]] = {
    "state": (codec.encode_state(T, X[:K], FLAGS["flags"], SPANS), {"x": X[:K], **FLAGS, "spans": np.array(SPANS)}),
    "record": (
        codec.encode_record(Record(T, BACK, T - 2, *PAST.values())),
        {"first": ROWS["first"], "back": BACK, **PAST},
    ),
    "input": (
        codec.encode_input(T, U[:K], REPORT[:, :K].copy(), USED),
        {"u": U[:K], "report": REPORT[:, :K], "used": USED},
    ),
    "link": (codec.encode_link(Link(T, T - 2, ROWS["x"].tobytes(), ROWS["u"].tobytes()), N), ROWS),
    "telemetry": (
        codec.join(
            codec.encode_telemetry(Telemetry(T, X, U, W, REPORT, FLAGS["edge_open"], FLAGS["link_up"], USED[: 2 * E]))
        ),
        {**ARRAYS, **FLAGS, "used": USED[: 2 * E]},
    ),
    "round_trips": (codec.encode_round_trips(RoundTripTimes(T, TRIPS)), {"seconds": TRIPS}),
    "event": (codec.encode_event(T, EVENT), {"event": TEXT}),
    "end": (
        codec.encode_end(End(T, X, 1.25, 3)),
        {**ARRAYS, "elapsed_s": np.array(1.25), "forgotten": np.array(3)},
    ),
    "place": (codec.encode_place(T, 4096, 512), {"start": np.array(4096), "length": np.array(512)}),
    "seen": (codec.encode_seen(T), {}),
}
TYPES = {"u8": "<u1", "u16": "<u2", "u32": "<u4", "i64": "<i8", "f64": "<f8"}


def packed_by(heading: str, values: dict[str, Any], s: int = S) -> bytes:
    """The bytes that a table of docs/wire.md makes of some values, in the sizes that the messages here have."""

    def number(expression: str) -> int:
        return int(eval(expression, {}, {"k": K, "m": M, "n": N, "e": E, "t": T, "r": R, "d": D, "s": s}))

    packed = b""
    for row in table("wire.md", heading):
        kind, *shape = re.findall(r"[^\[\]]+", row["type"])
        field, _, constant = (part.strip() for part in row["field"].partition("="))
        value = np.array(number(constant)) if constant else np.asarray(values[field])
        assert value.shape == tuple(map(number, shape)), f"{field} is {value.shape}"
        piece = value.astype(TYPES[kind]).tobytes()
        assert (number(row["offset"]), number(row["bytes"])) == (len(packed), len(piece)), field
        packed += piece
    return packed


@pytest.mark.parametrize("name", MESSAGES)
def test_the_byte_tables_are_the_codec(name: str) -> None:
    """Bytes packed by the table of docs/wire.md are the bytes that wire.codec packs."""
    message, values = MESSAGES[name]
    assert packed_by(name, values, len(TEXT) if name == "event" else S) == message


def test_optional_parts_of_messages_and_of_a_batch() -> None:
    """A state may end before its spans, or before its flags, and others before their bits; a batch has one message, or
    several, in one part or in more."""
    whole, _ = MESSAGES["state"]
    assert codec.encode_state(T, X[:K], FLAGS["flags"]) == whole[: -20 * S]
    assert codec.encode_state(T, X[:K], b"") == whole[: -20 * S - M]
    assert codec.encode_input(T, U[:K], REPORT[:, :K].copy(), b"") == MESSAGES["input"][0][:-M]
    content = Telemetry(T, X, U, W, REPORT, *(np.ones(size, np.uint8) for size in (E, 2 * E, 2 * E)))
    assert codec.join(codec.encode_telemetry(content, whole=True)) == MESSAGES["telemetry"][0][: -5 * E]
    message = np.frombuffer(whole, np.uint8)
    packed = packed_by("batch", {"number": np.array(T), "message": message}, len(message))
    assert packed == codec.encode_batch(T, [(whole,)])
    assert packed + packed[8:] == codec.encode_batch(T, [(whole,), (whole[:16], whole[16:])])


def test_every_message_has_a_table() -> None:
    """Each encoder of wire.codec, and each kind, is in docs/wire.md."""
    encoders = {name.removeprefix("encode_") for name in vars(codec) if name.startswith("encode_")}
    assert encoders == {*MESSAGES, "batch", "quiet_states"}
    assert {kind.name.lower() for kind in Kind} == MESSAGES.keys()
    bits = {row["name"]: int(row["bit"]) for row in table("wire.md", "state", 1)}
    assert bits == {flag.name: flag.value for flag in Flag}
    assert [row["number of a span"] for row in table("wire.md", "state", 2)] == [*Span._fields]


def test_the_keys_are_those_of_the_code() -> None:
    """Each key of wire.keys has a row in docs/wire.md, and there are no further rows."""
    patterns = {
        "state": keys.state(0).replace("0", "{p}"),
        "input_": keys.input_(0).replace("0", "{p}"),
        "link": keys.link(0, 1).replace("0", "{p}").replace("1", "{q}"),
        "alive": keys.alive("{name}", "{life}"),
        "ROOM": keys.alive(keys.ROOM, "{number}"),
        "control": keys.control("{command}"),
        "join": keys.join("{p}"),
        "TELEMETRY": keys.TELEMETRY,
        "SEEN": keys.SEEN,
    }
    known = {name for name, value in vars(keys).items() if isinstance(value, FunctionType) or name.isupper()}
    assert known - {"ALIVE", "COMMANDS", "PLANT", "chunk", "quote", "shard_name"} == patterns.keys()
    assert {row["key"] for row in table("wire.md", "Keys")} == set(patterns.values())


def test_the_commands_and_events_are_those_of_the_code() -> None:
    """Each command that the plant answers, each event that it reports, and no other, has a row in docs/wire.md."""
    files = ("control", "process", "shards")
    control, process, shards = ((ROOT / f"plant/{name}.py").read_text(encoding="utf-8") for name in files)
    commands = set(re.findall(r'"(\w+)": self\._\w+,', control))
    # A process that joins has a separate key.
    assert commands == {row["command"] for row in table("wire.md", "Commands")} == {*keys.COMMANDS, "join"}
    events = set(re.findall(r'\.(?:_report|report_event)\(\s*"(\w+)"', control + process + shards))
    assert events == {row["event"] for row in table("wire.md", "event", 1)}


def test_the_deadlines_are_those_of_the_code() -> None:
    """Each constant in docs/wire.md has the value on the page."""
    for row in table("wire.md", "Deadlines"):
        names = row["constant"].split(".")
        depth = next(k for k, name in enumerate(names) if not name.islower())
        value: Any = importlib.import_module(".".join(["hedgerow", *names[:depth]]))
        for name in names[depth:]:
            value = getattr(value, name)
            value = value() if isinstance(value, type) else value
        assert value == float(row["seconds"]), row["constant"]


def test_the_session_settings_are_those_of_the_code() -> None:
    """Each setting in docs/wire.md is a setting of the sessions."""
    config = session._config(None, {})
    for row in table("wire.md", "Router and sessions"):
        assert config.get_json(row["setting"]) == row["value"], row["setting"]


def test_every_error_code_is_in_errors_md() -> None:
    """Each code has a row, and there are no further rows."""
    assert [row["code"] for row in table("errors.md", "Codes")] == [*Code]


def test_every_kind_of_fault_is_in_faults_md() -> None:
    """Each kind has a row, the fault in it is one of that kind, and an account has the fields that are explained."""
    rows = table("faults.md", "Fault kinds")
    assert [row["kind"] for row in rows] == [*KINDS]
    for row in rows:
        fault = yaml.safe_load(row["in a file"])
        written = KINDS[row["kind"]].model_validate(fault).written()
        assert json.loads(json.dumps(written)) == fault
    counted = [name for name in Account._fields if name != "visible"]
    fields = {row["field"] for row in table("faults.md", "Faults that prove they fired")}
    assert fields == {*counted, "beyond"}


def test_every_metric_is_in_the_place_that_theory_md_gives() -> None:
    """Fields, columns and entities exist; the page has every metric of a verdict and every entity of Rerun."""
    topology = resolve(load("paper7"))
    observer, batch = observe(topology, simulate(topology))
    rows = table("theory.md", "Metrics")

    def named(column: str) -> set[str]:
        return {name for row in rows for name in re.findall(r"\w+", row[column].replace("—", ""))}

    assert all(hasattr(batch, name) for name in named("Batch"))
    assert named("verdict.json") == observer.summary().keys()
    shown = {quantity.entity for quantity in [*lines(topology), *totals(topology, observer)]}
    assert named("Rerun") == shown
    fields = {*Batch.__dataclass_fields__, "cost_regret", "ratio", "gain"}
    assert named("Batch") == fields - {"t", "a", "edge_open", "link_up"}


def orchestrator(scratch: Scratch, *arguments: str) -> subprocess.Popen[str]:
    """A command that runs on, with its output to be read line by line."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "hedgerow.orchestrator", *arguments],
        cwd=scratch.folder,
        env=scratch.environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_the_run_folder_is_as_described(tmp_path: Path) -> None:
    """Every file, every column and its type, and every field of the verdict is on the page, and nothing is missing."""
    scratch = Scratch(tmp_path)
    code, printed = scratch.run("orchestrator", "up", "paper7", "--viewer", "none", "--run-dir", "run")
    assert code == 0, printed
    run = tmp_path / "run"

    left = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    patterns = {row["file"] for row in table("run-folder.md", "Files")}
    expressions = {pattern: re.escape(pattern).replace("NAME", r"[\w.-]+") for pattern in patterns}
    described = {pattern for pattern in patterns if any(re.fullmatch(expressions[pattern], file) for file in left)}
    assert [file for file in left if not any(re.fullmatch(e, file) for e in expressions.values())] == []
    streams = {"telemetry.arrows", "edges.arrows", "summary.arrows", "round_trips.arrows"}
    sometimes = {*streams, "logs/up.log", "run-NNN.rrd", "network.npz"}
    assert patterns - described == sometimes

    for name in ("telemetry", "edges", "summary", "round_trips"):
        schema = pq.read_schema(run / f"{name}.parquet")
        columns = [(row["column"], row["type"]) for row in table("run-folder.md", f"{name}.parquet")]
        assert columns == [(field.name, str(field.type)) for field in schema]

    verdict = json.loads((run / "verdict.json").read_text())
    assert [row["field"] for row in table("run-folder.md", "verdict.json")] == list(verdict)
    assert [row["check"] for row in table("run-folder.md", "verdict.json", 1)] == list(verdict["checks"])
    assert {row["field"] for row in table("run-folder.md", "verdict.json", 2)} == verdict["metrics"].keys()
    (figures,) = {tuple(one) for one in verdict["round_trips"].values()}
    assert all(f"`{name}`" in (ROOT / "docs/run-folder.md").read_text(encoding="utf-8") for name in figures)

    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "orchestrator").rglob("*.py")]
    events = {event for source in sources for event in re.findall(r'folder\.event\(\s*"(\w+)"', source)}
    assert events == {row["event"] for row in table("run-folder.md", "events.jsonl")}


def test_the_sign_of_an_edge_input() -> None:
    """u_edge of the edge (i, j) is u_j - u_i, as in docs/run-folder.md."""
    topology = read("{name: pair, b: 0.1, steps: 3, defaults: {x0: 5}, nodes: {1: {}, 2: {x0: 1}}, edges: [[2, 1]]}")
    _, batch = observe(topology, simulate(topology))
    np.testing.assert_array_equal(batch.u_edge[:, 0], batch.u[:, 0] - batch.u[:, 1])


LONG = ("paper7", "--steps", "1000000", "--viewer", "none", "--no-record", "--run-dir", "run")


def started(scratch: Scratch) -> subprocess.Popen[str]:
    """A long run of which some steps are recorded."""
    process = orchestrator(scratch, "up", *LONG)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("step "):
            return process
    raise AssertionError("the run ended before its first step")


def test_ctrl_c_leaves_a_complete_folder(tmp_path: Path) -> None:
    """Exit code 3, the verdict unknown, and tables that can be read."""
    process = started(Scratch(tmp_path))
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=COMMAND_DEADLINE_S)

    assert process.returncode == 3, printed
    verdict = json.loads((tmp_path / "run/verdict.json").read_text())
    assert verdict["verdict"] == "unknown"
    telemetry = pq.read_table(tmp_path / "run/telemetry.parquet")
    assert telemetry.num_rows == 7 * (verdict["steps_done"] + 1)


def test_sigkill_leaves_a_stream_that_becomes_a_table(tmp_path: Path) -> None:
    """No verdict, but every batch that was written is there, and `to_parquet` reads up to the last whole one."""
    process = started(Scratch(tmp_path))
    process.kill()
    process.communicate(timeout=COMMAND_DEADLINE_S)

    run = tmp_path / "run"
    assert not (run / "verdict.json").exists()
    to_parquet(run / "telemetry.arrows", run / "telemetry.parquet")
    telemetry = pq.read_table(run / "telemetry.parquet")
    assert telemetry.num_rows > 0
    assert telemetry.num_rows % 7 == 0
    with pyarrow.OSFile(str(run / "telemetry.arrows")) as source, pyarrow.ipc.open_stream(source) as stream:
        assert stream.schema == telemetry.schema
