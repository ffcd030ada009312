"""Any text, and any setting, is a topology or a mistake with a line, and never a traceback."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.topologies.errors import TopologyError, UserError
from hedgerow.topologies.load import bundled, load, parse
from hedgerow.topologies.resolve import resolve, to_yaml
from tests.tools.examples import examples

FAULTY = b"""\
name: faulty
b: 0.1
steps: 20
processes: 2
defaults: {candidates: {random: 3}}
nodes: [1, 2, hub, 4]
edges: [[1, hub], [hub, 2], [4, hub]]
faults:
  - {kind: drop, link: [1, hub], steps: [3, 9], probability: 0.5}
  - {kind: drop, from: hub, to: 2}
  - kind: drop
    at:
      5: [[4, hub], [hub, 1]]
      7: [[2, hub]]
  - {kind: delay, from: hub, to: 4, by: 3}
  - {kind: cut, edge: [2, hub], steps: [0, 5]}
  - {kind: partition, groups: [[1, hub], [2, 4]], cut: true}
  - {kind: sensor, node: 1, steps: [5, 9]}
  - {kind: actuator, node: hub, probability: 0.1}
  - {kind: crash, process: 1, at: 4, restart_after: 5}
  - {kind: jump, node: 4, at: 15, a: random}
"""
GOOD_FILES = [FAULTY, *((resources.files("hedgerow.topologies") / f"{name}.yaml").read_bytes() for name in bundled())]
PIECES = st.one_of(
    st.sampled_from([b"\n", b" ", b"\t", b":", b": ", b"- ", b"[", b"]", b"{", b"}", b"#", b"&a "]),
    st.sampled_from([b"*a", b"!!x ", b"---\n", b"'", b'"', b"-1", b"1e400", b".nan", b"~", b"true"]),
    st.sampled_from([b"random", b"nodes", b"\0", b"\xff", "é".encode(), b"|\n", b"5", b"0.5", b"no"]),
)


@st.composite
def mutated(draw: st.DrawFn) -> bytes:
    """The text of a good file after a few slips of the hand."""
    text = draw(st.sampled_from(GOOD_FILES))
    for _ in range(draw(st.integers(1, 4))):
        if draw(st.booleans()):
            start = draw(st.integers(0, len(text)))
            end = start + draw(st.integers(0, 3))
            text = text[:start] + draw(st.one_of(st.just(b""), PIECES)) + text[end:]
        else:
            lines = text.splitlines(keepends=True) or [b""]
            k = draw(st.integers(0, len(lines) - 1))
            other = draw(st.sampled_from(lines))
            lines[k : k + 1] = draw(st.sampled_from([[], [lines[k], other], [other]]))
            text = b"".join(lines)
    return text


@contextlib.contextmanager
def briefly() -> Iterator[None]:
    """Fail if the block computes for long; the time that other processes take does not count."""
    began = time.process_time()
    try:
        yield
    finally:
        assert time.process_time() - began < 5


@given(mutated())
@settings(max_examples=examples(500))
def test_no_slip_of_the_hand_shows_a_traceback(text: bytes) -> None:
    """A file is refused in words, or it is good all the way to the folder of its run."""
    try:
        with briefly():
            resolved = resolve(parse(text, "slip.yaml", Path()))
    except TopologyError as error:
        found = error.problems
    else:
        assert parse(to_yaml(resolved).encode(), "again.yaml", Path()) == resolved
        return
    last = text.count(b"\n") + 2
    assert found
    assert all(0 <= problem.line <= last and problem.what for problem in found)


STEPS = st.sampled_from(
    [
        *("name", "b", "steps", "seed", "law", "defaults", "nodes", "edges", "disturbance", "faults"),
        *("a", "candidates", "x0", "nominal", "kind", "amplitude", "values", "file", "random"),
        *("0", "1", "2", "-1", "7", "hub", "west", "3", "null", ""),
        *("link", "from", "at", "groups", "cut", "node", "process", "backfill", "history", "processes"),
    ]
)
VALUES = st.one_of(
    st.sampled_from(["", "~", "no", "random", "worst_case", "none", ".nan", "1e400", "-1", "0", "2"]),
    st.sampled_from(["[]", "{}", "[[1, 2]]", "{-1}", "{random: [0, 1]}", "{random: 3}", "[{}]"]),
    st.sampled_from(["[0.5]", "0.5", "{kind: white, std: 1}", "{kind: samples}", "{kind: [x]}"]),
    st.sampled_from(["{kind: samples, file: ../x}", "{kind: samples, values: [0]}", "{energy: 2}"]),
    st.sampled_from(["[{kind: drop, link: [1, 2]}]", "[{kind: cut, at: {1: [[1, 2]]}}]", "[{kind: drop}, 5]", "true"]),
    st.sampled_from(["[{kind: jump, node: 1, at: 2, a: random}]", "[{kind: jump, node: 2, at: 1, a: 0.5}]"]),
    st.sampled_from(["[{kind: partition, groups: [[1], [2]]}]", "[{kind: crash, process: 1, at: 2}]", "{1: {2: 3}}"]),
    st.text("[]{}:,-&*!|>'\"# \n0aé", max_size=8),
)
SETTINGS = st.builds(lambda path, value: f"{'.'.join(path)}={value}", st.lists(STEPS, max_size=4), VALUES)


@given(st.sampled_from(bundled()), st.lists(SETTINGS, min_size=1, max_size=3))
@settings(max_examples=examples(400))
def test_no_override_shows_a_traceback(name: str, overrides: list[str]) -> None:
    """Any value at any path: refused in words, or good all the way to the folder of its run."""
    try:
        with briefly():
            resolved = resolve(load(name, overrides))
    except UserError as error:
        found = str(error)
    else:
        assert parse(to_yaml(resolved).encode(), "again.yaml", Path()) == resolved
        return
    assert found.strip()
