"""A part of the table of docs/reliability.md, tried anew each time: every process, signal and time occurs in it."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.kill_table import BEGIN, CELLS, DOCUMENT, END, WHAT, WHEN, WHO, Cell, run_cell, wrong

TRIED = [
    Cell("agent", signal.SIGKILL, "start"),
    Cell("agent", signal.SIGTERM, "middle"),
    Cell("agent", signal.SIGSTOP, "end"),
    Cell("plant", signal.SIGINT, "middle"),
    Cell("plant", signal.SIGKILL, "end"),
    Cell("nursery", signal.SIGKILL, "middle"),
    Cell("up", signal.SIGKILL, "start"),
    Cell("up", signal.SIGTERM, "end"),
    Cell("viewer", signal.SIGTERM, "start"),
    Cell("viewer", signal.SIGKILL, "middle"),
    Cell("router", signal.SIGSTOP, "middle"),
]
"""About a minute."""


def test_the_part_has_something_of_everything() -> None:
    assert {cell.who for cell in TRIED} == set(WHO)
    assert {cell.what for cell in TRIED} == set(WHAT)
    assert {cell.when for cell in TRIED} == set(WHEN)


@pytest.mark.slow
@pytest.mark.parametrize("cell", TRIED, ids=str)
def test_whoever_is_killed_leaves_nothing_but_what_was_recorded(cell: Cell, tmp_path: Path) -> None:
    outcome = run_cell(cell, tmp_path)
    assert not wrong(cell, outcome), outcome


def test_the_table_of_the_docs_is_clean() -> None:
    rows = DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0].splitlines()[2:]
    assert 0 < len(rows) <= len(CELLS)
    assert all(row.endswith("| nothing |") for row in rows)
