"""The command that lists and removes run folders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import INSPECT
from hedgerow.orchestrator.cli.options import AsJson
from hedgerow.topologies.escape import echo, escape
from hedgerow.topologies.paths import user_path

Directory = Annotated[Path, typer.Argument(metavar="DIR", parser=user_path, help="the folder that holds the runs")]
Keep = Annotated[
    int | None, typer.Option("--keep", metavar="N", min=0, help="remove all runs except the newest N and running ones")
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="with --keep: print what would be removed, and remove nothing")]


def register(app: typer.Typer) -> None:
    """Add this command to the operator's."""
    app.command(rich_help_panel=INSPECT)(runs)


def runs(
    directory: Directory = Path("runs"), keep: Keep = None, dry_run: DryRun = False, as_json: AsJson = False
) -> int:
    """List the run folders of a directory with their verdicts, newest first; with --keep, remove the older ones."""
    from hedgerow.orchestrator.runs import listing, registry  # noqa: PLC0415

    found = listing.listed(directory, {entry.folder for entry in registry.running() if not entry.is_over})
    removed = [] if keep is None else listing.removable(found, keep)
    stays = [] if dry_run else listing.remove(removed, directory)
    for line in stays:
        echo(line, error=True)
    shown = found if keep is None else removed
    if as_json:
        echo(json.dumps([vars(one) | {"folder": str(one.folder)} for one in shown]))
        return 0
    for one in shown:
        steps = "" if one.steps is None else f"{one.steps_done} of {one.steps} steps"
        regret = "" if one.regret is None else f"regret D {one.regret:.4g}"
        words = (one.verdict, escape(one.run), listing.since(one), steps, escape(one.law), regret, _size(one.size))
        echo("  ".join(word for word in words if word))
    if keep is not None:
        echo(f"{len(removed)} of {len(found)} runs {'would be ' if dry_run else ''}removed")
    elif not found:
        echo(f"{directory}: no runs")
    return 0


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 100_000 else f"{size / 1e3:.1f} kB"
