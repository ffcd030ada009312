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
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from benchmarks.table import show
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import Layout, truth_of, views_of
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.truth import Truth
from hedgerow.topologies.graph import Array
from hedgerow.topologies.load import load
from hedgerow.topologies.partition import by_orders, cut, partition
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.codec import decode_end, encode_seen, kind_of, telemetry_bytes
from hedgerow.wire.message import Kind, Telemetry
from hedgerow.wire.runtime import LONG_BYTES, keep_memory, runtime_environment
from hedgerow.wire.session import WireError, close, open_client, publisher, subscriber
from hedgerow.wire.shared_rows import SharedRows, create
from hedgerow.wire.shared_rows import close as close_shared
from hedgerow.wire.shared_steps import create_steps, worth_sharing
from hedgerow.wire.stream import Inbox, rows_ahead

SIZES = [10**2, 10**3, 10**4, 10**5, 10**6]
NODE_STEPS = 4_000_000
"""the number of nodes times steps of a measurement"""
WARM_UP = 4
"""the number of steps that are not counted: they allocate memory and load loops"""
DEADLINE_S = 300.0


NUMBERS = "candidates: {random: 3}, disturbance: {kind: sinusoid, amplitude: 1, omega: {random: [0, 3.14159]}}"
"""the defaults of the nodes, besides x(0)"""
UNEQUAL = (", weight: {random: [0.5, 1]}", "b: {random: [0.05, 0.1]}, ")
"""of `graph:` and of `defaults:`"""


def network_of(kind: str, nodes: int, steps: int, folder: Path, unequal: bool = False) -> Topology:
    """Return a graph by a rule, with three candidates and a sinusoid per node, and other gains and weights if asked."""
    file = folder / "network.yaml"
    weight, gain = UNEQUAL if unequal else ("", "")
    file.write_text(
        f"{{name: network, b: 0.1, steps: {steps}, seed: 1, graph: {{kind: {kind}, nodes: {nodes}{weight}}}, "
        f"defaults: {{{gain}x0: 10, {NUMBERS}}}}}\n"
    )
    return resolve(load(str(file)), folder)


def engine(truth: Truth, views: Sequence[View]) -> tuple[float, Array, float]:
    """Return the steps per second of the in-process engine, the last state, and its CPU time per step [ms]."""
    began, spent, x = 0.0, 0.0, truth.x0
    for row in reference.run(truth, views):
        if row.t == WARM_UP - 1 and isinstance(row, Telemetry):
            began, spent = time.monotonic(), time.process_time()
        x = row.x
    steps = truth.steps - WARM_UP
    return steps / (time.monotonic() - began), x, 1e3 * (time.process_time() - spent) / steps


class Apart(NamedTuple):
    """The results of a run in separate processes."""

    steps_per_s: float
    x: Array
    cpu_ms: Sequence[float]
    """the CPU time per step of the plant, of the agents' processes, and of the receiver of telemetry"""


def shards(truth: Truth, views: Sequence[View], folder: Path, share: bool = True, steps: bool = True) -> Apart:
    """Return the same for separate processes: the plant, and one for each view.

    If `share`, telemetry is in shared memory; if `steps`, states and inputs are.
    """
    endpoint = f"unixsock-stream/{folder / 'router.sock'}"
    truth.write(folder / "plant.npz")
    n, e = len(truth.ids), len(truth.edges)
    size = telemetry_bytes(n, e)
    shared, path = create(size, rows_ahead(n, e)) if share and size > LONG_BYTES else (None, "")
    # On a busy machine, an agent may take longer than the plant waits by default: then every step is wrong.
    waits = ["--deadline", str(DEADLINE_S)]
    memories = {
        view.shard: memory
        for view in views
        if steps and worth_sharing(view.k, len(view.row)) and (memory := create_steps(view.k, len(view.row)))
    }
    plant = ["plant", str(folder / "plant.npz"), "--listen", endpoint, *waits, *(["--shared", path] if path else [])]
    commands = [plant + [word for p, memory in memories.items() for word in ("--memory", str(p), memory)]]
    for view in views:
        view.write(folder / f"{view.shard}.npz")
        own = ["--memory", memories[view.shard]] if view.shard in memories else []
        commands.append(["agents", str(folder / f"{view.shard}.npz"), "--connect", endpoint, *own])
    environment = os.environ | runtime_environment()
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", f"from hedgerow.{module}.process import main; main()", *rest, "--namespace", "ring"],
            env=environment,
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for module, *rest in commands
    ]
    try:
        pids = [*(process.pid for process in processes), os.getpid()]
        return _observe(endpoint, truth.steps, len(truth.ids), [psutil.Process(pid) for pid in pids], shared)
    finally:
        for one in (path, *memories.values()):
            close_shared(one)
        for command, process in zip(commands, processes, strict=True):
            _, output = process.communicate()  # this closes its lifeline, in case it still runs
            if process.returncode:
                print(f"{' '.join(command)}: {output.decode()}", file=sys.stderr)


def _observe(
    endpoint: str, steps: int, n: int, processes: Sequence[psutil.Process], shared: SharedRows | None
) -> Apart:
    """Receive and acknowledge all messages, until the end."""
    keep_memory()
    inbox, something = Inbox(None if shared is None else shared.read), threading.Event()

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
        network = network_of("ring", nodes, steps, folder)
        whole, parts = ([range(nodes)], partition(network.graph, processes))
        for _ in range(rounds):
            alone, x, cpu_alone = engine(truth_of(network, whole), views_of(network, whole))
            apart = shards(truth_of(network, parts), views_of(network, parts), folder)
            if x.tobytes() != apart.x.tobytes():
                raise SystemExit(f"{nodes} nodes: the trajectories differ")
            plant, *agents, observer = apart.cpu_ms
            by_cpu = sum(apart.cpu_ms) / cpu_alone
            runs.append((alone, apart.steps_per_s, by_cpu, plant, statistics.mean(agents), observer))
    alone, together, by_cpu, *cpu_ms = (statistics.median(each) for each in zip(*runs, strict=True))
    return {
        "nodes": nodes,
        "in one process [steps/s]": alone,
        f"in {processes} [steps/s]": together,
        "ratio": statistics.median(other / one for one, other, *_ in runs),
        "CPU, ratio to one process": by_cpu,
        "ns a node and step": 1e9 / together / nodes,
        **dict(zip(("plant [ms of CPU]", "an agent [ms of CPU]", "observer [ms of CPU]"), cpu_ms, strict=True)),
    }


def measure_cuts(nodes: int, processes: int, rounds: int) -> dict[str, float]:
    """Return one row of the table of `--cuts`: shards by the orders of nodes, and by METIS."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        network = network_of("random_regular", nodes, WARM_UP + 4 * (_steps(nodes) - WARM_UP), Path(scratch))
        graph, edges = network.graph, len(network.edges)
        before, after = min(by_orders(graph, processes), key=partial(cut, graph)), partition(graph, processes)
        return {
            "nodes": nodes,
            "cut by an order [%]": 100 * cut(graph, before) / edges,
            "cut by METIS [%]": 100 * cut(graph, after) / edges,
            **_in_turns((network, before), (network, after), rounds, Path(scratch)),
        }


def measure_unequal(nodes: int, processes: int, rounds: int) -> dict[str, float]:
    """Return one row of the table of `--unequal`: a ring, and a ring with gains and weights that differ."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        one, other = (network_of("ring", nodes, _steps(nodes), Path(scratch), unequal) for unequal in (False, True))
        parts = partition(one.graph, processes)
        return {"nodes": nodes, **_in_turns((one, parts), (other, parts), rounds, Path(scratch))}


def measure_shared(nodes: int, processes: int, rounds: int) -> dict[str, float]:
    """Return one row of the table of `--shared`: a ring with messages alone, and with shared memory."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        network = network_of("ring", nodes, _steps(nodes), Path(scratch))
        case = network, partition(network.graph, processes)
        return {"nodes": nodes, **_in_turns(case, case, rounds, Path(scratch), shared=(False, True))}


def measure_shared_steps(nodes: int, processes: int, rounds: int) -> dict[str, float]:
    """Return one row of the table of `--shared-steps`: a ring with states and inputs in messages, and in shared
    memory.

    Its telemetry is in shared memory in both.
    """
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        network = network_of("ring", nodes, _steps(nodes), Path(scratch))
        case = network, partition(network.graph, processes)
        return {"nodes": nodes, **_in_turns(case, case, rounds, Path(scratch), steps=(False, True))}


def _steps(nodes: int) -> int:
    return WARM_UP + max(10, min(1000, NODE_STEPS // nodes))


def _in_turns(
    before: tuple[Topology, Layout],
    after: tuple[Topology, Layout],
    rounds: int,
    folder: Path,
    shared: tuple[bool, bool] = (True, True),
    steps: tuple[bool, bool] = (True, True),
) -> dict[str, float]:
    """Return the medians of the ratios of two networks of shards, the second to the first, within a round."""
    runs = []
    for number in range(rounds):
        turns = [
            *zip(
                (before, after), shared, [one and other for one, other in zip(shared, steps, strict=True)], strict=True
            )
        ]
        if number % 2:
            turns.reverse()
        old, new = (shards(truth_of(*case), views_of(*case), folder, *memory) for case, *memory in turns)
        if number % 2:
            old, new = new, old
        if before[0] is after[0] and old.x.tobytes() != new.x.tobytes():
            raise SystemExit("the trajectories differ")
        runs.append((old, new))
    return {
        "steps/s, ratio": statistics.median(new.steps_per_s / old.steps_per_s for old, new in runs),
        "CPU, ratio": statistics.median(sum(new.cpu_ms) / sum(old.cpu_ms) for old, new in runs),
        "CPU of plant, ratio": statistics.median(new.cpu_ms[0] / old.cpu_ms[0] for old, new in runs),
        "CPU of agents, ratio": statistics.median(sum(new.cpu_ms[1:-1]) / sum(old.cpu_ms[1:-1]) for old, new in runs),
        "CPU, ms of the second": statistics.median(sum(new.cpu_ms) for _, new in runs),
    }


def main() -> None:
    """Print the table, or JSON with `--json`."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--nodes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cuts", action="store_true", help="a random graph by an order of its nodes, and by METIS")
    parser.add_argument("--unequal", action="store_true", help="a ring, and one with gains and weights that differ")
    parser.add_argument("--shared", action="store_true", help="messages alone, and shared memory")
    parser.add_argument(
        "--shared-steps", action="store_true", help="states and inputs in messages, and in shared memory"
    )
    parser.add_argument("--json", action="store_true")
    known = parser.parse_args()
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}", file=sys.stderr)
    of_size = measure
    for asked, other in (
        (known.cuts, measure_cuts),
        (known.unequal, measure_unequal),
        (known.shared, measure_shared),
        (known.shared_steps, measure_shared_steps),
    ):
        of_size = other if asked else of_size
    show((of_size(n, known.processes, known.rounds) for n in known.nodes), 26, known.json)


if __name__ == "__main__":
    main()
