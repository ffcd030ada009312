"""The commands that show running and finished runs in a viewer."""

from __future__ import annotations

from typing import Annotated

import typer

from hedgerow.orchestrator.cli import complete
from hedgerow.orchestrator.cli.names import INSPECT, WATCH
from hedgerow.orchestrator.cli.options import Running, RunOption, chosen
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.escape import command, echo

Runs = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="RUN",
        help="a run folder, or its name in runs/; several are drawn on the same axes [the latest]",
        autocompletion=complete.runs,
    ),
]
Viewer = Annotated[str, typer.Option(metavar="native|web|URL", help="where to show it [native, if there is a display]")]


def register(app: typer.Typer) -> None:
    """Add these commands to the operator's."""
    app.command(rich_help_panel=WATCH)(watch)
    app.command(name="open", rich_help_panel=INSPECT)(open_)


def watch(run: Running = None, named: RunOption = None, viewer: Viewer = "auto") -> int:
    """Show a running network from its first step and follow it; this costs the run nothing."""
    from hedgerow.orchestrator.runs import registry  # noqa: PLC0415
    from hedgerow.orchestrator.views.rerun.viewer import choose_one  # noqa: PLC0415

    try:
        entry = registry.find(chosen(run, named))
    except UserError as error:
        hint = "`orchestrator open` shows runs that are over, and those of `simulate`"
        raise UserError(f"{error}\n{hint}", code=error.code) from None
    if entry.is_over:
        raise entry.over()
    choice = choose_one(viewer, f"`{command(['orchestrator', 'status', entry.run])}` shows its step")
    from hedgerow.orchestrator.views.rerun.watch import watch as follow  # noqa: PLC0415

    echo(f"{entry.run}: running in {entry.folder}")
    follow(entry, choice, echo)
    return 0


def open_(runs: Runs = None, viewer: Viewer = "auto") -> int:
    """Show finished runs in a viewer; several share the same axes."""
    from hedgerow.orchestrator.runs.files import find_run  # noqa: PLC0415
    from hedgerow.orchestrator.views.rerun.viewer import choose_one  # noqa: PLC0415

    named = runs or ["runs/latest"]
    folders = [find_run(run) for run in named]
    choice = choose_one(viewer, f"or copy {folders[0] / 'run.rrd'} to where there is one, and `rerun run.rrd` there")
    from hedgerow.orchestrator.views.rerun.opening import open_runs  # noqa: PLC0415

    open_runs(named, choice, echo)
    return 0
