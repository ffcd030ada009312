"""`--set path=value`: the path finds a key with points in it, and quotes mark the end of a key."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.topologies.errors import UserError
from hedgerow.topologies.load import parse
from hedgerow.topologies.override import split_setting, steps_of
from hedgerow.topologies.schema import Topology

NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,12}", fullmatch=True)


def network(ids: list[str], *sets: str) -> Topology:
    nodes = ", ".join(f'"{name}": {{}}' for name in ids)
    edge = ", ".join(f'"{name}"' for name in ids[:2])
    text = f"name: n\nb: 0.1\nsteps: 3\nnodes: {{{nodes}}}\nedges: [[{edge}]]\n"
    return parse(text.encode(), "n", Path(), sets)


@pytest.mark.parametrize("path", ["nodes.J-1.2.x0", 'nodes."J-1.2".x0', "nodes.'J-1.2'.x0"])
def test_a_node_with_points_in_its_id(path: str) -> None:
    found = network(["J-1.2", "J-1"], f"{path}=4")
    assert found.nodes["J-1.2"].x0 == 4
    assert found.nodes["J-1"].x0 != 4


def test_the_longest_id_that_exists_is_meant_and_quotes_mean_the_shorter() -> None:
    ids = ["J", "J.x0", "J.1"]
    assert network(ids, "nodes.J.1.x0=4").nodes["J.1"].x0 == 4
    assert network(ids, "nodes.J.x0.x0=4").nodes["J.x0"].x0 == 4
    assert network(ids, 'nodes."J".x0=4').nodes["J"].x0 == 4


@pytest.mark.parametrize(
    "path", ["nodes.J-1.3.x0", 'nodes."J-1".2.x0', 'nodes."J-1.2.x0', 'nodes."J-1.2"x.x0', "", "."]
)
def test_a_path_that_leads_nowhere_is_refused(path: str) -> None:
    with pytest.raises(UserError):
        network(["J-1.2", "q"], f"{path}=4")


@given(st.lists(NAMES.filter(lambda name: not name.isdecimal()), min_size=2, max_size=5, unique=True))
def test_quotes_reach_every_node(ids: list[str]) -> None:
    found = network(ids, *(f'nodes."{name}".x0={k + 2}' for k, name in enumerate(ids)))
    assert [found.nodes[name].x0 for name in ids] == [k + 2 for k in range(len(ids))]


@given(st.lists(st.text(st.characters(exclude_characters='"')), min_size=1), st.text())
def test_quoted_words_come_back(words: list[str], value: str) -> None:
    path = ".".join(f'"{word}"' for word in words)
    assert split_setting(f"{path}={value}") == (path, value)
    assert [step.text for step in steps_of(path)] == words


@given(st.text(), st.text())
def test_any_text_is_split_and_put_together(path: str, value: str) -> None:
    found, rest = split_setting(f"{path}={value}")
    assert not found or f"{found}={rest}" == f"{path}={value}"
    assert steps_of(path)
