"""Temporary files of killed processes: the next command that writes there removes them, and no other file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hedgerow.topologies import leftovers
from hedgerow.topologies.paths import beside

MAKER = """
import sys, time
from pathlib import Path
from hedgerow.topologies.paths import beside
here = Path(sys.argv[1])
beside(here / "table.csv").write_text("half")
part = beside(here / "run", "-soak.yaml")
part.mkdir()
(part / "x").write_text("half")
print("made", flush=True)
time.sleep(60)
"""
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="no other system tells the start of a process")


@pytest.fixture(autouse=True)
def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test is a new command."""
    monkeypatch.setattr(leftovers, "_SEEN", set())


def maker(folder: Path) -> subprocess.Popen[str]:
    """Start a process that has made a temporary file and a temporary folder."""
    process = subprocess.Popen([sys.executable, "-c", MAKER, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "made\n"
    return process


def test_files_of_a_killed_process_go_and_those_of_a_living_one_stay(tmp_path: Path) -> None:
    with maker(tmp_path) as killed:
        theirs = set(tmp_path.iterdir())
        killed.send_signal(signal.SIGKILL)
    with maker(tmp_path) as living:  # it removes those of the killed one
        there = set(tmp_path.iterdir())
        assert len(there) == len(theirs) == 2
        assert not there & theirs
        beside(tmp_path / "other")
        assert set(tmp_path.iterdir()) == there
        living.kill()


def test_a_name_whose_process_id_belongs_to_another_process_is_left(tmp_path: Path) -> None:
    own = leftovers.new_name().split("-")
    own[3] = f"{int(own[3], 16) - 1:x}"  # an older process had the id of this one
    (tmp_path / ("-".join(own) + ".part")).touch()
    beside(tmp_path / "x")
    assert list(tmp_path.iterdir()) == []


def test_no_other_file_is_removed(tmp_path: Path) -> None:
    dead, first = 2**22 + 1, leftovers.new_name().split("-")[1]
    kept = [
        ".hedgerow-notes.txt",
        ".hedgerow-0123456789abcdef.part",
        f".hedgerow-{first}-{dead:x}-1.part",
        f".hedgerow-{first}-{dead:x}-1-0123456.part",
        f"x.hedgerow-{first}-{dead:x}-1-01234567.part",
        f".hedgerow-00000000-{dead:x}-1-01234567.part",  # of another machine
        f".hedgerow-{first}-{dead:x}-1-01234567",
        leftovers.new_name() + ".part",
    ]
    for name in kept:
        (tmp_path / name).touch()
    (tmp_path / f".hedgerow-{first}-{dead:x}-1-01234567.part").touch()
    beside(tmp_path / "x")
    assert {path.name for path in tmp_path.iterdir()} == set(kept)


def test_a_symbolic_link_is_not_followed(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "data").touch()
    here = tmp_path / "here"
    here.mkdir()
    machine = leftovers.new_name().split("-")[1]
    (here / f".hedgerow-{machine}-{2**22 + 1:x}-1-01234567.part").symlink_to(precious)
    beside(here / "x")
    assert list(here.iterdir()) == []
    assert (precious / "data").exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_file_of_another_user_stays(tmp_path: Path) -> None:
    machine = leftovers.new_name().split("-")[1]
    theirs = tmp_path / f".hedgerow-{machine}-{2**22 + 1:x}-1-01234567.part"
    theirs.touch()
    os.chown(theirs, 12345, 12345)
    beside(tmp_path / "x")
    assert theirs.exists()


def test_a_folder_that_does_not_exist_has_no_leftovers(tmp_path: Path) -> None:
    assert beside(tmp_path / "missing" / "x").parent == tmp_path / "missing"
