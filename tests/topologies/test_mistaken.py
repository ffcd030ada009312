"""A file of another kind in place of a topology: the message names the command that takes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.mistaken import cure_of_law, mistaken

LAW = 'import numpy as np\n\n\nclass Capped:\n    """Cap: the residual."""\n'


@pytest.mark.parametrize(
    ("name", "content", "cure"),
    [
        ("capped.py", LAW, "orchestrator simulate paper7 --law capped:Capped"),
        ("empty.py", "x: int = 3", "orchestrator simulate paper7 --law empty:CLASS"),
        ("data.csv", "disturbance,law\nfile,rls\n", "orchestrator import"),
        ("net.gml", "graph [ node [ id 1 ] ]", "orchestrator import"),
        ("net.inp", "[TITLE]\n", "orchestrator import"),
        ("telemetry.parquet", "PAR1", "orchestrator open"),
        ("run.rrd", "RRF2", "orchestrator open"),
        ("up.log", "a: b: c\n", "paper7"),
    ],
)
def test_the_cure_of_a_file_of_another_kind_is_a_command(tmp_path: Path, name: str, content: str, cure: str) -> None:
    file = tmp_path / name
    file.write_text(content, encoding="utf-8")
    with pytest.raises(TopologyError) as caught:
        load(str(file))
    (problem,) = caught.value.problems
    assert problem.code == Code.FILE_FORMAT
    assert cure in problem.cure


def test_a_topology_with_a_mistake_keeps_its_line_whatever_its_ending(tmp_path: Path) -> None:
    for name in ("net.yaml", "net.conf", "net"):
        file = tmp_path / name
        file.write_text("name: a\nb: 0.1\nx: y: z\n", encoding="utf-8")
        with pytest.raises(TopologyError) as caught:
            load(str(file))
        assert [problem.line for problem in caught.value.problems] == [3]
        assert mistaken(str(file)) is None


@pytest.mark.parametrize(
    "name", ["capped:Capped", "capped.py:Capped", "lab.laws:Capped(decay=0.9)", "dir/capped:Capped"]
)
def test_a_law_in_place_of_a_file_is_named_behind_its_option(name: str) -> None:
    with pytest.raises(UserError) as caught:
        load(name)
    assert caught.value.code == Code.FILE_MISSING
    assert "--law" in cure_of_law(name)
    assert cure_of_law(name) in str(caught.value)


@pytest.mark.parametrize("name", ["paper7", "net.yaml", "runs/latest", "a:b:c", "tcp/host:7447"])
def test_other_names_are_no_laws(name: str) -> None:
    assert not cure_of_law(name)
