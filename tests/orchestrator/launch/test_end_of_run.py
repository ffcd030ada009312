"""Faults that end exactly with the run: nothing is awaited for a step that does not come."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.tools.processes import orchestrator

UP = ("--viewer", "none", "--no-record", "--verify")


def verdict() -> dict[str, Any]:
    return dict(json.loads(Path("runs/latest/verdict.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    "faults",
    [
        "{kind: crash, node: 3, at: 29, restart_after: 1}",
        "{kind: crash, node: 3, at: 28, restart_after: 2}",
        "{kind: crash, node: 3, at: 29}",
        "{kind: crash, node: 3, at: 28, restart_after: 1}",
        "{kind: crash, node: 3, at: 0, restart_after: 30}",
        "{kind: drop, link: [2, 4], steps: [29, 30]}, {kind: crash, node: 4, at: 29, restart_after: 1}",
    ],
)
def test_a_fault_that_ends_with_the_run_is_valid_and_equal_to_the_reference(here: Path, faults: str) -> None:
    done = orchestrator("up", "paper7", *UP, "--set", f"faults=[{faults}]")
    assert done.returncode == 0, done.stdout + done.stderr
    assert verdict()["steps_done"] == 30
    assert verdict()["checks"]["reference"]["ok"]
