"""The seeds under which a law fails: a sweep and a comparison name all of them."""

from __future__ import annotations

import re
from pathlib import Path

from hedgerow.orchestrator.experiments.sweep import failures
from hedgerow.orchestrator.experiments.sweep.plan import plan
from tests.orchestrator.experiments.test_sweep import rows
from tests.tools.processes import orchestrator

SOME = """
from hedgerow.agents.law import Minimax

class Some(Minimax):
    "Fails at step 20 if the mean state is positive there."
    def learn(self, x, flow, x_next, sample):
        if sample.t == 20 and x.mean() > 0:
            raise RuntimeError(f"the mean is {x.mean()!r}")
"""


def seeds_of(line: str) -> list[int]:
    found = re.search("seeds? ([0-9, ]+) ", line)
    assert found
    return [int(seed) for seed in found[1].split(", ")]


def test_a_sweep_names_every_seed_under_which_the_law_fails(here: Path) -> None:
    (here / "some.py").write_text(SOME, encoding="utf-8")
    swept = orchestrator("sweep", "paper7", "--seeds", "0:8", "--set", "law=minimax,some:Some", "--out", "out")
    failed = [row["seed"] for row in rows(here / "out") if row["verdict"] != "valid"]
    assert 1 < len(failed) < 8
    (line,) = (one for one in swept.stdout.splitlines() if one.startswith("unknown: "))
    assert seeds_of(line) == failed
    assert "some:Some" in line


def test_a_comparison_names_every_seed_under_which_the_law_fails(here: Path) -> None:
    (here / "some.py").write_text(SOME, encoding="utf-8")
    compared = orchestrator("compare", "paper7", "--seeds", "0:8", "--law", "some:Some", "--out", "out")
    (line,) = (one for one in compared.stdout.splitlines() if one.startswith("unknown: "))
    assert len(seeds_of(line)) > 1
    assert compared.returncode == 3


def test_many_failures_are_few_lines() -> None:
    many = plan("paper7", "0:30", ["b=" + ",".join(str(0.05 + 0.001 * k) for k in range(30))], "in-process")
    row = {"verdict": "INVALID", "reasons": "r"}
    lines = failures.lines(many, [[{**row, "seed": seed, "setting": k} for seed in range(30)] for k in range(30)])
    assert len(lines) == failures.MAX_LINES + 1
    assert max(map(len, lines)) < 200
