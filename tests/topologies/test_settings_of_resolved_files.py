"""An option that contradicts a resolved file is the user's mistake: no run begins, and none is called INVALID."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hedgerow.topologies.errors import Exit, TopologyError
from hedgerow.topologies.load import load
from hedgerow.topologies.nodes import SPELLED_OUT
from hedgerow.topologies.resolve import resolve, save
from tests.tools.processes import orchestrator

STEPS = 4
FAULT = "faults: [{kind: crash, process: 1, at: 2}]"


def written(n: int, more: str = "") -> str:
    samples = [0.1] * STEPS
    return (
        f"{{name: r, b: 0.1, steps: {STEPS}, seed: 3, graph: {{kind: ring, nodes: {n}}}, processes: 2, {FAULT},"
        f" defaults: {{disturbance: {{kind: samples, values: {samples}}}{more}}}}}"
    )


@pytest.fixture(scope="module", params=[80, SPELLED_OUT + 1], ids=["nodes in the file", "nodes in a table"])
def resolved(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("resolved")
    (folder / "network.yaml").write_text(written(request.param))
    (folder / "run").mkdir()
    save(resolve(load(str(folder / "network.yaml"))), folder / "run/topology.yaml")
    return folder / "run/topology.yaml"


@pytest.mark.parametrize(
    "setting",
    [
        "steps=4000",
        "steps=5",
        "b=0.9",
        "b=0.17",
        "defaults.b=0.9",
        "processes=3",
        "layout=[0, 1]",
        "nodes.7.a=0.2",
        "nodes.7.b=0.9",
        "nodes.7.candidates=[0.2]",
        "nodes.7.nominal=7",
        "nodes.7.disturbance={kind: samples, values: [1, 2]}",
        "nodes={99999: {}}",
        "faults=[{kind: jump, node: 7, at: 1, a: 0.2}]",
        "faults=[{kind: cut, edge: [1, 9], at: 1}]",
        "faults=[{kind: crash, process: 5, at: 1}]",
        "record={nodes: [99999]}",
        "disturbance=worst_case",
        "defaults.x0=5",
        "defaults.a=0.5",
        "defaults={candidates: {random: 3}}",
        "defaults.disturbance={kind: white, std: 1}",
        "graph={kind: ring, nodes: 9}",
    ],
)
def test_an_option_that_contradicts_the_file_is_refused_and_named(resolved: Path, setting: str) -> None:
    with pytest.raises(TopologyError) as refused:
        load(str(resolved), [setting])
    for problem in refused.value.problems:
        assert problem.origin == f"--set {setting}", problem
        assert problem.cure


@pytest.mark.parametrize(
    "setting", ["steps=2", "b=0.09", "law=hinf", "seed=9", "history=1", "nodes.7.x0=3", "nodes.7.label=seven"]
)
def test_an_option_that_fits_the_file_changes_it(resolved: Path, setting: str) -> None:
    before, after = resolve(load(str(resolved))), resolve(load(str(resolved), [setting]))
    assert before != after
    assert len(before.ids) == len(after.ids)


def test_another_number_of_processes_needs_another_layout(resolved: Path) -> None:
    settings = ["processes=3", "layout=null"]
    assert resolve(load(str(resolved), settings)).process_count == 3


def test_a_command_says_so_before_a_run_begins(here: Path, resolved: Path) -> None:
    for command in ("simulate", "check"):
        done = orchestrator(command, str(resolved), "--set", "steps=4000")
        assert done.returncode == Exit.USER_MISTAKE
        assert not (here / "runs").exists()


def test_defaults_beside_a_table_are_checked_at_every_node(tmp_path: Path) -> None:
    np.savez(tmp_path / "t.npz", edges=[[0, 1], [1, 2]], a=[0.4, 0.5, 0.6])
    head = "{name: t, b: 0.1, steps: 4, table: t.npz, defaults: {candidates: "
    (tmp_path / "good.yaml").write_text(head + "[0.4, 0.5, 0.6]}}")
    (tmp_path / "wrong.yaml").write_text(head + "[0.4, 0.5]}}")
    assert resolve(load(str(tmp_path / "good.yaml"))).network.a.tolist() == [0.4, 0.5, 0.6]
    with pytest.raises(TopologyError):
        load(str(tmp_path / "wrong.yaml"))


def test_a_gain_in_the_defaults_holds_beside_a_complete_table(tmp_path: Path) -> None:
    arrays: dict[str, Any] = {
        "a": [0.5, 0.5],
        "x0": [1, 1],
        "nominal": [0.5, 0.5],
        "candidates": [[0.5], [0.5]],
        "parts": [0, 0],
    }
    np.savez(tmp_path / "t.npz", edges=[[0, 1]], **arrays)
    (tmp_path / "t.yaml").write_text("{name: t, b: 0.1, steps: 4, table: t.npz, defaults: {b: 0.2}}")
    assert resolve(load(str(tmp_path / "t.yaml"))).network.b == 0.2
