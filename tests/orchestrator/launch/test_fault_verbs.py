"""The kinds of faults: one method and one command per model."""

from __future__ import annotations

import typer

from hedgerow.orchestrator.cli.live import faults
from hedgerow.orchestrator.launch.fault_verbs import VERBS
from hedgerow.topologies.faults import KINDS


def test_every_kind_has_a_method_and_a_command() -> None:
    assert set(VERBS) == set(KINDS)
    commands = typer.main.get_command(faults)
    assert set(commands.commands) == {*KINDS, "list", "heal"}  # type: ignore[attr-defined]
