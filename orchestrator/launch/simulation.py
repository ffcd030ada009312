"""A run in one process: the in-process reference, with the same folder and the same verdict."""

from __future__ import annotations

import contextlib
import itertools
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hedgerow.agents.loading import LawError, law_class
from hedgerow.orchestrator.ground.assignment import Layout, law_of, layout, truth_of, views_of
from hedgerow.orchestrator.ground.law_source import FOLDER, differs, kept_law
from hedgerow.orchestrator.ground.laws import checked
from hedgerow.orchestrator.ground.signals import Interrupts
from hedgerow.orchestrator.launch.law_watch import LawWatch
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.verdict import Ending, Verdict
from hedgerow.orchestrator.runs import reference
from hedgerow.orchestrator.runs.folder import RunFolder, create
from hedgerow.orchestrator.views.screen import Quiet, Screen
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.named import Named, resolved, text_of
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End, Telemetry

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.run import Run


def simulate(network: Named, *settings: str, run_dir: str | Path | None = None, kept: bool = False) -> Run:
    """Run a network in this process, and read back what it left: `simulate("paper7", "steps=300", "law=hinf")`.

    network: as of `topologies.named.text_of`. settings: `path=value`, as for `--set` on the command line.
    run_dir: a new folder for the run, else one in runs/. kept: load the law from its copy in the folder of the run
    that `network` is. Raises HedgerowError for a mistake, or if no step was made,
    and LawError if the law fails; its `__cause__` is the exception of the law, and the folder has the steps before it.
    """
    # `up` imports this module, and does not need the reader of runs.
    from hedgerow.orchestrator.runs.reader import load_run  # noqa: PLC0415

    topology = resolved(network, settings)
    if kept:
        with kept_law(text_of(network)[2] / FOLDER):
            return simulate(topology, run_dir=run_dir)
    if isinstance(network, str | Path) and ":" in topology.law:
        _warn_of_another_source(topology.law, text_of(network)[2] / FOLDER)
    topology = checked(topology)  # find a mistake in its law before a folder exists
    folder = create(topology, None if run_dir is None else user_path(str(run_dir)))
    verdict = simulate_into(topology, folder, layout(topology, 1), Watching(record=False), Quiet())
    if verdict.error is not None:
        raise verdict.error
    if not verdict.content["steps_done"]:
        raise HedgerowError(verdict.line())
    return load_run(folder.path)


def _warn_of_another_source(law: str, kept: Path) -> None:
    if kept.is_dir() and (warning := differs(law, kept)):
        warnings.warn(warning, UserWarning, stacklevel=4)


def simulate_into(
    topology: Topology, folder: RunFolder, shards: Layout, watching: Watching, screen: Screen, replayed: bool = True
) -> Verdict:
    """Run a resolved topology in this process; Ctrl-C ends it cleanly with the verdict unknown."""
    ending = Ending(run=folder.name, engine="in-process", processes=0)
    run = Recording(topology, folder, watching, ending, replayed=replayed)
    folder.event("start", engine=ending.engine)
    run.tell_faults()
    began = time.monotonic()
    telemetry = reference.run(truth_of(topology, shards), views_of(topology, shards))
    watch: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
    if ":" in (law := law_of(topology)):
        watch = LawWatch(law_class(LawChoice.parse(law).name), law, screen.say)
    # A run that diverges overflows in the law and the plant: the verdict reports it.
    with np.errstate(over="ignore", invalid="ignore"), Interrupts() as interrupts, watch:
        try:
            for rows in _batches(telemetry, run.rows_at_once):
                if steps := [row for row in rows if isinstance(row, Telemetry)]:
                    if (batch := run.take(steps)) is not None:
                        screen.progress(batch)
                    ending.first_step_s = ending.first_step_s or time.monotonic() - began
                if isinstance(rows[-1], End):
                    run.finish(rows[-1])
                elif interrupts.count:
                    ending.stopped = f"stopped at step {run.observer.next_step}: {interrupts.name}"
                    break
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # a panic of a Rust library is not an Exception
            ending.end_by(error, folder.logs / "orchestrator.log")
            ending.stopped = f"stopped at step {run.observer.next_step}: {ending.stopped}"
        verdict = run.close()
        run.warn(screen)
        screen.verdict(verdict, folder.path)
        if run.viewer is not None:
            run.viewer.end()
        return verdict


def _batches(telemetry: Iterator[Telemetry | End], size: int) -> Iterator[list[Telemetry | End]]:
    """Yield rows in batches of `size`; the rows before a failure of the law come before its error."""
    failure: LawError | None = None
    while failure is None:
        rows: list[Telemetry | End] = []
        try:
            rows.extend(itertools.islice(telemetry, size))
        except LawError as error:
            failure = error
        if rows:
            yield rows
        elif failure is None:
            return
    raise failure
