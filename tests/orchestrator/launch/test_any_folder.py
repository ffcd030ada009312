"""A run works in any folder, and touches no file that it did not make."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hedgerow.orchestrator.runs.folder import create, withdraw
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.processes import orchestrator

UP = ("--viewer", "none", "--no-record")
PAIR = "{name: pair, b: 0.1, steps: 6, seed: 3, nodes: [p, q], edges: [[p, q]]}"


@pytest.mark.parametrize("beside", ["file", "folder"])
def test_files_beside_a_folder_with_a_hash_remain(here: Path, monkeypatch: pytest.MonkeyPatch, beside: str) -> None:
    """A Zenoh endpoint ends at `#`: a socket in `run#2` would be made, and removed, at `run`."""
    (here / "run#2").mkdir()
    users = here / "run"
    if beside == "file":
        users.write_text("data")
    else:
        users.mkdir()
        (users / "a").write_text("data")
    monkeypatch.chdir(here / "run#2")
    Path("pair.yaml").write_text(PAIR)
    done = orchestrator("up", "pair.yaml", *UP)
    assert done.returncode == 0, done.stderr
    assert (users if beside == "file" else users / "a").read_text() == "data"
    assert sorted(one.name for one in here.iterdir() if not one.name.startswith("hedgerow-")) == ["run", "run#2"]


@pytest.mark.parametrize("name", ["bench#7", "a*b", "$x", "@you", "what?", "näme mit ü", "a\nb"])
def test_any_name_of_a_run_folder_works(here: Path, name: str) -> None:
    Path("pair.yaml").write_text(PAIR)
    done = orchestrator("up", "pair.yaml", *UP, "--run-dir", name)
    assert done.returncode == 0, done.stderr
    assert (here / name / "verdict.json").is_file()


def test_a_working_directory_and_a_temporary_folder_may_be_long(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    long = here / ("w" * 90)
    (long / ("t" * 110)).mkdir(parents=True)
    monkeypatch.setenv("TMPDIR", str(long / ("t" * 110)))
    monkeypatch.chdir(long)
    Path("pair.yaml").write_text(PAIR)
    assert orchestrator("up", "pair.yaml", *UP).returncode == 0


def test_a_tilde_is_the_home_folder(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(here / "home"))
    os.mkdir("home")
    Path("pair.yaml").write_text(PAIR)
    assert orchestrator("simulate", "pair.yaml", "--no-record", "--run-dir=~/a").returncode == 0
    assert (here / "home/a/verdict.json").is_file()
    assert not (here / "~").exists()


def test_a_refused_run_leaves_no_folder_and_latest_where_it_was(here: Path) -> None:
    Path("pair.yaml").write_text(PAIR)
    assert orchestrator("simulate", "pair.yaml", "--no-record").returncode == 0
    before = sorted(one.name for one in Path("runs").iterdir()), os.readlink("runs/latest")
    (here / "no keys").mkdir()
    refused = (
        ("up", "pair.yaml", *UP, "--processes", "9"),
        ("up", "pair.yaml", *UP, "--router", "bench"),
        ("up", "pair.yaml", *UP, "--secure", "--keys", "no keys"),
        ("up", "pair.yaml", *UP, "--law", "nowhere:Law"),
        ("up", "pair.yaml", *UP, "--external", "z"),
    )
    for command in refused:
        done = orchestrator(*command)
        assert done.returncode == 2, (command, done.stdout)
        assert (sorted(one.name for one in Path("runs").iterdir()), os.readlink("runs/latest")) == before, command


def test_files_of_a_refused_run_are_removed_and_those_of_the_user_remain(here: Path) -> None:
    topology = resolve(load("paper7"))
    first = create(topology, None)
    second = create(topology, None)
    assert os.readlink("runs/latest") == second.name
    withdraw(second)
    assert os.readlink("runs/latest") == first.name
    assert not second.path.exists()
    (first.path / "mine.txt").write_text("data")
    withdraw(first)
    assert (first.path / "mine.txt").read_text() == "data"
