"""The time to the first step: what `up` imports delays it, so slow libraries wait until the loop runs."""

from __future__ import annotations

import subprocess
import sys

SLOW = ("clarabel", "matplotlib", "numba", "pandas", "psutil", "pyarrow", "rerun", "rich", "scipy", "ssl", "unittest")
OBSERVER = ("hedgerow.orchestrator.launch.recording", "hedgerow.orchestrator.metrics.observer", "hedgerow.agents.shard")
"""modules that load while the processes start"""
PROGRAM = """
import sys
import hedgerow.orchestrator.cli.main
import hedgerow.orchestrator.launch.options
import hedgerow.orchestrator.launch.up
print(*sorted(sys.modules))
"""


def test_up_imports_no_slow_library_and_no_observer_before_the_processes_start() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert not {*SLOW, *OBSERVER} & set(done.stdout.split())
