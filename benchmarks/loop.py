"""`python -m benchmarks.loop`: the speed of the loop with and without other loads, in pairs.

The cases are paper7 against the bare Zenoh loop, with run.rrd, secure, with lost messages, and with viewers: a page
that is served but not opened, a live viewer, and a frozen one. With `--nodes N`, a ring of N nodes in two processes
replaces paper7; its cases are run.rrd, secure, and the viewers.

Every round runs each variant once, in turn. The table gives medians over the rounds and of the ratios within a round,
so a slow phase of the machine affects all variants. A viewer is a window if there is a display. Otherwise it is
headless; it then needs a graphics driver and draws on the CPU, and with few cores its ratio shows that.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks import bare
from hedgerow.orchestrator.views.rerun.viewer import Viewer, has_display, native
from hedgerow.topologies.load import load

FREEZE_AFTER_S = 1.0
"""the time from the first step until a viewer is frozen [s]: it then has the first steps and its connection"""
VIEWER_DEADLINE_S = 60.0
DROPS = [{"kind": "drop", "link": list(edge), "probability": 0.3} for edge in load("paper7").pairs]
"""Every message of every link is lost with a probability of 0.3, and back-filled later."""

Say = Callable[[str], None]


def ring(nodes: int, folder: Path) -> str:
    """Return a file with a ring of this number of nodes, each with three candidates and a sinusoid."""
    defaults = {
        "x0": 10,
        "candidates": {"random": 3},
        "disturbance": {"kind": "sinusoid", "amplitude": 1, "omega": {"random": [0, 3.14159]}},
    }
    edges = [[i, (i + 1) % nodes] for i in range(nodes)]
    network = {"name": f"ring{nodes}", "b": 0.1, "steps": 100, "seed": 1, "defaults": defaults}
    file = folder / f"ring{nodes}.yaml"
    file.write_text(json.dumps({**network, "nodes": list(range(nodes)), "edges": edges}), encoding="utf-8")
    return str(file)


def ours(network: str, *options: str, viewer: str = "none", on_say: Say = lambda _: None) -> dict[str, Any]:
    """Return the verdict of one `orchestrator up`; `on_say` receives every line of its output."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        command = [sys.executable, "-m", "hedgerow.orchestrator", "up", network, "--viewer", viewer]
        command += ["--json", "--run-dir", str(Path(folder) / "run"), *options]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            read = []
            for line in process.stderr:
                read.append(line)
                on_say(line)
            output = process.stdout.read()
        if process.returncode:
            raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}\n{''.join(read)}{output}")
        verdict: dict[str, Any] = json.loads(output)
        return verdict


@contextlib.contextmanager
def watching() -> Iterator[Viewer]:
    """Provide a viewer for one run, and kill it afterwards."""
    viewer = native(*([] if has_display() else ["--headless"]))
    assert viewer.process is not None
    try:
        by = time.monotonic() + VIEWER_DEADLINE_S
        while not viewer.listens():
            if viewer.gone or time.monotonic() > by:
                raise SystemExit(
                    "the viewer does not start: without a display it needs a graphics driver"
                    " (on Debian, apt-get install mesa-vulkan-drivers), or leave it out with --no-viewer"
                )
            time.sleep(0.05)
        yield viewer
        if viewer.gone:
            raise SystemExit("the viewer ended before the run did: without a display it needs a graphics driver")
    finally:
        viewer.process.kill()
        viewer.process.wait()


def watched(network: str, *options: str, freeze: bool = False) -> dict[str, Any]:
    """Return the verdict of a run with a viewer; with `freeze`, the viewer stops reading soon after the start."""
    with watching() as viewer:
        assert viewer.process is not None
        timer = threading.Timer(FREEZE_AFTER_S, viewer.process.send_signal, [signal.SIGSTOP])

        def on_say(line: str) -> None:
            if freeze and line.startswith("running: first step"):
                timer.start()

        try:
            verdict = ours(network, *options, viewer=viewer.url, on_say=on_say)
        finally:
            timer.cancel()
        if freeze and verdict["elapsed_s"] < 2 * FREEZE_AFTER_S:
            print(f"a run was over in {verdict['elapsed_s']:.1f} s: too soon for a frozen viewer", file=sys.stderr)
        return verdict


def main() -> None:
    """Print the table, or JSON with `--json`."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--nodes", type=int, help="a ring of this number of nodes in two processes, in place of paper7")
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--no-viewer", action="store_true", help="leave the viewers out")
    parser.add_argument("--json", action="store_true")
    known = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        result = measure(known.nodes, known.steps, known.rounds, not known.no_viewer, Path(folder))
    if known.json:
        print(json.dumps(result, indent=2))
        return
    print(f"{result['network']}, {known.steps} steps, {known.rounds} rounds on {result['machine']}")
    for name, rate in result["median steps/s"].items():
        print(f"  {name:<28} {rate:8.0f} steps/s")
    for name, ratio in result["median ratios"].items():
        print(f"  {name:<28} {ratio:8.2f}")
    print(f"  first step after {result['first step [s], median']:.2f} s")


def measure(nodes: int | None, steps: int, rounds: int, viewers: bool, folder: Path) -> dict[str, Any]:
    """Run all rounds; `nodes` None for paper7."""
    network = "paper7" if nodes is None else ring(nodes, folder)
    options = ["--steps", str(steps), *([] if nodes is None else ["--processes", "2"])]
    done, first_steps = [], []
    for _ in range(rounds):
        rates = {}
        if nodes is None:
            topology = load(network)
            edges = [(int(i), int(j)) for i, j in topology.graph.edges]
            rates["bare"] = bare.run(len(topology.ids), edges, steps)
        without = ours(network, *options, "--no-record")
        recording = ours(network, *options, "--record")
        verdicts = {
            "ours": without,
            "ours, run.rrd": recording,
            "ours, secure": ours(network, *options, "--no-record", "--secure"),
        }
        if nodes is None:
            verdicts["ours, 30% drops"] = ours(network, *options, "--no-record", "--set", f"faults={json.dumps(DROPS)}")
        if viewers:
            verdicts["ours, run.rrd, page"] = ours(network, *options, "--record", viewer="web")
            verdicts["ours, run.rrd, viewer"] = watched(network, *options, "--record")
            verdicts["ours, run.rrd, frozen viewer"] = watched(network, *options, "--record", freeze=True)
        first_steps += [without["first_step_s"], recording["first_step_s"]]
        done.append(rates | {name: verdict["steps_per_s"] for name, verdict in verdicts.items()})
    ratios = {f"{name.removeprefix('ours, ')} / none": (name, "ours") for name in done[0] if name.startswith("ours, ")}
    if nodes is None:
        ratios = {"ours / bare": ("ours", "bare"), **ratios}
    return {
        "network": Path(network).stem if nodes is None else f"ring of {nodes} nodes in 2 processes",
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "steps": steps,
        "rounds": done,
        "median steps/s": {name: statistics.median(each[name] for each in done) for name in done[0]},
        "median ratios": {
            name: statistics.median(each[one] / each[other] for each in done) for name, (one, other) in ratios.items()
        },
        "first step [s], median": statistics.median(first_steps),
    }


if __name__ == "__main__":
    main()
