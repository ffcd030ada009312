"""A name that is a little wrong: the message offers the file or the module that the user has."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.load import find
from tests.tools.processes import run_here

PAIR = "{name: pair, b: 0.1, steps: 6, seed: 3, nodes: [p, q], edges: [[p, q]]}"


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        *(("mine.yml", "mine.yaml"), ("mine", "mine.yaml"), ("mime.yaml", "mine.yaml"), ("pappr7", "paper7")),
        *(("sub/other", "sub/other.yml"), ("sub/othr.yml", "sub/other.yml"), ("sub/other.yaml", "sub/other.yml")),
    ],
)
def test_a_missing_file_has_a_neighbour_of_a_like_name(here: Path, wrong: str, meant: str) -> None:
    (here / "sub").mkdir()
    for file in ("mine.yaml", "sub/other.yml", ".mine.yml", "sub/notes.txt"):
        (here / file).write_text(PAIR)
    with pytest.raises(UserError) as refused:
        find(wrong)
    assert refused.value.code == Code.FILE_MISSING
    assert f" {meant}?" in str(refused.value)


@pytest.mark.parametrize("wrong", ["nothing", "no/folder/x.yaml", "mine.yaml/x", "\udce9", "/proc/1/x"])
def test_a_name_that_is_like_no_other_has_no_neighbour(here: Path, wrong: str) -> None:
    (here / "mine.yaml").write_text(PAIR)
    with pytest.raises(UserError) as refused:
        find(wrong)
    assert refused.value.code in (Code.FILE_MISSING, Code.FILE_UNREADABLE)
    assert "?" not in str(refused.value)


def test_a_law_of_a_module_with_a_like_name_is_offered(here: Path) -> None:
    (here / "sticky.py").write_text("from hedgerow.agents.law import Minimax as Sticky\n")
    (here / "pair.yaml").write_text(PAIR)
    done = run_here("check", "pair.yaml", "--import-law", "--law", "stickee:Sticky")
    assert done.returncode == 2
    assert " sticky:Sticky?" in done.stderr
