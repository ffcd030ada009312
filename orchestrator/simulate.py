"""A run without a wire: the in-process reference, with the same folder and the same verdict."""

from __future__ import annotations

import itertools
import tempfile
import time
from pathlib import Path

from agents.shard import LawError
from orchestrator import in_process
from orchestrator.assign import Layout, truth_of, views_of
from orchestrator.folder import RunFolder, create
from orchestrator.interrupts import EndNowError, Interrupts
from orchestrator.run import Run, Watching, same_tables
from orchestrator.screen import Quiet, Screen
from orchestrator.verdict import Ending, Verdict
from topologies.schema import Topology
from wire.codec import End, Telemetry


def simulate(topology: Topology, folder: RunFolder, shards: Layout, watching: Watching, screen: Screen) -> Verdict:
    """Run a resolved topology in this process; Ctrl-C ends it cleanly with the verdict unknown."""
    ending = Ending(run=folder.name, engine="in-process", processes=0)
    run = Run(topology, folder, watching, ending)
    folder.event("start", engine=ending.engine)
    run.tell_faults()
    began = time.monotonic()
    telemetry = in_process.run(truth_of(topology, shards), views_of(topology, shards))
    with Interrupts() as interrupts:
        try:
            while rows := list(itertools.islice(telemetry, run.rows_at_once)):
                if steps := [row for row in rows if isinstance(row, Telemetry)]:
                    screen.progress(run.take(steps))
                    ending.first_step_s = ending.first_step_s or time.monotonic() - began
                if isinstance(rows[-1], End):
                    run.finish(rows[-1])
                elif interrupts.count:
                    ending.stopped = f"stopped at step {run.observer.next_step}: {interrupts.name}"
                    break
        except (EndNowError, LawError, OSError) as error:
            ending.stopped = f"stopped at step {run.observer.next_step}: {error}"
        verdict = run.close()
        for warning in run.warnings:
            screen.say(warning)
        screen.verdict(verdict, folder.path)
        if run.viewer is not None:
            run.viewer.end()
        return verdict


def equals_reference(topology: Topology, folder: RunFolder) -> bool:
    """Whether a finished run's tables equal those of the in-process reference, bit for bit."""
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        reference = create(topology, Path(scratch) / "reference")
        simulate(topology, reference, [range(len(topology.ids))], Watching(record=False), Quiet())
        return same_tables(folder.path, reference.path)
