"""Samples of disturbances in CSV files beside the topology."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from hedgerow.topologies import rules
from hedgerow.topologies.errors import Code
from hedgerow.topologies.header import Header
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.samples import columns
from tests.tools.topology_texts import HEAD, good, only, problems

TABLE = "nodes: [a, b]\ndefaults: {disturbance: {kind: samples, file: w.csv}}\n"


@pytest.mark.parametrize(
    ("content", "at"),
    [
        (None, "w.csv:"),
        ("", "w.csv:"),
        ("1,2,3\n" * 3, "w.csv:1:"),
        ("1,2\n1\n1,2\n", "w.csv:2:"),
        ("1,2\n1,x\n1,2\n", "w.csv:2:"),
        ("1,2\n1,nan\n1,2\n", "w.csv:2:"),
        ("1,2\n1,-1e101\n1,2\n", "w.csv:2:"),
        ("1,2\n1,2\n", ""),
        ("a,b\n1,2\n1,2\n", ""),
        ("a\n1\n1\n1\n", "w.csv"),
        ("a,c\n1,2\n1,2\n1,2\n", "w.csv:1:"),
        ("1,\0\n" * 3, "w.csv:1:"),
    ],
)
def test_a_table_of_samples_can_be_wrong(content: str | None, at: str, tmp_path: Path) -> None:
    """Missing, ragged, short or no numbers; the line is that of the disturbance in the topology."""
    if content is not None:
        (tmp_path / "w.csv").write_text(content)
    problem = only(HEAD + TABLE, folder=tmp_path)
    assert (problem.line, problem.place) == (5, "defaults: disturbance")
    assert problem.what.startswith(at)


@pytest.mark.parametrize("file", ["../w.csv", "/etc/hostname", "inside/../../w.csv"])
def test_a_table_is_beside_the_topology(file: str, tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text("1,2\n" * 3)
    (tmp_path / "own").mkdir()
    problem = only(HEAD + TABLE.replace("w.csv", file), folder=tmp_path / "own")
    assert (problem.place, problem.code) == ("defaults: disturbance", Code.FILE_FORMAT)


def test_a_link_out_of_the_folder_is_outside_it(tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text("1,2\n" * 3)
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "w.csv").symlink_to(tmp_path / "w.csv")
    assert only(HEAD + TABLE, folder=tmp_path / "own").place == "defaults: disturbance"


@pytest.mark.parametrize(
    ("table", "of_a"),
    [("1,2\n3,4\n5,6\n", (1.0, 3.0, 5.0)), ("b,a\n1,2\n3,4\n5,6\n7,8\n", (2.0, 4.0, 6.0))],
    ids=["without a header: in node order", "a header names the columns"],
)
def test_a_table_gives_each_node_its_column(table: str, of_a: tuple[float, ...], tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text(table)
    topology = resolve(good(HEAD + TABLE, folder=tmp_path), tmp_path)
    disturbance = topology.nodes["a"].disturbance
    assert disturbance is not None
    assert getattr(disturbance, "values", None) == of_a


def test_a_table_that_each_node_names_is_read_once_to_be_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table is as wide as the network: to read it for each node would be work of the third order."""
    reads = []

    def counted(
        file: str, folder: Path, ids: Sequence[int | str], header: Header | None, *more: Any
    ) -> dict[int | str, list[float]]:
        reads.append(file)
        return columns(file, folder, ids, header, *more)

    monkeypatch.setattr(rules, "columns", counted)
    nodes = "".join(f"  {k}: {{disturbance: {{kind: samples, file: w.csv}}}}\n" for k in range(5))
    (tmp_path / "w.csv").write_text("1.5,2,3,4,5\n" * 3)
    assert len(good(f"{HEAD}nodes:\n{nodes}", folder=tmp_path).ids) == 5
    assert len(reads) == 1
    (tmp_path / "w.csv").write_text("1.5,2,3,4,x\n" * 3)
    assert {problem.place for problem in problems(f"{HEAD}nodes:\n{nodes}", folder=tmp_path)} == {
        f"node {k}: disturbance" for k in range(5)
    }
    assert len(reads) == 2


def test_quoted_ids_cost_about_the_same_as_bare_ones() -> None:
    """Every id of a JSON file is quoted; each was looked for among all lines, which took 30 times as long here."""

    def cost_s(quote: str) -> float:
        nodes = ", ".join(f"{quote}{k}{quote}: {{x0: 1}}" for k in range(4000))
        began = time.process_time()
        assert good(f"{HEAD}nodes: {{{nodes}}}\n").ids[-1] == 3999
        return time.process_time() - began

    assert cost_s('"') < 8 * cost_s("")
