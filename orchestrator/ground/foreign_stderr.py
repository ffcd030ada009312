"""The output of libraries to file descriptor 2, such as a panic of Rust: escaped, like all foreign text."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator

from hedgerow.topologies.escape import echo

MOST_BYTES = 2**14
"""the maximum output that is shown, from the end"""


@contextlib.contextmanager
def foreign_stderr() -> Iterator[None]:
    """Collect the output to file descriptor 2 while the block runs; then show it escaped.

    A panic can quote a stranger's file. Nothing is collected if no temporary file can be made.
    """
    with contextlib.ExitStack() as stack:
        try:
            held = stack.enter_context(tempfile.TemporaryFile())
            sys.stderr.flush()
            real = os.dup(2)
        except (OSError, ValueError, AttributeError):
            yield
            return
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            with contextlib.suppress(OSError, ValueError):
                sys.stderr.flush()
            os.dup2(real, 2)
            os.close(real)
            size = held.seek(0, os.SEEK_END)
            held.seek(max(0, size - MOST_BYTES))
            if written := held.read().decode(errors="replace").strip():
                with contextlib.suppress(OSError, ValueError):
                    echo(written, error=True)
