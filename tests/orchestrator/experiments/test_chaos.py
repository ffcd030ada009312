"""Random networks under random faults over Zenoh, and how a finding is made small."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hedgerow.orchestrator.experiments.chaos import Finding, Raw, drawn, hunt, read, shrunk, write
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.processes import orchestrator

NETWORKS = int(os.environ.get("HEDGEROW_CHAOS_NETWORKS", "60"))


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(first, first + 20) for first in range(0, NETWORKS, 20)], ids=str)
def test_every_drawn_network_runs_to_its_end_and_equals_the_reference(seeds: range, here: Path) -> None:
    """There is no hang, no lost row and no remaining process; every check holds, and the reference is equal bit for
    bit.
    """
    messages: list[str] = []
    most = 12 if seeds.start == 0 else 8  # processes cost most of the time
    finding = hunt(seeds, most, here, messages.append)
    assert finding is None, messages[-2:]
    assert len(messages) == len(seeds)


def test_a_trial_is_a_function_of_its_seed() -> None:
    assert drawn(7) == drawn(7)
    assert drawn(7) != drawn(8)
    for seed in range(200):
        read(drawn(seed))  # a topology without mistakes


def has_crash_and_drop(raw: Raw) -> str:
    read(raw)
    kinds = {fault["kind"] for fault in raw["faults"]}
    return "a crash and a drop" if {"crash", "drop"} <= kinds else ""


def test_a_finding_is_reduced_as_far_as_possible(tmp_path: Path) -> None:
    """If any crash with any drop is a mistake, the reduced network has one of each, on two nodes."""
    seed = next(seed for seed in range(200) if len(drawn(seed)["nodes"]) > 6 and has_crash_and_drop(drawn(seed)))
    raw, wrong = shrunk(drawn(seed), "?", has_crash_and_drop)
    assert wrong == "a crash and a drop"
    assert sorted(fault["kind"] for fault in raw["faults"]) == ["crash", "drop"]
    assert len(raw["nodes"]) <= 3
    assert raw["steps"] == 1
    file = tmp_path / "found.yaml"
    write(Finding(seed, wrong, read(raw)), file)
    assert file.read_text().startswith(f"# seed {seed}: a crash and a drop\n")
    assert resolve(load(str(file))) == read(raw)


def test_the_command_prints_each_trial(here: Path) -> None:
    done = orchestrator("chaos", "--seed", "7", "--nodes", "4")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("seed 7: ")
    assert done.stdout.endswith("fine\n")
    assert list(here.glob("chaos-*")) == []
