"""The command for a long run that checks that memory, threads, open files and speed stay flat."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import EXPERIMENT
from hedgerow.orchestrator.cli.numbers import real, whole
from hedgerow.orchestrator.cli.options import Quiet, RunDir, Sets
from hedgerow.topologies.escape import echo

File = Annotated[str, typer.Argument(metavar="FILE", help="a topology file, a bundled name, or the folder of a run")]
Minutes = Annotated[float, real("for how long", metavar="N")]
Rate = Annotated[float, real("steps per second, 0 for as fast as possible")]
Processes = Annotated[int | None, whole("agent processes [one a node]", metavar="P", low=1)]
Record = Annotated[bool, typer.Option("--record/--no-record", help="write run.rrd")]
Faults = Annotated[bool, typer.Option("--faults/--no-faults", help="add random faults to the whole run")]


def register(app: typer.Typer) -> None:
    """Add this command to the operator's."""
    app.command(rich_help_panel=EXPERIMENT)(soak)


def soak(
    file: File = "paper7",
    minutes: Minutes = 20.0,
    rate: Rate = 0.0,
    processes: Processes = None,
    run_dir: RunDir = None,
    sets: Sets = None,
    record: Record = True,
    faults: Faults = True,
    quiet: Quiet = False,
) -> int:
    """Run a network for a long time under faults; exit code 1 if memory, threads, open files or speed do not stay
    flat.
    """
    from hedgerow.orchestrator.cli.topology import read  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.soak import LEAST_MINUTES, LEAST_WARM_UP_S, run_soak  # noqa: PLC0415
    from hedgerow.topologies.errors import UserError, check_options  # noqa: PLC0415

    check_options(rate=rate)
    if not LEAST_MINUTES <= minutes < 1e6:
        raise UserError(
            f"--minutes {minutes:g}: give at least {LEAST_MINUTES:g}; the first {LEAST_WARM_UP_S:g} s are not judged"
        )
    topology = read(file, sets, processes=processes)
    options = ["--rate", str(rate), *([] if record else ["--no-record"])]
    directory = run_dir or Path("runs") / f"{topology.name}-soak-{time.strftime('%Y%m%d-%H%M%S')}"
    say = (lambda _: None) if quiet else echo
    line, code = run_soak(topology, directory, minutes, faults, options, say)
    echo(line)
    return code
