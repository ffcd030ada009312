"""The command that draws the figures of runs, for a paper and for a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli import complete
from hedgerow.orchestrator.cli.names import INSPECT
from hedgerow.orchestrator.cli.numbers import real
from hedgerow.topologies.escape import echo
from hedgerow.topologies.paths import user_path

Runs = Annotated[
    list[str] | None,
    typer.Argument(metavar="RUN", help="run folders, or names in runs/ [runs/latest]", autocompletion=complete.runs),
]
Out = Annotated[Path | None, typer.Option(parser=user_path, metavar="DIR", help="the folder to write [RUN-report]")]
Figures = Annotated[str | None, typer.Option(metavar="2,4,...", help="only these figures [all]")]
Width = Annotated[float | None, real("width of a figure in inches [3.5, one column]", metavar="IN")]
Style = Annotated[str | None, typer.Option(metavar="FILE", help="a .mplstyle file, or a style of matplotlib, on top")]
Formats = Annotated[str, typer.Option("--format", metavar="pdf,...", help="formats of the figures: pdf, png, svg, pgf")]
Force = Annotated[bool, typer.Option("--force", help="replace an existing report")]


def register(app: typer.Typer) -> None:
    """Add this command to the operator's."""
    app.command(rich_help_panel=INSPECT)(report)


def report(
    runs: Runs = None,
    out: Out = None,
    figures: Figures = None,
    force: Force = False,
    width: Width = None,
    style: Style = None,
    formats: Formats = "pdf,png",
) -> int:
    """Draw the figures of a run, and a page with all numbers; show several runs beside each other."""
    from hedgerow.orchestrator.report import report as write  # noqa: PLC0415
    from hedgerow.orchestrator.runs.reader import load_run  # noqa: PLC0415

    recorded = [load_run(run) for run in runs or ["runs/latest"]]
    names = [name.strip().lower() for name in formats.split(",")]
    page, *drawn = write(recorded, out, figures, force, width_in=width, style=style, formats=names)
    kinds = len(drawn) // len(names)
    echo(f"{page}, and {kinds} figure{'s' * (kinds != 1)} as {' and '.join(map(str.upper, names))} beside it")
    return 0
