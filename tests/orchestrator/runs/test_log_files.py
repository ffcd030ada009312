"""No log of a finished run acts on a terminal, whatever wrote to it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.runs import log_files
from hedgerow.orchestrator.runs.log_files import escape_logs
from hedgerow.topologies.errors import Exit, HedgerowError
from hedgerow.topologies.escape import escape
from hedgerow.topologies.regular_file import last_text
from tests.tools.processes import orchestrator

HOSTILE = b"\x1b]0;owned\x07\x1b[2J\x9b2J\xc2\x9b2J\xe2\x80\xae\r\n"
NOISY = f"""
import os
from hedgerow.agents.law import Minimax

class Noisy(Minimax):
    "Writes as a library in C would: past Python's streams."
    def act(self, x):
        os.write(2, {HOSTILE!r})
        return super().act(x)
"""


def is_harmless(data: bytes) -> bool:
    text = data.decode("utf-8")
    return escape(text) == text


@given(data=st.binary(max_size=300), size=st.integers(1, 9))
def test_any_bytes_of_any_length_become_harmless_text(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, size: int
) -> None:
    folder = tmp_path_factory.mktemp("logs")
    (folder / "agent-1.log").write_bytes(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log_files, "PART_BYTES", size)
        escape_logs(folder)
    written = (folder / "agent-1.log").read_bytes()
    assert is_harmless(written)
    assert written.decode() == escape(data.decode(errors="backslashreplace"))
    assert [path.name for path in folder.iterdir()] == ["agent-1.log"]
    assert escape(last_text(folder / "agent-1.log")) == last_text(folder / "agent-1.log")


def test_a_log_that_is_no_regular_file_stays(tmp_path: Path) -> None:
    (tmp_path / "outside").write_bytes(HOSTILE)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.log").symlink_to(tmp_path / "outside")
    escape_logs(tmp_path / "logs")
    assert (tmp_path / "outside").read_bytes() == HOSTILE


def test_the_logs_of_a_law_that_writes_to_standard_error(here: Path) -> None:
    (here / "noisy.py").write_text(NOISY)
    done = orchestrator(
        *("up", "paper7", "--law", "noisy:Noisy", "--steps", "3", "--viewer", "none", "--no-record"),
        *("--run-dir", "run"),
    )
    assert done.returncode == Exit.VALID, done.stderr
    assert is_harmless((done.stdout + done.stderr).encode())
    logs = list((here / "run/logs").glob("*.log"))
    assert len(logs) > 7
    assert all(is_harmless(log.read_bytes()) for log in logs)
    assert b"owned" in (here / "run/logs/agent-1.log").read_bytes()


def test_the_text_of_an_error_in_python_is_harmless() -> None:
    assert is_harmless(str(HedgerowError("a\x1b[2J\x9b\udc9b")).encode())
