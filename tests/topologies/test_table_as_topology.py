"""A table of edges that is given as a topology: whatever is wrong with it as YAML, the cure is `import`."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, TopologyError
from hedgerow.topologies.load import load


@pytest.mark.parametrize(
    "text",
    ["a,b\n1,2\n", "law,mean\nminimax: x: y,1\n", "a\tb\n1\t2\n", "[1,2\n"],
    ids=["plain", "colons", "tabs", "open"],
)
def test_a_table_is_imported(tmp_path: Path, text: str) -> None:
    file = tmp_path / "edges.csv"
    file.write_text(text)
    with pytest.raises(TopologyError) as refused:
        load(str(file))
    (problem,) = refused.value.problems
    assert problem.code == Code.FILE_FORMAT
    assert "orchestrator import" in problem.cure
