"""The time to the first step: what `up` imports delays it, so slow libraries wait until the loop runs."""

from __future__ import annotations

import subprocess
import sys

SLOW = ("clarabel", "matplotlib", "numba", "pandas", "psutil", "pyarrow", "rerun", "scipy", "ssl", "unittest")
PROGRAM = """
import sys
import hedgerow.orchestrator.cli.main
import hedgerow.orchestrator.launch.options
import hedgerow.orchestrator.launch.up
print(*sorted(sys.modules))
"""


def test_up_imports_no_slow_library_before_the_first_step() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert not set(SLOW) & set(done.stdout.split())
