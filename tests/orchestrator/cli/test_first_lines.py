"""The first lines of a command: its handler of Ctrl-C stands before any module that takes time to load."""

from __future__ import annotations

import subprocess
import sys

# Its own package, and a module of Python that every one of our modules imports.
EARLY = {"__future__", "hedgerow", "hedgerow.orchestrator", "hedgerow.wire", "hedgerow.wire.first"}


def test_nothing_else_is_loaded_before_the_handler() -> None:
    """Until the handler stands, a Ctrl-C ends with a traceback of Python."""
    program = (
        "import sys, _signal; before = set(sys.modules)\n"
        "_signal.signal = lambda *_: (print(*sorted(set(sys.modules) - before)), sys.exit())\n"
        "import hedgerow.orchestrator.__main__"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) - {"hedgerow.orchestrator.__main__"} <= EARLY
