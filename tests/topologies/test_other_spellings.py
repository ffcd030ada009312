"""Spellings that another reader understands differently, and messages that name what the user wrote and its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, Problem, TopologyError
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.resolve import resolve, to_yaml

HEAD = "name: n\nb: 0.1\nsteps: 6\nseed: 1\n"
EDGES = "edges: [[p, q]]\n"


def problems(text: str, folder: Path = Path()) -> tuple[Problem, ...]:
    with pytest.raises(TopologyError) as refused:
        parse(text.encode(), "n.yaml", folder)
    return refused.value.problems


@pytest.mark.parametrize(
    ("text", "number"), [("1_000", 1000), ("0x1f", 31), ("0o17", 15), ("0b11", 3), ("1_0_0", 100), ("0X1F", 31)]
)
def test_an_unquoted_id_that_others_read_as_a_number_is_refused(text: str, number: int) -> None:
    for nodes in (f"[{text}, 5]", f"{{{text}: {{x0: 1}}, 5: }}"):
        found = problems(f"{HEAD}nodes: {nodes}\nedges: [[{text}, 5]]\n")
        assert {problem.code for problem in found} == {Code.FILE_AMBIGUOUS}
        assert {problem.line for problem in found} == {5, 6}
        assert all(str(number) in problem.cure and f'"{text}"' in problem.cure for problem in found)
    quoted = parse(f'{HEAD}nodes: ["{text}", 5]\nedges: [["{text}", 5]]\n'.encode(), "n.yaml", Path())
    assert quoted.ids == (text, 5)
    assert parse(to_yaml(resolve(quoted)).encode(), "n.yaml", Path()).ids == (text, 5)


@pytest.mark.parametrize(
    ("body", "line", "shown"),
    [
        ("nodes: [p, q]\nlaw:hinf\n" + EDGES, 6, ""),
        ("nodes: ['1:30', q]\nedges: [['1:30', q]]\n", 5, "1:30"),
        ("nodes: [p, q]\nedges: [p-q]\n", 6, "p-q"),
        ("nodes: [p, q]\nedges: {p: q}\n", 6, "p"),
    ],
)
def test_a_mistake_is_shown_as_written_at_its_line_with_a_cure(body: str, line: int, shown: str) -> None:
    first = problems(HEAD + body)[0]
    assert first.line == line
    assert shown in first.what
    assert "{}" not in first.what
    assert "…" not in first.cure


def test_a_seed_beyond_64_bits_has_a_cure_that_works() -> None:
    (found,) = problems(HEAD.replace("seed: 1", "seed: 1e40") + "nodes: [p, q]\n" + EDGES)
    assert "0000" not in found.cure


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"node 1,node 2\n" + b"0.1,0.2\n" * 6, Code.FILE_FORMAT),
        ("1,2\n0.1,0.2\n".encode("utf-16"), Code.FILE_FORMAT),
    ],
)
def test_the_cause_of_a_wrong_table_is_the_right_one(tmp_path: Path, content: bytes, code: Code) -> None:
    (tmp_path / "w.csv").write_bytes(content)
    samples = "defaults: {disturbance: {kind: samples, file: w.csv}}\n"
    (found,) = problems(f"{HEAD}nodes: [1, 2]\nedges: [[1, 2]]\n{samples}", tmp_path)
    assert found.code == code
    assert "spaces" not in found.what
    assert found.cure


def test_bundled_networks_have_no_such_spelling() -> None:
    for name in ("paper7", "grid16", "line5"):
        load(name)
