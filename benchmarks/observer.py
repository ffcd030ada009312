"""The cost of observing a large network: CPU seconds per step of the loop, and of the other work of `up`.

python -m benchmarks.observer --kinds ring,grid --nodes 10000,100000,1000000 --steps 5
"""

from __future__ import annotations

import argparse
import itertools
import json
import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.metrics.certificate import Certificate
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.twins import Twins
from hedgerow.orchestrator.runs import reference
from hedgerow.orchestrator.runs.writer import Recorder
from hedgerow.orchestrator.views.rerun.stream import RerunStream
from hedgerow.topologies.load import parse
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.message import Telemetry

PARTS = ("loop", "twins", "certificate", "other metrics and checks", "tables", "run.rrd")


class Clock:
    """The CPU seconds of this thread, by part; a part within another is counted only once."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._within = [0.0]

    @contextmanager
    def of(self, part: str) -> Iterator[None]:
        """Count the time of the block."""
        began = time.thread_time()
        self._within.append(0.0)
        yield
        took = time.thread_time() - began
        self.seconds[part] += took - self._within.pop()
        self._within[-1] += took

    def wrap(self, owner: type, name: str, part: str) -> None:
        """Count a method."""
        method: Callable[..., Any] = getattr(owner, name)

        def timed(*args: Any) -> Any:
            with self.of(part):
                return method(*args)

        setattr(owner, name, timed)


def measure(kind: str, nodes: int, steps: int) -> dict[str, Any]:
    """Return the numbers of one network: seconds per step by part, once for gamma*, and the peak memory [MB]."""
    text = {"name": kind, "b": 0.1, "steps": steps, "seed": 1, "graph": {"kind": kind, "nodes": nodes}}
    text["defaults"] = {"x0": 5, "candidates": {"random": 5}, "disturbance": {"kind": "white", "std": 0.5}}
    topology = resolve(parse(json.dumps(text).encode(), kind, Path()))
    clock = Clock()
    clock.wrap(Twins, "run", "twins")
    clock.wrap(Certificate, "take", "certificate")
    observer, shards = Observer(topology), layout(topology, 1)
    rows = reference.run(truth_of(topology, shards), views_of(topology, shards))
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        recorder = Recorder(topology, Path(folder))
        stream = RerunStream(topology, observer, "measured", Path(folder) / "run.rrd", None)
        for _ in range(steps):
            with clock.of("loop"):
                row = next(rows)
            assert isinstance(row, Telemetry)
            with clock.of("other metrics and checks"):
                batch = observer.take([row])
            with clock.of("tables"):
                recorder.write(batch)
            with clock.of("run.rrd"):
                stream.log(batch)
        stream.close(5.0)
    with clock.of("gamma*"):
        _ = observer.gamma_star
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    seconds = {part: clock.seconds[part] / steps for part in PARTS}
    return {"graph": kind, "nodes": nodes, **seconds, "gamma*": clock.seconds["gamma*"], "memory": memory}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", default="ring,grid")
    parser.add_argument("--nodes", default="10000,100000,1000000")
    parser.add_argument("--steps", type=int, default=5)
    chosen = parser.parse_args()
    print(f"| graph | nodes | {' | '.join(PARTS)} | gamma*, once | memory [MB] |\n|{'---|' * (len(PARTS) + 4)}")
    for kind, nodes in itertools.product(chosen.kinds.split(","), map(int, chosen.nodes.split(","))):
        found = measure(kind, nodes, chosen.steps)
        seconds = " | ".join(f"{found[part]:.4f}" for part in (*PARTS, "gamma*"))
        print(f"| {kind} | {nodes:,} | {seconds} | {found['memory']:.0f} |", flush=True)


if __name__ == "__main__":
    main()
