"""`python -m benchmarks.agents`: the cost of an agent process: time to start, memory, and loaded modules."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import psutil

FOREIGN = ("pydantic", "rerun", "scipy", "pyarrow", "yaml", "rich", "typer")


def import_seconds(module: str) -> float:
    """Return the wall time of an interpreter that loads `module` and ends; the best of five."""
    took = []
    for _ in range(5):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", f"import {module}"], check=True)
        took.append(time.perf_counter() - began)
    return min(took)


class Agents(NamedTuple):
    """The agents of paper7 in seven processes."""

    first: str
    """the line of the first step"""
    pss_mb: float
    """the largest proportional set size"""
    rss_mb: float
    """the largest resident set size"""
    libraries: set[tuple[str, ...]]
    """the parts of the paths that one has mapped"""


def measure() -> Agents:
    """Run paper7 slowly and measure its agents."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        folder = Path(scratch) / "run"
        command = [sys.executable, "-m", "hedgerow.orchestrator", "up", "paper7", "--steps", "100000", "--rate", "50"]
        command += ["--viewer", "none", "--no-record", "--run-dir", str(folder)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as up:
            assert up.stdout is not None
            first = next(line for line in up.stdout if line.startswith("running"))
            next(line for line in up.stdout if line.startswith("step"))
            start = json.loads((folder / "events.jsonl").read_text().splitlines()[0])
            agents = [psutil.Process(pid) for name, pid in start["pids"].items() if name.startswith("agent")]
            memory = [agent.memory_full_info() for agent in agents]
            loaded = {Path(region.path).parts for region in agents[0].memory_maps() if region.path}
            up.terminate()
            up.stdout.read()
    pss, rss = (max(getattr(each, kind) for each in memory) / 2**20 for kind in ("pss", "rss"))
    return Agents(first.strip(), pss, rss, loaded)


def main() -> None:
    """Print what an agent costs."""
    agents = measure()
    print(agents.first)
    print(f"an agent of seven: PSS {agents.pss_mb:.1f} MB, RSS {agents.rss_mb:.1f} MB")
    mapped = [name for name in FOREIGN if any(name in parts for parts in agents.libraries)]
    print(f"foreign libraries mapped: {mapped or 'none'}")
    print(f"an interpreter that loads an agent's modules: {import_seconds('hedgerow.agents.process'):.2f} s")


if __name__ == "__main__":
    main()
