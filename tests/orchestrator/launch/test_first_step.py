"""The time to the first step: what `up` imports delays it, so slow libraries wait until the loop runs."""

from __future__ import annotations

import subprocess
import sys

import typer.main

from hedgerow.orchestrator.cli.main import _without_other_commands, app

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


def test_a_command_is_built_without_the_other_ones_and_an_unknown_word_gets_all() -> None:
    every = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    for word in (*every, "", "no-command"):
        part = set(typer.main.get_command(_without_other_commands(app, word)).commands)  # type: ignore[attr-defined]
        assert part in ({word}, every)
        assert word in part or part == every
    assert set(typer.main.get_command(_without_other_commands(app, "up")).commands) == {"up"}  # type: ignore[attr-defined]
