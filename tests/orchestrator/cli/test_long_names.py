"""A name as long as a file's may be, and files of the user that have the names of temporary ones."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.runs import registry
from hedgerow.topologies.errors import Exit
from hedgerow.topologies.paths import beside
from tests.orchestrator.cli.test_shells import code, run
from tests.tools.processes import orchestrator, run_here

PAIR = {"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}
MOST_BYTES = 255
LONGEST = ("r" * MOST_BYTES, "\U0001f600" * (MOST_BYTES // 4), "-" * MOST_BYTES)


@pytest.fixture
def pair(here: Path) -> Path:
    (here / "pair.yaml").write_text(json.dumps(PAIR))
    return here


@given(st.text(min_size=1).filter(lambda name: "/" not in name and "\0" not in name and name not in (".", "..")))
def test_a_temporary_name_is_short_and_in_the_same_folder(name: str) -> None:
    path = beside(Path("folder") / name.encode("utf-8", "replace").decode())
    assert path.parent == Path("folder")
    assert len(path.name.encode()) < 64


def test_a_temporary_name_is_new() -> None:
    """A killed process may have left its files; in a container, the next process has the same id."""
    assert beside(Path("a")) != beside(Path("a"))


@pytest.mark.slow
def test_a_run_folder_may_have_the_longest_name(pair: Path) -> None:
    """Those of a secure run: its keys lie beside its entry in the list of running networks."""
    done = orchestrator("up", "pair.yaml", "--viewer", "none", "--secure", f"--run-dir={LONGEST[1]}")
    assert done.returncode == Exit.VALID, done.stderr
    assert (pair / LONGEST[1] / "verdict.json").exists()


@pytest.mark.parametrize("name", LONGEST)
def test_a_list_of_running_networks_takes_any_name(here: Path, name: str) -> None:
    with registry.announced(name, here, "tcp/localhost:1", "n"):
        assert [entry.run for entry in registry.running()] == [name]
    assert registry.running() == []


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize(
    "words",
    [("keys", "pair.yaml"), ("bundle", "pair.yaml", "--router", "tcp/127.0.0.1:7447")],
    ids=lambda words: words[0],
)
def test_a_folder_of_the_longest_name_is_filled(pair: Path, words: tuple[str, ...], is_there: bool) -> None:
    folder = pair / LONGEST[0]
    if is_there:
        folder.mkdir()
    assert run_here(*words, "--out", folder.name).returncode == Exit.VALID
    assert {path.name for path in pair.iterdir()} == {"pair.yaml", folder.name}
    assert any(folder.iterdir())


@pytest.mark.parametrize("kind", ["npz", "mat"])
def test_a_file_of_the_longest_name_is_exported(pair: Path, kind: str) -> None:
    assert run_here("simulate", "pair.yaml", "--no-record", "-q", "--run-dir", "done").returncode == Exit.VALID
    file = f"{'r' * (MOST_BYTES - 4)}.{kind}"
    assert run_here("export", "done", "--to", kind, "--out", file).returncode == Exit.VALID
    assert (pair / file).stat().st_size


def test_a_run_that_the_system_refuses_leaves_no_folder(pair: Path) -> None:
    text = "import hedgerow.orchestrator.launch.up as up\ndef refuse(*_): raise PermissionError(13, 'planted', 'x')\n"
    done = run("up", "pair.yaml", "--viewer", "none", command=code(f"{text}up.Launch = refuse"))
    assert done.returncode == Exit.USER_MISTAKE, done.stderr
    assert not any((pair / "runs").iterdir())


@pytest.mark.parametrize("command", ["up", "worst"])
def test_a_full_disk_leaves_no_temporary_file(pair: Path, command: str) -> None:
    """No file grows past one byte: neither the list of running networks, nor the state of a search."""
    words = {"up": ("--viewer", "none", "--run-dir", "run"), "worst": ("--budget", "0.1s")}[command]
    text = (
        "import resource, hedgerow.orchestrator.runs.registry as r, hedgerow.orchestrator.experiments.worst.hunt as h\n"
        "def full(whole):\n"
        " def limited(*a, **k):\n"
        "  resource.setrlimit(resource.RLIMIT_FSIZE, (1, 1))\n"
        "  return whole(*a, **k)\n"
        " return limited\n"
        "r.asdict, h.archive.write = full(r.asdict), full(h.archive.write)\n"
    )
    done = run(command, "pair.yaml", *words, command=code(text))
    assert done.returncode == Exit.USER_MISTAKE, done.stdout + done.stderr
    assert {path.name for path in pair.iterdir()} - {f"hedgerow-{os.getuid()}"} == {"pair.yaml"}
    assert not list(pair.glob("hedgerow-*/*"))


def test_a_soak_replaces_no_file_of_the_users(pair: Path) -> None:
    """As `.travis.yaml` beside a run folder `travis`."""
    mine = [pair / ".travis.yaml", pair / ".travis.log"]
    for file in mine:
        file.write_text("precious")
    text = (
        "import hedgerow.orchestrator.experiments.soak as s\ndef _entry(*_, **__): raise s.DeadlineError('planted')\n"
    )
    done = run(
        "soak", "pair.yaml", "--minutes", "0.25", "--run-dir", "travis", command=code(f"{text}s._entry = _entry")
    )
    assert done.returncode == Exit.UNKNOWN
    assert [file.read_text() for file in mine] == ["precious"] * 2
    assert {path.name for path in pair.glob(".*")} == {file.name for file in mine}
