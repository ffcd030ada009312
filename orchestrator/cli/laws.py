"""The command that lists the laws of the project."""

from __future__ import annotations

import dataclasses
import inspect
import json
from typing import Any

import typer

from hedgerow.orchestrator.cli.names import INSPECT
from hedgerow.orchestrator.cli.options import AsJson
from hedgerow.topologies.escape import echo


def register(app: typer.Typer) -> None:
    """Add this command to the operator's."""
    app.command(rich_help_panel=INSPECT)(laws)


def laws(as_json: AsJson = False) -> int:
    """List the laws of the project: name, equation, and parameters with their defaults."""
    from hedgerow.agents.laws import LAWS, law_of_name  # noqa: PLC0415
    from hedgerow.agents.loading import declared  # noqa: PLC0415

    rows = []
    for name in LAWS:
        law: Any = law_of_name(name)
        parameters = {
            key: None if value is dataclasses.MISSING else value
            for key, value in (declared(law).items() if name not in ("hinf", "nominal") else ())
        }
        about = inspect.getdoc(inspect.getmodule(law)) or ""
        rows.append({"name": name, "equation": law.equation, "parameters": parameters, "about": about})
    if as_json:
        echo(json.dumps(rows))
        return 0
    spelled = [
        row["name"]
        + (f"({', '.join(f'{key}={value}' for key, value in row['parameters'].items())})" if row["parameters"] else "")
        for row in rows
    ]
    width = max(map(len, spelled)) + 2
    for call, row in zip(spelled, rows, strict=True):
        echo(f"{call.ljust(width)}{row['equation']}")
    return 0
