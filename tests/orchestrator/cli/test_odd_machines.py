"""A run on a machine that lacks something: a loopback interface, memory, metadata of the package, symbolic links."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Exit
from tests.orchestrator.cli.test_shells import code

COMMAND = (sys.executable, "-P", "-m", "hedgerow.orchestrator")
SHORT = ("paper7", "--steps", "5", "--viewer", "none", "--no-record", "--run-dir", "out")
DEADLINE_S = 120.0
USERS_OR_UNKNOWN = (Exit.VALID, Exit.USER_MISTAKE, Exit.UNKNOWN)


def run(here: Path, command: tuple[str, ...], memory: int | None = None) -> subprocess.CompletedProcess[str]:
    def limit() -> None:
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))

    return subprocess.run(
        command,
        cwd=here,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
        preexec_fn=limit,
        env=os.environ | {"TMPDIR": str(here)},
    )


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0 or shutil.which("unshare") is None, reason="needs root and unshare")
def test_a_secure_network_without_a_loopback_interface_is_no_crash(tmp_path: Path) -> None:
    done = run(tmp_path, ("unshare", "-n", *COMMAND, "up", *SHORT, "--secure"))
    assert done.returncode in USERS_OR_UNKNOWN, done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("hedgerow-crash-*"))


@pytest.mark.slow
@pytest.mark.parametrize("megabytes", [600, 2000])
def test_little_address_space_is_no_crash(tmp_path: Path, megabytes: int) -> None:
    done = run(tmp_path, (*COMMAND, "up", *SHORT), memory=megabytes * 10**6)
    assert done.returncode in USERS_OR_UNKNOWN, done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("hedgerow-crash-*"))


@pytest.mark.parametrize("kilobytes", [4, 8])
def test_a_limit_below_the_names_of_the_columns_is_no_crash(tmp_path: Path, kilobytes: int) -> None:
    """As with `ulimit -f`: no table has a byte, and the run is unknown."""
    limited = ("bash", "-c", f'ulimit -f {kilobytes} && exec "$@"', "bash", *COMMAND)
    done = run(tmp_path, (*limited, "simulate", "paper7", "--no-record", "--run-dir", "out"))
    assert (done.returncode, "Traceback" in done.stderr) == (Exit.UNKNOWN, False), done.stderr
    assert not list(tmp_path.glob("hedgerow-crash-*"))


def test_a_clone_without_metadata_runs(tmp_path: Path) -> None:
    hide = (
        "import importlib.metadata as m\n"
        "whole = m.distribution\n"
        "def hidden(name):\n"
        "    if name == 'hedgerow':\n        raise m.PackageNotFoundError(name)\n"
        "    return whole(name)\n"
        "m.distribution = hidden"
    )
    done = run(tmp_path, (*code(hide), "simulate", "paper7", "--run-dir", "out"))
    assert (done.returncode, done.stderr) == (Exit.VALID, ""), done.stderr
    assert run(tmp_path, (*code(hide), "--version")).returncode == 0


def test_without_symbolic_links_a_run_has_no_latest_and_goes_on(tmp_path: Path) -> None:
    refuse = "import os\ndef refuse(*_, **__):\n    raise OSError(95, 'Operation not supported')\nos.symlink = refuse"
    done = run(tmp_path, (*code(refuse), "simulate", "paper7"))
    assert done.returncode == Exit.VALID, done.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    assert json.loads((folder / "verdict.json").read_text())["verdict"] == "valid"
