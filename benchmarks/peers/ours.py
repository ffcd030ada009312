"""Hedgerow as a user runs it, with telemetry, metrics, twins, checks, deadlines and the verdict, but without run.rrd.

Memory is measured in a second run at a slow rate, so that the timed run is not disturbed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.peers.memory import pss_of
from benchmarks.peers.network import BEGAN, Done, Network
from hedgerow.orchestrator.runs.reader import load_run

SLOW = ("--steps", "1000000", "--rate", "20")
SETTLED = "step "
"""the start of a line of progress, which appears about a second after the first step"""


def _command(how: str, network: Network, folder: str, *options: str) -> list[str]:
    viewer = ["--viewer", "none", "--no-record", "--run-dir", folder]
    return [sys.executable, "-m", "hedgerow.orchestrator", *how.split(), network.file, *viewer, *options]


def _memory(how: str, network: Network) -> float:
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        options = SLOW if how.startswith("up") else SLOW[:2]
        command = _command(how, network, f"{scratch}/run", *options)
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
            assert process.stdout is not None
            next(line for line in process.stdout if line.startswith(SETTLED))
            pss = pss_of(process.pid)
            process.terminate()
            process.stdout.read()
    return pss


def run(network: Network, steps: int, how: str) -> Done:
    """Run `orchestrator HOW` in its own processes."""
    pss = _memory(how, network)
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        folder = Path(scratch) / "run"
        os.environ[BEGAN] = str(time.monotonic())
        command = _command(how, network, str(folder), "--steps", str(steps), "--json")
        output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        verdict = json.loads(output)
        recorded = load_run(folder)
        return Done(verdict["steps_per_s"], verdict["first_step_s"], pss, recorded.x, recorded.u)
