"""Product code opens the files of others only through the bounded readers: regular files, and of a known size."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.tools.fuzz import ROOT

READERS = {
    "topologies/regular_file.py": "the reader itself",
    "topologies/archive.py": "numpy reads what `open_regular` opened, after its sizes were summed",
    "orchestrator/runs/table.py": "Parquet, after `check_file` and the budget",
    "orchestrator/runs/arrow_stream.py": "Arrow, after `check_file`, each batch by the budget",
    "orchestrator/runs/writer.py": "the stream that this process wrote",
    "orchestrator/views/rerun/watch.py": "a stream that grows, after `check_file`",
    "orchestrator/views/rerun/opening.py": "Rerun's reader, after `check_file`",
    "orchestrator/experiments/sweep/folder.py": "its own lines, to append, after `check_regular`",
    "topologies/frames.py": "Parquet in memory",
    "orchestrator/network.py": "YAML in memory, no file",
    "orchestrator/experiments/worst/hunt.py": "numpy reads what `open_regular` opened; and YAML in memory",
    "wire/limits.py": "numbers of the kernel in /proc and /sys",
    "topologies/leftovers.py": "numbers of the kernel in /proc",
    "wire/start.py": "/dev/null, in place of a closed standard stream",
    "orchestrator/report/page.py": "a style sheet of the package",
    "orchestrator/facade.py": "Parquet in memory",
    "topologies/importing/matrices.py": "numbers in memory",
    "topologies/importing/power.py": "arrays in memory, from a child process",
}
NAMES = {
    "read_text",
    "read_bytes",
    "memory_map",
    "OSFile",
    "ParquetFile",
    "ZipFile",
    "RrdReader",
    "loadtxt",
    "genfromtxt",
}
OF_MODULES = {
    ("json", "load"),
    ("np", "load"),
    ("pq", "read_table"),
    ("pq", "read_metadata"),
    ("tomllib", "load"),
    ("yaml", "safe_load"),
    ("yaml", "load"),
    ("pd", "read_csv"),
}
NO_FILES = {
    ("zenoh", "open"),
    ("os", "open"),
    ("webbrowser", "open"),
    ("registry", "open"),
    ("re", "open"),
    ("intake", "open"),
}


def mode_of(call: ast.Call, place: int) -> str:
    given = [*call.args[place : place + 1], *(word.value for word in call.keywords if word.arg == "mode")]
    modes = [one.value for part in given for one in ast.walk(part) if isinstance(one, ast.Constant)]
    return "".join(mode for mode in modes if isinstance(mode, str)) or "r"


def reads(call: ast.Call) -> bool:
    """Return True if a call opens a file by its path to read it."""
    match call.func:
        case ast.Name(id="open"):
            return "r" in mode_of(call, 1) or "+" in mode_of(call, 1)
        case ast.Name(id=name):
            return name in NAMES
        case ast.Attribute(value=value, attr=name):
            owner = value.id if isinstance(value, ast.Name) else ""
            if name == "open":
                return (owner, name) not in NO_FILES and ("r" in mode_of(call, 0) or "+" in mode_of(call, 0))
            if name == "OSFile":
                return "r" in mode_of(call, 1)
            return name in NAMES or (owner, name) in OF_MODULES
    return False


def direct_reads(text: str) -> Iterator[int]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and reads(node):
            yield node.lineno


def sources() -> Iterator[Path]:
    for package in ("topologies", "wire", "agents", "plant", "orchestrator"):
        yield from sorted((ROOT / package).rglob("*.py"))


def test_no_module_opens_the_file_of_another_by_itself() -> None:
    found = {
        f"{path.relative_to(ROOT)}:{line}"
        for path in sources()
        for line in direct_reads(path.read_text(encoding="utf-8"))
        if str(path.relative_to(ROOT)) not in READERS
    }
    assert not found, "read it with topologies/regular_file.py or topologies/json_file.py"


def test_every_exception_is_one() -> None:
    for name in READERS:
        assert any(direct_reads((ROOT / name).read_text(encoding="utf-8"))), f"{name}: opens nothing any more"


@pytest.mark.parametrize(
    "text",
    [
        "open(path)",
        "open(path, 'rb')",
        "path.open()",
        "path.open('r', encoding='utf-8')",
        "path.open('a+b')",
        "Path(name).read_text()",
        "(folder / name).read_bytes()",
        "json.load(file)",
        "np.load(path)",
        "pq.read_table(path)",
        "pa.OSFile(name, 'rb')",
    ],
)
def test_a_direct_read_is_found(text: str) -> None:
    assert list(direct_reads(text)) == [1]


@pytest.mark.parametrize("text", ["open(path, 'wb')", "path.open('w')", "json.loads(text)", "os.open(path, 0)"])
def test_other_code_is_not_found(text: str) -> None:
    assert not list(direct_reads(text))
