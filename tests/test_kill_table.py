"""A part of the table of docs/reliability.md, tried again each time: every process, signal and time occurs in it."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.tools.kill_table import BEGIN, CELLS, DOCUMENT, END, WHAT, WHEN, WHO, Cell, run_cell, wrong

TRIED = [
    Cell("agent", signal.SIGTERM, "middle"),
    Cell("plant", signal.SIGKILL, "start"),
    Cell("plant", signal.SIGINT, "middle"),
    Cell("fork server", signal.SIGKILL, "middle"),
    Cell("fork server", signal.SIGSTOP, "end"),
    Cell("up", signal.SIGKILL, "middle"),
    Cell("up", signal.SIGTERM, "end"),
    Cell("viewer", signal.SIGKILL, "middle"),
    Cell("router", signal.SIGKILL, "start"),
]
"""Below a minute."""


def test_the_part_has_something_of_everything() -> None:
    assert {cell.who for cell in TRIED} == set(WHO)
    assert {cell.what for cell in TRIED} == set(WHAT)
    assert {cell.when for cell in TRIED} == set(WHEN)
    assert {cell.wire for cell in TRIED} == {"socket", "TLS", "TCP"}


@pytest.mark.slow
@pytest.mark.parametrize("cell", TRIED, ids=str)
def test_after_any_kill_only_the_recorded_steps_remain(cell: Cell, tmp_path: Path) -> None:
    outcome = run_cell(cell, tmp_path)
    assert not wrong(cell, outcome), outcome


def test_the_table_of_the_docs_is_complete_and_clean() -> None:
    lines = DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0].splitlines()[2:]
    rows = [tuple(line.strip("| ").split(" | ")) for line in lines]
    assert [row[:4] for row in rows] == [cell.columns for cell in CELLS]
    assert {row[-1] for row in rows} == {"nothing"}
