"""`python -m benchmarks.loop`: paper7 against the bare Zenoh loop, with run.rrd and with lost messages, in pairs.

Every round runs each variant once, in turn; the table gives medians over the rounds and of the ratios within a
round, so that a machine that slows down slows all of them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks import bare
from topologies.load import load

DROPS = [{"kind": "drop", "link": list(edge), "probability": 0.3} for edge in load("paper7").edges]
"""Every message of every link is lost with a probability of 0.3, and made up for later."""


def ours(steps: int, *options: str) -> dict[str, Any]:
    """The verdict of one `orchestrator up paper7`."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        command = [sys.executable, "-m", "orchestrator", "up", "paper7", "--steps", str(steps), "--viewer", "none"]
        command += ["--json", "--run-dir", str(Path(folder) / "run"), *options]
        output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600).stdout
        verdict: dict[str, Any] = json.loads(output)
        return verdict


def main() -> None:
    """Print the table, or JSON with `--json`."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    known = parser.parse_args()
    topology = load("paper7")
    edges = [(int(i), int(j)) for i, j in topology.graph.edges]
    rounds = []
    first_steps = []
    for _ in range(known.rounds):
        without = ours(known.steps, "--no-record")
        recording = ours(known.steps, "--record")
        dropping = ours(known.steps, "--no-record", "--set", f"faults={json.dumps(DROPS)}")
        first_steps += [without["first_step_s"], recording["first_step_s"]]
        rounds.append(
            {
                "bare": bare.run(len(topology.ids), edges, known.steps),
                "ours": without["steps_per_s"],
                "ours, run.rrd": recording["steps_per_s"],
                "ours, 30% drops": dropping["steps_per_s"],
            }
        )
    rates = {name: statistics.median(each[name] for each in rounds) for name in rounds[0]}
    ratios = {
        "ours / bare": statistics.median(each["ours"] / each["bare"] for each in rounds),
        "run.rrd / none": statistics.median(each["ours, run.rrd"] / each["ours"] for each in rounds),
        "30% drops / none": statistics.median(each["ours, 30% drops"] / each["ours"] for each in rounds),
    }
    result = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "steps": known.steps,
        "rounds": rounds,
        "median steps/s": rates,
        "median ratios": ratios,
        "first step [s], median": statistics.median(first_steps),
    }
    if known.json:
        print(json.dumps(result, indent=2))
        return
    print(f"paper7, {known.steps} steps, {known.rounds} rounds on {result['machine']}")
    for name, rate in rates.items():
        print(f"  {name:<16} {rate:8.0f} steps/s")
    for name, ratio in ratios.items():
        print(f"  {name:<16} {ratio:8.2f}")
    print(f"  first step after {result['first step [s], median']:.2f} s")


if __name__ == "__main__":
    main()
