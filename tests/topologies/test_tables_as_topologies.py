"""A table of edges where a topology belongs is refused with the command that makes a topology of it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, TopologyError
from hedgerow.topologies.load import load
from hedgerow.topologies.mistaken import TABLES
from tests.tools.processes import run_here


@pytest.mark.parametrize("ending", sorted(TABLES - {".adj"}))  # of a matrix or of adjacency lists
def test_the_named_command_makes_a_topology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    monkeypatch.chdir(tmp_path)
    table = tmp_path / f"my edges{ending}"
    table.write_text("from,to,weight\nA,B,2.0\nB,C,0.5\n")
    with pytest.raises(TopologyError) as refused:
        load(str(table))
    (problem,) = refused.value.problems
    assert problem.code == Code.FILE_FORMAT
    (command,) = re.findall(r"`orchestrator (.*?)`", problem.cure)
    assert run_here(*shlex.split(command), "--name", "made").returncode == 0
    assert len(load("made.yaml").ids) == 3
