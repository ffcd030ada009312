"""Closed, full and missing places of output: standard streams, disks and folders."""

from __future__ import annotations

import errno
import os
import shlex
import subprocess
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Exit
from tests.tools import preloaded
from tests.tools.processes import COMMAND, DEADLINE_S, orchestrator
from tests.tools.verdicts import verdict_of


def shell(line: str) -> subprocess.CompletedProcess[str]:
    """Run a line of a shell, which knows how to close the streams of a command and where to lead them."""
    path = f"{preloaded.SESSION.programs}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        line,
        shell=True,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
        env=os.environ | {"PATH": path},
    )


@pytest.mark.parametrize("given", ["/run/user/of-nobody", "here", "/etc/passwd", ""])
def test_without_a_runtime_folder_networks_are_listed_under_the_temporary_one(
    here: Path, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    (here / "here").mkdir()
    (here / "temporary").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", given)
    monkeypatch.setenv("TMPDIR", str(here / "temporary"))
    assert orchestrator("ps").stdout == "no network is running\n"
    assert [path.name for path in (here / "temporary").iterdir()] == [f"hedgerow-{os.getuid()}"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may write there, it seems")
def test_a_missing_registry_folder_is_reported(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/proc")
    done = orchestrator("ps")
    assert done.returncode == 2
    assert done.stderr.startswith("error: /proc: no place to list running networks: ")


@pytest.mark.parametrize(
    "closed", ["<&-", ">&-", "<&- >&- 2>&-"], ids=["standard input", "standard output", "all three"]
)
def test_a_network_runs_with_any_standard_stream_closed(here: Path, closed: str) -> None:
    done = shell(f"{shlex.join(COMMAND)} up paper7 --viewer none --no-record {closed}")
    assert (done.returncode, done.stderr) == (0, "")
    assert verdict_of(here / "runs/latest")["verdict"] == "valid"


@pytest.mark.parametrize("words", ["ps", "ps --json", "audit paper7", "compose paper7", "simulate paper7 --json"])
def test_an_unwritable_output_is_reported_in_one_line(here: Path, words: str) -> None:
    code = Exit.UNKNOWN if words.startswith("simulate") else Exit.USER_MISTAKE
    done = shell(f"orchestrator {words} >/dev/full")
    assert done.returncode == code
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert shell(f"orchestrator {words} >/dev/full 2>&1").returncode == code


@pytest.mark.parametrize("command", ["simulate", "up"])
def test_a_run_continues_with_or_without_its_output(here: Path, command: str) -> None:
    done = shell(f"orchestrator {command} paper7 --viewer none --no-record >/dev/full")
    assert done.returncode == Exit.UNKNOWN, done.stderr
    assert done.stderr.count("\n") <= 1
    assert verdict_of(here / "runs/latest")["verdict"] == "valid"


def test_a_run_dir_that_is_in_use_is_refused(here: Path) -> None:
    (here / "full").mkdir()
    (here / "full" / "thesis.tex").write_text("precious")
    done = orchestrator("simulate", "paper7", "--no-record", "--run-dir", "full")
    assert done.returncode == 2
    assert done.stderr.startswith("error: --run-dir full: ")
    assert [path.name for path in (here / "full").iterdir()] == ["thesis.tex"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a small disk")
def test_a_full_disk_ends_the_run_with_a_message(here: Path) -> None:
    disk = here / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("no file system can be mounted here")
    try:
        done = orchestrator("simulate", "paper7", "--no-record", "--steps", "100000", "--run-dir", str(disk / "run"))
        assert done.returncode == 3
        assert os.strerror(errno.ENOSPC) in done.stdout + done.stderr
        assert "Traceback" not in done.stderr
    finally:
        subprocess.run(["umount", str(disk)], check=True)
