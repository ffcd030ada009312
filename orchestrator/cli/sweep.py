"""The command that runs a network many times."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import EXPERIMENT
from hedgerow.orchestrator.cli.numbers import whole
from hedgerow.orchestrator.cli.options import Quiet
from hedgerow.orchestrator.launch.ray_cluster import check
from hedgerow.topologies.errors import check_options
from hedgerow.topologies.escape import echo
from hedgerow.topologies.paths import user_path

File = Annotated[str, typer.Argument(metavar="FILE", help="a topology file, or a bundled name")]
Seeds = Annotated[str, typer.Option(metavar="FIRST:STOP", help="every seed from FIRST up to, and without, STOP")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE,...", help="the values that a key of the file takes")
]
Engine = Annotated[
    str, typer.Option(metavar="in-process|zenoh", help="in-process: one process per run; zenoh: one process per agent")
]
Out = Annotated[
    Path | None,
    typer.Option(parser=user_path, metavar="DIR", help="the sweep's folder, new or of this sweep [sweeps/NAME-HASH]"),
]
Jobs = Annotated[int | None, whole("runs at once [the cores; with --engine zenoh 1]")]
On = Annotated[str | None, typer.Option(metavar="ray|ray://HOST:PORT", help="the cluster to run on [this machine]")]


def register(app: typer.Typer) -> None:
    """Add this command to the operator's."""
    app.command(rich_help_panel=EXPERIMENT)(sweep)


def sweep(
    file: File,
    seeds: Seeds,
    sets: Sets = None,
    engine: Engine = "in-process",
    out: Out = None,
    jobs: Jobs = None,
    on: On = None,
    quiet: Quiet = False,
) -> int:
    """Run a network under many seeds and settings, into one table; the same command continues a stopped sweep."""
    from hedgerow.orchestrator.experiments.sweep import sweep as run  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.sweep.plan import plan  # noqa: PLC0415

    check_options(jobs=jobs)
    if on is not None:
        check(on)
    done = run(plan(Path(file), seeds, sets or [], engine), out, jobs, on, quiet)
    echo(done.line)
    return done.exit_code
