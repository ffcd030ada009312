"""Text that a library writes to file descriptor 2 of a running process is escaped, and no byte of it is lost."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable

import pytest

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b2J\u202e\x7f"
BEGIN = """
import os, sys
from hedgerow.wire import start
from hedgerow.wire.stderr_relay import StderrRelay
start.begin()
"""


def stderr_of(text: str, first: Callable[[], object] | None = None) -> bytes:
    done = subprocess.run(
        [sys.executable, "-P", "-c", BEGIN + text], stderr=subprocess.PIPE, check=True, preexec_fn=first, timeout=60
    )
    return done.stderr


def test_a_panic_is_escaped_while_the_process_runs() -> None:
    printed = stderr_of(
        f"with StderrRelay():\n os.write(2, {HOSTILE.encode()!r})\n print({HOSTILE!r}, file=sys.stderr)"
    )
    assert not set(printed.decode()) & {"\x1b", "\x07", "\x9b", "\u202e", "\x7f"}
    assert printed.count(b"owned") == 2


def test_a_long_text_arrives_completely_and_standard_error_is_restored() -> None:
    printed = stderr_of("with StderrRelay():\n os.write(2, 'ü'.encode() * 10**5)\nos.write(2, b'after')")
    assert printed.decode() == "ü" * 10**5 + "after"


@pytest.mark.parametrize("first", [lambda: os.close(2), lambda: os.closerange(0, 3)])
def test_a_process_without_standard_error_runs(first: Callable[[], object]) -> None:
    assert stderr_of("with StderrRelay():\n os.write(2, b'nobody reads it')", first) == b""


def test_a_process_that_may_open_no_more_files_runs() -> None:
    limit = "import resource\nresource.setrlimit(resource.RLIMIT_NOFILE, (5, 5))\n"
    assert stderr_of(f"{limit}with StderrRelay():\n os.write(2, b'as it is')") == b"as it is"


def test_a_child_that_holds_the_pipe_does_not_hold_the_process() -> None:
    text = (
        "import subprocess\nwith StderrRelay():\n subprocess.Popen(['sleep', '5'])\n os.write(2, b'done')\nos._exit(0)"
    )
    assert stderr_of(text).startswith(b"done")


def test_the_last_words_before_an_abort_arrive() -> None:
    text = f"with StderrRelay():\n os.write(2, {HOSTILE.encode()!r})\n os.abort()"
    read, write = os.pipe()
    with subprocess.Popen([sys.executable, "-P", "-c", BEGIN + text], stderr=write) as aborted:
        os.close(write)
        with open(read, "rb") as printed:
            assert printed.read().count(b"owned") == 1
        assert aborted.wait(60) == -signal.SIGABRT


def test_nothing_waits_for_a_relay_of_a_killed_process() -> None:
    """The end of standard output and standard error shows that the process has ended."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", f"{BEGIN}with StderrRelay():\n print(1, flush=True)\n sys.stdin.read()"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as killed:  # fmt: skip
        assert killed.stdout is not None
        killed.stdout.readline()
        killed.kill()
        assert killed.communicate(timeout=60) == (b"", b"")
