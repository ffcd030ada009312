"""Mistakes of people who know other tools: each message gives a fix that works, at the place of the mistake."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, FileRefusedError, TopologyError, UserError
from hedgerow.topologies.foreign import not_text
from hedgerow.topologies.importing.files import read as read_graph
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.json_file import loads
from hedgerow.topologies.load import parse
from hedgerow.topologies.paths import real_path
from hedgerow.topologies.samples import beside, columns, number

HEAD = "name: n\nb: 0.1\nsteps: 3\nnodes: [1, 2]\nedges: [[1, 2]]\n"


def refused(text: str | bytes) -> TopologyError:
    text = text.encode() if isinstance(text, str) else text
    with pytest.raises(TopologyError) as caught:
        parse(text, "bad.yaml", Path())
    return caught.value


@pytest.mark.parametrize(
    ("written", "steps"),
    [
        ("1,000", 1000),
        ("1,000,000", 1_000_000),
        ("1'000", 1000),
        ("1 000", 1000),
        ("0x10", 16),
        ("１２", 12),
        ("300%", 3),
        ("4/2", 2),
        ("30 steps", 30),
        ("7.0", 7),
    ],
)
def test_the_fix_of_a_whole_number_is_that_number(written: str, steps: int) -> None:
    (problem,) = refused(HEAD.replace("steps: 3", f"steps: {written}")).problems
    fix = re.search(r"\d+$", problem.cure)
    assert fix is not None
    assert parse(HEAD.replace("steps: 3", f"steps: {fix[0]}").encode(), "good.yaml", Path()).steps == steps


@pytest.mark.parametrize(
    ("body", "column", "fix"),
    [
        ("defaults: {candidates: 0.5}", 24, "[0.5]"),
        ("defaults: {disturbance: white}", 25, "{kind: white, std: …}"),
        ("defaults: {disturbance: {kind: wite, std: 1}}", 32, "`white`"),
        ("defaults: {disturbance: {kind: sinusoid, amplitude: 1, omega: 1, angle: 1}}", 66, "known keys"),
        ("defaults: {disturbance: {kind: white, sigma: 1}}", 39, "`std:`"),
        ("faults: [{kind: cut, link: [1, 2]}]", 22, "`edge:`"),
        ("faults: [{kind: jump, node: 1, at: 1, to: 0.5}]", 39, "`a:`"),
        ("faults: [{kind: drop, link: 1}]", 29, "[1, 2]"),
        ("faults: [{kind: sensor, node: [1, 2]}]", 31, "one id"),
        ("secure: yes", 9, "write true"),
        ("backfill: off", 11, "write false"),
    ],
)
def test_the_fix_is_in_the_words_of_the_file(body: str, column: int, fix: str) -> None:
    problems = [one for one in refused(f"{HEAD}{body}\n").problems if one.column == column]
    assert any(fix in one.cure for one in problems)
    assert {one.line for one in problems} == {6}


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [
        (HEAD.replace("[[1, 2]]", "[[1, 2]"), 5, 8),
        (HEAD + "faults: [{kind: drop, link: [1, 2]\n", 6, 10),
        (HEAD.replace("name: n", "name: 'n"), 1, 7),
        (HEAD + 'law: "minimax\n\n', 6, 6),
    ],
)
def test_what_is_not_closed_is_shown_where_it_opens(text: str, line: int, column: int) -> None:
    (problem,) = refused(text).problems
    assert (problem.line, problem.column, problem.code) == (line, column, Code.FILE_FORMAT)


FOREIGN = {
    "zip": b"PK\x03\x04rest",
    "gzip": b"\x1f\x8b\x08rest",
    "npy": b"\x93NUMPY\x01\x00",
    "png": b"\x89PNG\r\n\x1a\n\x00",
    "utf-16": HEAD.encode("utf-16"),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_a_file_of_another_kind_is_named_by_its_kind(kind: str, tmp_path: Path) -> None:
    (problem,) = refused(FOREIGN[kind]).problems
    assert not_text(FOREIGN[kind]) == problem.what
    (tmp_path / "w.csv").write_bytes(FOREIGN[kind])
    with pytest.raises(FileRefusedError) as caught:
        columns("w.csv", tmp_path, [1, 2])
    assert not_text(FOREIGN[kind]) in caught.value.what
    with pytest.raises(UserError, match=re.escape(not_text(FOREIGN[kind]))):
        read_graph(tmp_path / "w.csv", Options())


@pytest.mark.parametrize("cell", ["1_0", "１２", "٣", "0x1p3", "infinity", "nan", "1,5", "", " "])
def test_a_cell_that_others_read_as_another_number_is_none(cell: str) -> None:
    assert number(cell) != number(cell)


@pytest.mark.parametrize("cell", ["1", " -2.5 ", "+.5", "1e3", "1.", "007"])
def test_a_cell_that_all_read_alike_is_a_number(cell: str) -> None:
    assert number(cell) == float(cell)


@pytest.mark.parametrize(
    "text", ['{"a": 1, "a": 2}', '[{"b": {"c": 1, "c": 1}}]', '{"a": NaN}', "[-Infinity]", "9" * 5000, "[" * 100_000]
)
def test_json_with_two_readings_or_none_is_refused_in_our_words(text: str) -> None:
    with pytest.raises(UserError) as caught:
        loads("here", text.encode())
    assert caught.value.code == Code.FILE_FORMAT
    assert "Python" not in str(caught.value)
    assert "sys." not in str(caught.value)


def _circle(path: Path) -> None:
    path.symlink_to(path.name)


def _folder(path: Path) -> None:
    path.mkdir()


@pytest.mark.parametrize("make", [_circle, _folder])
def test_a_file_of_samples_that_is_no_file_is_a_mistake_of_the_user(
    make: Callable[[Path], None], tmp_path: Path
) -> None:
    make(tmp_path / "w.csv")
    with pytest.raises(FileRefusedError) as caught:
        beside(tmp_path, "w.csv")
    assert caught.value.code in (Code.FILE_UNREADABLE, Code.FILE_NOT_REGULAR)


def test_links_in_a_circle_are_a_mistake_of_the_user(tmp_path: Path) -> None:
    _circle(tmp_path / "a")
    with pytest.raises((UserError, OSError)):
        real_path(tmp_path / "a").open()


@pytest.mark.parametrize("ending", [".dot", ".npy", ".xlsx", ".pickle", ".gz"])
def test_a_kind_of_graph_without_a_reader_leads_to_one_with_a_reader(ending: str, tmp_path: Path) -> None:
    file = tmp_path / f"graph{ending}"
    file.write_text("x")
    with pytest.raises(UserError) as caught:
        read_graph(file, Options())
    assert caught.value.code == Code.OPTION
