"""A run works on other shells and machines: signals, encodings, limits, crashes, and failures of optional parts."""

from __future__ import annotations

import ast
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hedgerow.orchestrator.launch.plant_event import checked
from hedgerow.topologies.errors import Code, Exit, TopologyError
from hedgerow.topologies.load import parse
from hedgerow.wire import first, start
from hedgerow.wire.limits import limit_reached
from hedgerow.wire.message import MessageError
from tests.tools.processes import COMMAND, DEADLINE_S

ROOT = Path(__file__).parents[3]
RUN = ("simulate", "paper7", "--steps", "3", "--no-record")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(
    *arguments: str,
    first: Callable[[], object] | None = None,
    command: tuple[str, ...] = COMMAND,
    environment: dict[str, str] | None = None,
) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [*command, *arguments],
        capture_output=True,
        timeout=DEADLINE_S,
        check=False,
        preexec_fn=first,
        env=os.environ | (environment or {}),
    )


@pytest.fixture(autouse=True)
def _own_temporary_folder(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Redirect the traceback files of crashes away from the shared folder for temporary files."""
    monkeypatch.setenv("TMPDIR", str(tmp_path_factory.mktemp("t")))


def code(text: str) -> tuple[str, ...]:
    """Return a command with an interpreter that runs `text` before the command line."""
    return (sys.executable, "-P", "-c", f"{text}\nimport sys\nfrom hedgerow.orchestrator.__main__ import main\nmain()")


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_is_ignored_at_the_start_stays_ignored(number: signal.Signals) -> None:
    text = (
        "import signal, sys\n"
        "from hedgerow.orchestrator.ground.signals import Interrupts\n"
        f"with Interrupts() as interrupts:\n    signal.raise_signal({int(number)})\n    sys.exit(interrupts.count)"
    )
    done = run(command=(sys.executable, "-c", text), first=lambda: signal.signal(number, signal.SIG_IGN))
    assert done.returncode == 0
    assert run(command=(sys.executable, "-c", text)).returncode == 1


def test_a_process_of_a_run_ignores_signals_that_were_ignored_at_the_start() -> None:
    text = (
        # A raised signal is handled before the next line runs.
        "import signal\nfrom hedgerow.wire.child import run_alone\n"
        "run_alone(lambda: [signal.raise_signal(signal.SIGINT), print('alive')])"
    )
    done = run(command=(sys.executable, "-c", text), first=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    assert (done.returncode, done.stdout) == (0, b"alive\n")


def test_a_ctrl_c_while_modules_load_is_one_line(here: Path) -> None:
    (here / "slow.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    text = "import sys\nsys.path.insert(0, '.')\nfrom hedgerow.wire import start\nstart.begin()\nimport slow"
    done = run(command=(sys.executable, "-c", text))
    assert (done.returncode, done.stderr) == (start.INTERRUPTED, first.LINE.format("Ctrl-C").encode())


@pytest.mark.slow
@pytest.mark.parametrize("environment", [{}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}])
def test_a_folder_of_any_bytes_holds_a_run_and_its_report(here: Path, environment: dict[str, str]) -> None:
    folder = os.fsencode(here) + b"/caf\xe9-\xc3\xbc"
    os.mkdir(folder)
    os.chdir(folder)
    assert run("simulate", "paper7", "--steps", "3", environment=environment).returncode == Exit.VALID
    done = run("report", "runs/latest", "--out", "report", "--figures", "gain", environment=environment)
    assert done.returncode == Exit.VALID, done.stderr
    assert (Path(os.fsdecode(folder)) / "runs/latest/run.rrd").stat().st_size


@pytest.mark.slow
def test_a_network_runs_in_a_folder_of_any_bytes(here: Path) -> None:
    folder = os.fsencode(here) + b"/caf\xe9"
    os.mkdir(folder)
    os.chdir(folder)
    done = run("up", "paper7", "--viewer", "none", environment={"PYTHONIOENCODING": "ascii"})
    assert done.returncode == Exit.VALID, done.stdout + done.stderr


def test_a_verdict_that_cannot_be_shown_is_no_success() -> None:
    with open("/dev/full", "wb") as full:
        done = subprocess.run([*COMMAND, *RUN], stdout=full, stderr=subprocess.PIPE, timeout=DEADLINE_S, check=False)
    assert done.returncode == Exit.UNKNOWN
    assert json.loads(Path("runs/latest/verdict.json").read_text())["verdict"] == "valid"


def test_a_reader_that_has_left_has_read_enough() -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([*COMMAND, "check", "paper7"], stdout=write, stderr=subprocess.PIPE, check=False, timeout=60)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


def traceback_of(printed: bytes) -> str:
    """The traceback in the file that the one line on standard error names."""
    assert printed.count(b"\n") == 1, printed
    return Path(printed.decode().strip().rpartition(" ")[2].rstrip(")")).read_text()


def test_a_defect_of_a_command_is_one_line_and_exit_code_70(here: Path) -> None:
    text = (
        "import hedgerow.orchestrator.metrics.summary as c\ndef table(_): raise LookupError('planted')\nc.table = table"
    )
    done = run("check", "paper7", command=code(text), environment={"TMPDIR": str(here)})
    assert done.returncode == Exit.CRASH
    assert "LookupError: planted" in traceback_of(done.stderr)


def test_a_defect_in_a_run_ends_it_with_code_70_and_never_INVALID() -> None:  # noqa: N802
    text = (
        "import hedgerow.orchestrator.metrics.observer as o\n"
        "def take(*_): raise LookupError('planted')\no.Observer.take = take\n"
        "import hedgerow.orchestrator.launch.recording as r\nr.Observer.take = take"
    )
    done = run(*RUN, command=code(text))
    verdict = json.loads(Path("runs/latest/verdict.json").read_text())
    assert (done.returncode, verdict["verdict"], verdict["exit_code"]) == (Exit.CRASH, "unknown", Exit.CRASH)
    assert "LookupError: planted" in Path("runs/latest/logs/orchestrator.log").read_text()


@pytest.mark.parametrize(
    ("raises", "expected"),
    [
        ("LookupError('planted')", Exit.CRASH),
        ("BaseException('a panic')", Exit.CRASH),
        ("MemoryError()", Exit.UNKNOWN),
        ('RuntimeError("can\'t start new thread")', Exit.UNKNOWN),
        ("HedgerowError('planted')", Exit.UNKNOWN),
        ("UserError('planted')", Exit.USER_MISTAKE),
    ],
)
def test_a_process_of_a_run_ends_with_the_code_of_its_failure(here: Path, raises: str, expected: Exit) -> None:
    text = (
        "from hedgerow.topologies.errors import *\nfrom hedgerow.wire.child import run_alone\n"
        f"def body(): raise {raises}\nrun_alone(body)"
    )
    done = run(command=(sys.executable, "-c", text), environment={"TMPDIR": str(here)})
    assert done.returncode == expected
    assert done.stderr.startswith(b"error: ")
    if expected == Exit.CRASH:
        assert raises.partition("(")[0] in traceback_of(done.stderr)


@pytest.mark.parametrize(
    "environment",
    [
        {"COLUMNS": "0"},
        {"COLUMNS": "-5", "LINES": "0"},
        {"MPLBACKEND": "module://nothing.here"},
        {"PYTHONOPTIMIZE": "1"},
    ],
)
def test_no_environment_ends_a_command(environment: dict[str, str]) -> None:
    shown = ("script", "-qec", " ".join([*COMMAND, *RUN]), "/dev/null")
    done = run(command=shown, environment=environment)
    assert done.returncode == 0, done.stdout


def test_no_product_code_validates_by_assert() -> None:
    for package in ("topologies", "wire", "agents", "plant", "orchestrator"):
        for file in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Assert):
                    narrows = ast.unparse(node.test)
                    assert narrows.endswith(" is not None") or narrows.startswith("isinstance("), (file, narrows)


@pytest.mark.parametrize(
    "rule", ["kind: tree, nodes: 8, branches", "kind: grid, nodes: 8, columns", "kind: ring, nodes"]
)
def test_a_number_beyond_64_bits_is_the_users_mistake(rule: str) -> None:
    text = f"{{name: t, b: 0.1, steps: 6, graph: {{{rule}: 99999999999999999999}}}}"
    with pytest.raises(TopologyError) as caught:
        parse(text.encode(), "t.yaml", Path(), ())
    assert caught.value.code == Code.TOPOLOGY


@pytest.mark.parametrize(
    "event",
    [
        {"event": "kill", "shard": 99, "life": 0, "restart": True},
        {"event": "kill", "shard": True, "life": 0, "restart": True},
        {"event": "kill", "shard": 0},
        {"event": "heal", "fault": 7, "at": 3},
        {"event": "fault", "fault": "1", "entry": {}, "at": 3},
        {"event": "counts", "plant": 3, "shards": []},
        {"event": ["kill"]},
        {},
    ],
)
def test_an_event_that_no_plant_sends_is_refused(event: dict[str, object]) -> None:
    with pytest.raises(MessageError):
        checked({**event, "step": 1}, 3, 1)


def test_an_event_is_rebuilt_from_known_fields() -> None:
    strange = {"event": "revive", "shard": 2, "step": 4, "strange": "x"}
    assert checked(strange, 3, 0) == {"event": "revive", "shard": 2, "step": 4}


def test_a_report_of_files_of_two_runs_is_refused() -> None:
    assert run("simulate", "paper7", "--steps", "3", "--no-record").returncode == 0
    file = Path("runs/latest/verdict.json")
    content = json.loads(file.read_text())
    content["faults"] = [{"what": "a fault"}]
    file.write_text(json.dumps(content))
    assert run("report", "runs/latest").returncode == Exit.USER_MISTAKE


def test_a_run_continues_if_latest_is_a_folder(here: Path) -> None:
    (here / "runs/latest/kept").mkdir(parents=True)
    assert run(*RUN).returncode == Exit.VALID
    assert (here / "runs/latest/kept").is_dir()
    assert not [path for path in (here / "runs").iterdir() if path.name.startswith(".")]


def test_a_run_continues_with_the_recording_switched_off() -> None:
    done = run("simulate", "paper7", "--steps", "3", environment={"RERUN": "0"})
    assert done.returncode == Exit.VALID
    assert not Path("runs/latest/run.rrd").exists()
    assert done.stdout.count(b"RERUN") == 1


def test_a_run_continues_if_numba_fails() -> None:
    text = "import sys\nclass N:\n def find_spec(self, name, *_):\n  if name == 'numba': raise SystemError('broken')\n"
    text += "sys.meta_path.insert(0, N())"
    Path("ring.yaml").write_text("{name: r, b: 0.1, steps: 2, graph: {kind: ring, nodes: 5000}}")
    done = run("simulate", "ring.yaml", "--no-record", command=code(text))
    assert done.returncode == Exit.VALID, done.stderr


def test_a_process_raises_its_soft_limit_of_open_files() -> None:
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    text = (
        "import resource\nfrom hedgerow.wire.start import begin\nbegin()\n"
        "print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])"
    )
    done = run(
        command=(sys.executable, "-c", text), first=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
    )
    assert int(done.stdout) > 64


@pytest.mark.parametrize(
    "error",
    [
        OSError(24, "Too many open files"),
        BlockingIOError(11, "Resource temporarily unavailable"),
        RuntimeError("can't start new thread"),
        MemoryError(),
        ImportError("x.so: failed to map segment from shared object"),
    ],
)
def test_a_limit_of_the_machine_is_named(error: Exception) -> None:
    reached = limit_reached(error)
    assert reached is not None
    assert reached.code == Code.LIMIT
    assert limit_reached(ValueError("planted")) is None


def test_too_few_open_files_for_a_network_are_named_at_once() -> None:
    Path("ring.yaml").write_text("{name: r, b: 0.1, steps: 2, graph: {kind: ring, nodes: 60}}")
    done = run(
        *("up", "ring.yaml", "--viewer", "none", "--no-record"),
        first=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64)),
    )
    assert done.returncode == Exit.UNKNOWN
    assert b"open files" in done.stdout
