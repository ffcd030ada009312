"""Text that a library writes to file descriptor 2 reaches the screen escaped, and bounded."""

import subprocess
import sys

import pytest

BEGIN = "import os, sys\nfrom hedgerow.orchestrator.ground.foreign_stderr import foreign_stderr\n"


def stderr_of(text: str) -> bytes:
    return subprocess.run([sys.executable, "-c", BEGIN + text], capture_output=True, check=True).stderr


@pytest.mark.parametrize(
    "written", [b"thread panicked at \x1b[2J\x1b]0;owned\x07", b"\x9b31m\x85", "\u202egnp.exe".encode()]
)
def test_a_panic_is_escaped(written: bytes) -> None:
    shown = stderr_of(f"with foreign_stderr():\n    os.write(2, {written!r})\n")
    assert shown.endswith(b"\n")
    assert not set(shown[:-1].decode()) & {"\x1b", "\x07", "\x9b", "\x85", "\u202e"}


def test_a_flood_is_cut() -> None:
    shown = stderr_of("with foreign_stderr():\n    os.write(2, b'x' * 10**7)\n")
    assert 1000 < len(shown) < 20_000


def test_standard_error_is_back_afterwards_and_after_an_error() -> None:
    shown = stderr_of(
        "try:\n    with foreign_stderr():\n        os.write(2, b'one\\n')\n        raise OSError\n"
        "except OSError:\n    os.write(2, b'two\\x1b\\n')\n"
    )
    assert shown == b"one\ntwo\x1b\n"


@pytest.mark.parametrize(
    "before", ["os.close(2)", "sys.stderr = None", "import tempfile\ntempfile.tempdir = '/nowhere'"]
)
def test_the_block_runs_where_nothing_can_be_held_back(before: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"{BEGIN}{before}\nwith foreign_stderr():\n    print('ran')\n"],
        capture_output=True,
        check=True,
    )
    assert done.stdout == b"ran\n"
