"""Damaged files and messages: each is refused with a message or fully accepted; never a traceback or a hang.

CI tries FILES and PAYLOADS of them. `python -m tests.tools.fuzz` tries 10,000 of each; docs/reliability.md has the
results. Special cases follow: a law is code, a disk is full, a clock jumps.
"""

from __future__ import annotations

import ast
import errno
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import rerun.blueprint as rrb

from hedgerow.orchestrator.cli import main as cli
from hedgerow.orchestrator.report.reading import METRICS, metrics
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.views.rerun.opening import _unreadable
from hedgerow.topologies.errors import UserError
from tests.tools.fuzz import ROOT, fuzz
from tests.tools.processes import orchestrator

FILES, PAYLOADS = 200, 2000
SEED = 1


@pytest.mark.parametrize(("kind", "cases"), [("files", FILES), ("payloads", PAYLOADS)])
def test_nothing_that_is_read_shows_a_traceback_or_hangs(kind: str, cases: int) -> None:
    counts, findings = fuzz(kind, SEED, range(cases))
    assert not findings, "\n".join(map(str, findings))
    assert sum(counts.values()) == cases
    assert {name.rpartition(" ")[2] for name in counts} == {"good", "refused"}


def test_an_exception_a_hang_and_a_death_are_findings() -> None:
    """The fuzzer itself, with planted findings."""
    counts, findings = fuzz("planted", SEED, range(6))
    assert [(one.number, one.what.partition(":")[0]) for one in findings] == [
        (1, "KeyError"),
        (2, "SlowError"),
        (3, "the process died with exit code -11"),
    ]
    assert counts == {"good": 3, "finding": 3}


# ---- a law is code

TRAP = "from pathlib import Path\nPath('sprung').write_text('')\nfrom hedgerow.agents.law import Minimax\n"
RUN = ("--viewer", "none", "--no-record")


def test_a_file_that_is_only_looked_at_runs_no_law(here: Path) -> None:
    """This holds for the file and for its run: a foreign folder can be inspected, drawn and exported."""
    (here / "trap.py").write_text(TRAP)
    assert orchestrator("check", "paper7", "--law", "trap:Minimax").returncode == 0
    assert orchestrator("schema").returncode == 0
    assert not Path("sprung").exists()
    assert (
        orchestrator("simulate", "paper7", "--law", "trap:Minimax", "--no-record", "--run-dir", "run").returncode == 0
    )
    assert Path("sprung").exists(), "to run it is to run the law"
    Path("sprung").unlink()
    for command in (("check", "run"), ("export", "run", "--to", "csv"), ("report", "run", "--figures", "2")):
        done = orchestrator(*command)
        assert done.returncode == 0, done.stderr
    assert load_run("run").right[-1] > 0
    assert not Path("sprung").exists()


def test_check_loads_the_law_when_it_is_asked_to(here: Path) -> None:
    (here / "trap.py").write_text(TRAP)
    assert orchestrator("check", "paper7", "--law", "trap:Minimax", "--import-law").returncode == 0
    assert Path("sprung").exists()
    assert orchestrator("check", "paper7", "--law", "nowhere.at_all:Law").returncode == 0
    done = orchestrator("check", "paper7", "--law", "nowhere.at_all:Law", "--import-law")
    assert done.returncode == 2
    assert done.stderr.startswith("error: law nowhere.at_all:Law: ")


# ---- files that are not regular, or not ours to read


def test_a_loop_of_links_and_a_broken_link_are_reported(here: Path) -> None:
    for name, target in (("loop.yaml", "loop.yaml"), ("nowhere.yaml", "gone.yaml"), ("zero.yaml", "/dev/zero")):
        (here / name).symlink_to(target)
        done = orchestrator("check", name)
        assert done.returncode == 2, name
        assert done.stderr.startswith(("error: ", f"{name}: ")), done.stderr


@pytest.mark.parametrize("name", ["topology.yaml", "verdict.json", "events.jsonl", "telemetry.parquet"])
def test_a_damaged_file_of_a_run_folder_is_named(name: str, here: Path) -> None:
    assert orchestrator("simulate", "paper7", "--no-record", "--run-dir", "run").returncode == 0
    (here / "run" / name).write_bytes(b"{]\n\xff\n")
    with pytest.raises(UserError) as refused:
        load_run("run")
    assert name in str(refused.value)
    done = orchestrator("export", "run", "--to", "npz")
    assert done.returncode == 2
    assert name in done.stderr
    assert "Traceback" not in done.stderr


def test_a_verdict_that_lacks_a_number_is_read_without_it(here: Path) -> None:
    """The numbers are also in the tables."""
    assert orchestrator("simulate", "paper7", "--no-record", "--run-dir", "run").returncode == 0
    file = here / "run/verdict.json"
    verdict = json.loads(file.read_text())
    whole = {name: verdict["metrics"][name] for name in METRICS}
    del verdict["metrics"]["gain_less_x0"]
    file.write_text(json.dumps(verdict))
    assert {name: metrics(load_run("run"))[name] for name in METRICS} == pytest.approx(whole)


def test_an_empty_recording_is_reported(tmp_path: Path) -> None:
    file = tmp_path / "run.rrd"
    rrb.Blueprint().save("nothing", str(file))
    assert _unreadable([file]) == "run.rrd cannot be read (it holds no recording)"


def test_an_unreadable_folder_is_reported(here: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may read everything")
    assert orchestrator("simulate", "paper7", "--no-record", "--run-dir", "run").returncode == 0
    (here / "run/telemetry.parquet").chmod(0)
    done = orchestrator("export", "run", "--to", "npz")
    assert done.returncode == 2
    assert os.strerror(errno.EACCES) in done.stderr


# ---- a full disk


@pytest.mark.parametrize("record", [True, False])
def test_a_full_disk_ends_the_run_with_the_recorded_steps(record: bool, here: Path) -> None:
    """Over Zenoh, with the recording and without: the run reports it, ends with `unknown`, and its steps can be
    read.
    """
    command = ["up", "paper7", "--steps", "100000", "--viewer", "none", "--run-dir", "run"]
    done = orchestrator(*command, *([] if record else ["--no-record"]), largest=300_000)
    assert done.returncode == 3, done.stdout + done.stderr
    assert os.strerror(errno.EFBIG) in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    run = load_run("run")
    assert run.T > 100
    assert run.verdict.verdict == "unknown"
    assert not list(here.glob("run/*.part")) + list(here.glob("run/*.sock"))


# ---- a clock that jumps

WALL_CLOCK = {
    "orchestrator/launch/certificates.py": "from when to when a certificate is good",
    "orchestrator/ground/law_source.py": "whether a file changed since it was loaded",
    "orchestrator/runs/registry.py": "since when a network runs, for people",
    "orchestrator/runs/folder.py": "names of folders and times of events, for people",
    "orchestrator/runs/listing.py": "whether a folder without a verdict is recent",
    "orchestrator/launch/recording.py": "the wall clock's timeline in Rerun",
    "orchestrator/views/rerun/stream.py": "the same",
    "orchestrator/views/rerun/watch.py": "the name of a recording",
    "orchestrator/experiments/soak.py": "the name of a folder",
    "orchestrator/cli/soak.py": "the name of a folder",
    "orchestrator/launch/running.py": "an entry of the registry",
    "orchestrator/cli/main.py": "since when a network runs, for people",
}
"""The permitted uses of the wall clock: no code waits by it."""
BY_DATE = {"orchestrator/launch/certificates.py", "orchestrator/runs/listing.py"}
"""modules that compare dates: a certificate is valid until its own date"""
WALL = {("time", "time"), ("time", "time_ns"), ("time", "strftime"), ("datetime", "now"), ("time", "localtime")}


def sources() -> Iterator[Path]:
    for package in ("topologies", "wire", "agents", "plant", "orchestrator"):
        yield from sorted((ROOT / package).rglob("*.py"))


def wall_clock(node: ast.AST) -> bool:
    """Return True if an expression reads the wall clock."""
    return any(
        isinstance(inside, ast.Attribute)
        and isinstance(inside.value, ast.Name)
        and (inside.value.id, inside.attr) in WALL
        for inside in ast.walk(node)
    )


def test_no_code_waits_by_a_clock_that_may_jump() -> None:
    """Deadlines and pauses use time.monotonic(): a wall clock is only shown, and never compared."""
    for path in sources():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        name = str(path.relative_to(ROOT))
        assert name in WALL_CLOCK or not wall_clock(tree), f"{name}: reads the wall clock: what for?"
        for node in ast.walk(tree):
            if isinstance(node, ast.Compare | ast.While) or (
                isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub | ast.Add)
            ):
                looked = wall_clock(node.test if isinstance(node, ast.While) else node)
                assert not looked or name in BY_DATE, f"{name}:{node.lineno}"


def test_the_fuzzer_runs_the_command_line() -> None:
    """Should a command be added that reads files, the fuzzer is to know it."""
    names = {command.name or getattr(command.callback, "__name__", "") for command in cli.app.registered_commands}
    reading = {"check", "simulate", "up", "export", "report", "open", "watch", "soak", "import", "runs"}
    as_check_does = {"audit", "keys", "bundle", "compose", "sweep", "compare", "bound", "worst", "laws"}
    speaking = {"schema", "ps", "status", "stop", "chaos", "heal", "pause", "resume", "step", "rate"}
    assert names - speaking <= reading | as_check_does, names
    assert shutil.which("python")
