"""The commands that bound the gain of the adaptive law from above and from below."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from hedgerow.orchestrator.cli.names import EXPERIMENT
from hedgerow.orchestrator.cli.options import AsJson, File, Sets
from hedgerow.topologies.escape import echo

Full = Annotated[bool, typer.Option("--full", help="a full storage matrix P, for networks of up to 30 nodes")]


def register(app: typer.Typer) -> None:
    """Add these commands to the operator's."""
    app.command(rich_help_panel=EXPERIMENT)(bound)


def bound(file: File, full: Full = False, sets: Sets = None, as_json: AsJson = False) -> int:
    """Compute upper bounds on the gain of the adaptive law that hold under faults, each with a certificate."""
    from hedgerow.orchestrator.cli.topology import read  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.bounds import bound as bounds_of  # noqa: PLC0415

    found = bounds_of(read(file, sets), full=full)
    echo(json.dumps(found.to_dict()) if as_json else found.text())
    return 0
