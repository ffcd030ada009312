"""`python -m benchmarks.shards`: a ring in agent processes over Zenoh, beside the same ring in one process, by size.

The engine is `hedgerow.orchestrator.runs.reference`: plant and agents in one process, without an observer. The shards
are the plant and the agents as `orchestrator up` starts them. The benchmark receives telemetry and computes nothing
from it: it measures the loop with its messages, without metrics. Both give the same last state, bit for bit; the
benchmark checks this.

Every round runs each in turn. The table gives medians over the rounds, of wall time and of the ratios within a round.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from benchmarks.table import show
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import truth_of, views_of
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.truth import Truth
from hedgerow.topologies.graph import Array
from hedgerow.topologies.load import load
from hedgerow.topologies.partition import partition
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.codec import Kind, Telemetry, decode_end, encode_seen, kind_of
from hedgerow.wire.runtime import keep_memory, runtime_environment
from hedgerow.wire.session import WireError, close, open_client, publisher, subscriber
from hedgerow.wire.stream import Inbox

SIZES = [10**2, 10**3, 10**4, 10**5, 10**6]
NODE_STEPS = 4_000_000
"""the number of nodes times steps of a measurement"""
WARM_UP = 4
"""the number of steps that are not counted: they allocate memory and load loops"""
DEADLINE_S = 300.0


def ring(nodes: int, steps: int, folder: Path) -> Topology:
    """Return a ring with three candidates and a sinusoid per node."""
    file = folder / "ring.yaml"
    file.write_text(
        f"{{name: ring, b: 0.1, steps: {steps}, seed: 1, graph: {{kind: ring, nodes: {nodes}}}, defaults: {{x0: 10, "
        "candidates: {random: 3}, disturbance: {kind: sinusoid, amplitude: 1, omega: {random: [0, 3.14159]}}}}\n"
    )
    return resolve(load(str(file)), folder)


def engine(truth: Truth, views: Sequence[View]) -> tuple[float, Array]:
    """Return the steps per second of the in-process engine, and the last state."""
    began, x = 0.0, truth.x0
    for row in reference.run(truth, views):
        if row.t == WARM_UP - 1 and isinstance(row, Telemetry):
            began = time.monotonic()
        x = row.x
    return (truth.steps - WARM_UP) / (time.monotonic() - began), x


class Apart(NamedTuple):
    """The results of a run in separate processes."""

    steps_per_s: float
    x: Array
    cpu_ms: Sequence[float]
    """the CPU time per step of the plant, of the agents' processes, and of the receiver of telemetry"""


def shards(truth: Truth, views: Sequence[View], folder: Path) -> Apart:
    """Return the same for separate processes: the plant, and one for each view."""
    endpoint = f"unixsock-stream/{folder / 'router.sock'}"
    truth.write(folder / "plant.npz")
    commands = [["plant", str(folder / "plant.npz"), "--listen", endpoint]]
    for view in views:
        view.write(folder / f"{view.shard}.npz")
        commands.append(["agents", str(folder / f"{view.shard}.npz"), "--connect", endpoint])
    environment = os.environ | runtime_environment()
    base = [sys.executable, "-m"]
    processes = [
        subprocess.Popen(
            [*base, *command, "--namespace", "ring"], env=environment, stdin=subprocess.PIPE, stderr=subprocess.PIPE
        )
        for command in commands
    ]
    try:
        pids = [*(process.pid for process in processes), os.getpid()]
        return _observe(endpoint, truth.steps, len(truth.ids), [psutil.Process(pid) for pid in pids])
    finally:
        for command, process in zip(commands, processes, strict=True):
            _, said = process.communicate()  # this closes its lifeline, in case it still runs
            if process.returncode:
                print(f"{' '.join(command)}: {said.decode()}", file=sys.stderr)


def _observe(endpoint: str, steps: int, n: int, processes: Sequence[psutil.Process]) -> Apart:
    """Receive and acknowledge all messages, until the end."""
    keep_memory()
    inbox, something = Inbox(), threading.Event()

    def put(whole: bytes) -> None:
        inbox.put(whole)
        something.set()

    session = open_client(endpoint, "ring")
    rows, began, ended = 0, 0.0, 0.0
    before = after = np.zeros(len(processes))

    def spent() -> Array:
        return np.array([sum(process.cpu_times()[:2]) for process in processes])

    try:
        with subscriber(session, keys.TELEMETRY, put):
            seen = publisher(session, keys.SEEN)
            while something.wait(DEADLINE_S):
                something.clear()
                for message in inbox.drain():
                    if kind_of(message) == Kind.TELEMETRY:
                        rows += 1
                        ended = time.monotonic()
                        if rows == WARM_UP:
                            began, before = ended, spent()
                        elif rows == steps:
                            after = spent()
                    elif kind_of(message) == Kind.END:
                        seen.put(encode_seen(inbox.last))
                        if rows < steps:
                            raise SystemExit(f"the run ended after {rows} of {steps} steps")
                        cpu_ms = 1e3 * (after - before) / (steps - WARM_UP)
                        return Apart((steps - WARM_UP) / (ended - began), decode_end(message, n).x, cpu_ms.tolist())
                seen.put(encode_seen(inbox.last))
        raise WireError(f"nothing came for {DEADLINE_S:g} s")
    finally:
        close(session)


def measure(nodes: int, processes: int, rounds: int) -> dict[str, float]:
    """Return one row of the table."""
    steps = WARM_UP + max(10, min(3000, NODE_STEPS // nodes))
    runs = []
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        folder = Path(scratch)
        network = ring(nodes, steps, folder)
        whole, parts = ([range(nodes)], partition(network.graph, processes))
        for _ in range(rounds):
            alone, x = engine(truth_of(network, whole), views_of(network, whole))
            apart = shards(truth_of(network, parts), views_of(network, parts), folder)
            if x.tobytes() != apart.x.tobytes():
                raise SystemExit(f"{nodes} nodes: the trajectories differ")
            plant, *agents, observer = apart.cpu_ms
            runs.append((alone, apart.steps_per_s, plant, statistics.mean(agents), observer))
    alone, together, *cpu_ms = (statistics.median(each) for each in zip(*runs, strict=True))
    return {
        "nodes": nodes,
        "in one process [steps/s]": alone,
        f"in {processes} [steps/s]": together,
        "ratio": statistics.median(other / one for one, other, *_ in runs),
        "ns a node and step": 1e9 / together / nodes,
        **dict(zip(("plant [ms of CPU]", "an agent [ms of CPU]", "observer [ms of CPU]"), cpu_ms, strict=True)),
    }


def main() -> None:
    """Print the table, or JSON with `--json`."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--nodes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    known = parser.parse_args()
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}", file=sys.stderr)
    show((measure(n, known.processes, known.rounds) for n in known.nodes), 26, known.json)


if __name__ == "__main__":
    main()
