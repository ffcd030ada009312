"""The final figures: ratios are medians within a round, and a page keeps its text around the tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.final import AIMS, BEGIN, END, put_into, table

RESULT: dict[str, Any] = {
    "date": "2026-11-28",
    "commit": "abc",
    "machine": "x86_64",
    "cores": 2,
    "kernel": "6",
    "python": "3.11",
    "versions": "eclipse-zenoh 1.10.2",
    "pss_mb": 9.04,
    "rss_mb": 40.0,
    "cpu_us": [{"`up`": 100.0, "all": 900.0}, {"`up`": 120.0, "all": 1000.0}],
    "rounds": [
        {"ours 7": {"steps_per_s": ours, "first_step_s": 0.5}, "zenoh 7": {"steps_per_s": 100.0, "first_step_s": 0.4}}
        for ours in (80.0, 95.0, 110.0)
    ]
    + [{"ours 7": {"steps_per_s": 1.0}}],
}


def test_a_ratio_is_the_median_of_the_rounds_that_have_both_runs() -> None:
    lines = table(RESULT).splitlines()
    assert f"| {AIMS[0].title} | 0.95 | 0.80 to 1.10 | 0.9 | reaches it | 2 of 3 |" in lines
    assert f"| {AIMS[1].title} | none |  | 0.9 |  | 0 of 0 |" in lines
    assert "| all | 950 | 900 to 1000 |" in lines


def test_a_page_keeps_the_text_around_its_tables(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    for text in ("one", "two"):
        put_into(page, text)
        assert page.read_text() == f"before\n{BEGIN}\n\n{text}\n\n{END}\nafter\n"
    page.write_text("no marks")
    with pytest.raises(SystemExit):
        put_into(page, "three")


def test_the_page_of_the_project_has_the_marks() -> None:
    whole = (Path(__file__).parents[1] / "docs/performance.md").read_text(encoding="utf-8")
    assert whole.index(BEGIN) < whole.index(END)
