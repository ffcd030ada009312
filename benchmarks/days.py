"""`python -m benchmarks.days`: memory and disk space of a long run of paper7, and a test that it opens again.

One second of real telemetry is repeated with increasing step numbers. The parts of `up` receive it: the observer, the
tables, run.rrd and a page's server. Memory does not depend on the numbers. Each part of the table is a separate
process; sizes are resident, as the kernel counts them.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import multiprocessing
import tempfile
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil

from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.verdict import Ending
from hedgerow.orchestrator.runs.folder import RunFolder, create
from hedgerow.orchestrator.runs.reference import run as run_in_process
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End, Telemetry

SHORT, BATCH = 2048, 256
MARKS = (0.1, 0.5, 1.0)
"""the parts of the run at which memory is measured"""
NICE = 10


def rows_of(topology: Topology) -> list[Telemetry]:
    """Return SHORT steps of a network."""
    short = topology.model_copy(update={"steps": SHORT})
    ran = run_in_process(truth_of(short, layout(short, 1)), views_of(short, layout(short, 1)))
    return [row for row in ran if isinstance(row, Telemetry)]


def again_and_again(rows: list[Telemetry], steps: int) -> Iterator[list[Telemetry]]:
    """Yield `steps` steps in batches, as `up` reads them."""
    for first in range(0, steps, BATCH):
        some = itertools.islice(itertools.cycle(rows), first % SHORT, first % SHORT + min(BATCH, steps - first))
        yield [row._replace(t=first + k) for k, row in enumerate(some)]


def mb(process: psutil.Process) -> float:
    """Return the resident memory of a process [MB]."""
    return float(process.memory_info().rss / 1e6)


def record(steps: int, directory: Path, watching: Watching, answer: Connection) -> None:
    """Record a long run, and send its costs at the marks."""
    psutil.Process().nice(NICE)
    topology = resolve(load("paper7", [f"steps={steps}"]))
    rows = rows_of(topology)
    folder = create(topology, directory)
    run = Recording(topology, folder, watching, Ending(folder.name, "in-process", 0))
    own, server, marks = psutil.Process(), None, list(MARKS)
    sizes: dict[str, list[float]] = {"own": [], "server": []}
    began = time.monotonic()
    for batch in again_and_again(rows, steps):
        run.take(batch)
        if server is None and run.viewer is not None and run.viewer.process is not None:
            server = psutil.Process(run.viewer.process.pid)
        if batch[-1].t + 1 >= marks[0] * steps:
            marks.pop(0)
            sizes["own"].append(mb(own))
            sizes["server"].append(mb(server) if server is not None else 0.0)
            if not marks:
                break
    seconds = time.monotonic() - began
    run.finish(End(steps, rows[0].x, 1.0))
    run.close()
    if run.viewer is not None:
        run.viewer.end()
    answer.send({"steps_per_s": steps / seconds, **sizes})


def recorded(steps: int, directory: Path, watching: Watching) -> dict[str, Any]:
    """Return the costs of a recording in a separate process."""
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=record, args=(steps, directory, watching, theirs))
    process.start()
    while process.is_alive() and not ours.poll(0.5):
        pass
    answer: dict[str, Any] = ours.recv()
    process.join()
    return answer


def opened(folder: RunFolder, steps: int) -> dict[str, float]:
    """Open a recorded run in a viewer without a window, and wait for its last step."""
    from rerun.experimental import ViewerClient  # noqa: PLC0415

    from hedgerow.orchestrator.views.rerun.opening import open_runs  # noqa: PLC0415
    from hedgerow.orchestrator.views.rerun.viewer import native  # noqa: PLC0415

    viewer = native("--headless", memory="75%")
    assert viewer.process is not None
    try:
        viewer.wait_until_it_listens()
        began = time.monotonic()
        open_runs([str(folder.path)], viewer.url, print)
        sent = time.monotonic() - began
        while True:
            with contextlib.suppress(TimeoutError, RuntimeError):  # it is busy
                (shown,) = ViewerClient.connect(viewer.url).get_state().recordings
                (first, last) = next((line.start, line.end) for line in shown.timelines if line.name == "step")
                if last == steps or time.monotonic() - began > 600:
                    break
            time.sleep(0.5)
        seconds = time.monotonic() - began
        return {
            "sent_s": sent,
            "shown_s": seconds,
            "viewer_mb": mb(psutil.Process(viewer.process.pid)),
            "first": float(first or 0),
            "last": float(last or 0),
        }
    finally:
        viewer.process.kill()
        viewer.process.wait()


def main() -> None:
    """Print a line for each way to record, and one for opening the run again; `--json` prints all numbers."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--only", choices=("tables", "run.rrd", "page"), action="append")
    parser.add_argument("--open", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--json", action="store_true")
    known = parser.parse_args()
    ways = {
        "tables": Watching(record=False),
        "run.rrd": Watching(),
        "page": Watching(record=False, viewer="web"),
    }
    answers: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        for way, watching in ways.items():
            if known.only and way not in known.only:
                continue
            folder = RunFolder(Path(scratch) / way.replace(".", "-"))
            answers[way] = recorded(known.steps, folder.path, watching)
            files = {file.name: file.stat().st_size / 1e6 for file in sorted(folder.path.iterdir()) if file.is_file()}
            answers[way]["files_mb"] = {name: round(size, 1) for name, size in files.items() if size > 0.1}
            print(way, json.dumps(answers[way]), flush=True)
            if way == "run.rrd" and known.open:
                answers["open"] = opened(folder, known.steps)
                print("open", json.dumps(answers["open"]), flush=True)
    if known.json:
        print(json.dumps(answers, indent=1))


if __name__ == "__main__":
    main()
