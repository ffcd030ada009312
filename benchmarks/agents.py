"""`python -m benchmarks.agents`: the cost of an agent process: time to start, memory, and loaded modules."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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


def main() -> None:
    """Run paper7 slowly, measure its agents, and print."""
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
    print(first.strip())
    pss, rss = (max(getattr(each, kind) for each in memory) / 2**20 for kind in ("pss", "rss"))
    print(f"an agent of {len(agents)}: PSS {pss:.1f} MB, RSS {rss:.1f} MB")
    print(f"foreign libraries mapped: {[name for name in FOREIGN if any(name in parts for parts in loaded)] or 'none'}")
    print(f"an interpreter that loads an agent's modules: {import_seconds('hedgerow.agents.process'):.2f} s")


if __name__ == "__main__":
    main()
