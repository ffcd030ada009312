"""The commands that read a run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli import complete
from hedgerow.orchestrator.cli.names import INSPECT
from hedgerow.topologies.escape import echo
from hedgerow.topologies.paths import user_path

Run = Annotated[
    str, typer.Argument(metavar="RUN", help="a run folder, or its name in runs/", autocompletion=complete.runs)
]
To = Annotated[str, typer.Option(metavar="csv|parquet|npz|mat", help="tables, or named arrays")]
Out = Annotated[
    Path | None,
    typer.Option(parser=user_path, metavar="PATH", help="the folder of the tables, or the file [RUN-FORM/, RUN.FORM]"),
]
Force = Annotated[bool, typer.Option("--force", help="replace existing files")]


def register(app: typer.Typer) -> None:
    """Add these commands to the operator's."""
    app.command(rich_help_panel=INSPECT)(export)


def export(to: To, run: Run = "runs/latest", out: Out = None, force: Force = False) -> int:
    """Write a run, finished or not, into files for other tools."""
    from hedgerow.orchestrator.runs import export as exports  # noqa: PLC0415
    from hedgerow.orchestrator.runs.reader import load_run  # noqa: PLC0415

    recorded = load_run(run)
    files = exports.export(recorded, to, out, force)
    echo(f"{recorded.T} steps of {recorded.name}: {', '.join(map(str, files))}")
    return 0
