"""A large file with mistakes is validated in pieces: the same mistakes as of the whole, in bounded memory."""

import copy
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from hedgerow.topologies.errors import TopologyError
from hedgerow.topologies.load import bundled, content, find, parse
from hedgerow.topologies.piecewise import LENGTHS, errors, is_length, trace
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.source import read_source
from tests.tools.examples import examples

FULL: dict[str, Any] = {
    "name": "full",
    "b": 0.1,
    "steps": 20,
    "defaults": {"x0": {"random": [-1, 1]}, "candidates": {"random": 3}, "disturbance": {"kind": "white", "std": 0.1}},
    "nodes": {
        1: {"candidates": [0.1, 0.2, 0.3, 0.4], "a": 0.1},
        2: {},
        "hub": {
            "disturbance": [{"kind": "samples", "values": [1, 2, 3, 4, 5, 6]}, {"kind": "impulse", "at": 3, "value": 1}]
        },
        4: {"x0": 3, "disturbance": {"kind": "sinusoid", "amplitude": 1, "omega": 2}},
    },
    "edges": [[1, "hub"], ["hub", 2], [4, "hub"], [1, 2]],
    "record": {"nodes": [1, 2, "hub"]},
    "lots": {"seed": 1, "nodes": {1: {"a": 0.5, "candidates": [0.1, 0.2]}, 2: {"x0": [0.3]}}},
    "faults": [
        {"kind": "drop", "link": [1, "hub"], "steps": [3, 9], "probability": 0.5},
        {"kind": "partition", "groups": [[1, "hub"], [2, 4]], "cut": True},
        {"kind": "crash", "process": 1, "at": 4, "restart_after": 5},
        {"kind": "jump", "node": 4, "at": 15, "a": "random"},
    ],
}
ODD: Any = st.sampled_from(
    [None, "x!", -1, 1e400, True, [], {}, [[]], {"zz": 1}, "random", 0.5, [1, 2], {"kind": "none"}]
)


def key(value: Any, found: ErrorDetails) -> tuple[Any, ...]:
    # The message about a length has the number of valid members, which one piece does not know.
    return trace(value, found["loc"])[0], found["type"], "" if found["type"] in LENGTHS else found["msg"]


def of_the_whole(value: Any) -> Counter[Any]:
    try:
        Topology.model_validate(value)
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False)
        return Counter(key(value, one) for one in found if not is_length(one, trace(value, one["loc"])[1]))
    return Counter()


def paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [path] * bool(path) + [inside for k in keys for inside in paths(value[k], (*path, k))]


@settings(max_examples=examples(40))
@given(
    st.lists(st.tuples(st.sampled_from(paths(FULL)), ODD, st.booleans()), max_size=6),
    st.sampled_from([2, 3, 5, 8, 20]),
)
def test_pieces_have_the_mistakes_of_the_whole(changes: list[tuple[tuple[Any, ...], Any, bool]], piece: int) -> None:
    value = copy.deepcopy(FULL)
    for path, odd, is_removed in changes:
        at: Any = value
        try:
            for step in path[:-1]:
                at = at[step]
            if is_removed:
                del at[path[-1]]
            else:
                at[path[-1]] = copy.deepcopy(odd)
        except (LookupError, TypeError):  # an earlier change has removed it
            continue
    # A rule about all members of a collection cannot be checked in one piece.
    whole = Counter({one: count for one, count in of_the_whole(value).items() if one[1] != "disjoint"})
    assert Counter(key(value, one) for one in errors(Topology, value, piece)) == whole


@pytest.mark.parametrize("name", bundled())
@pytest.mark.parametrize("piece", [2, 7, 50])
def test_pieces_of_a_right_file_have_no_mistakes(name: str, piece: int) -> None:
    value = read_source(name, content(find(name))).value
    assert not list(errors(Topology, value, piece))


HEAD = "name: t\nb: 0.1\nsteps: 3\n"
WRONG = {
    "edges": HEAD + "nodes: [1, 2]\nedges: [" + "[1, x!]," * 9000 + "]\n",
    "nodes": HEAD + "nodes:\n" + "".join(f"  {k}: {{zz: 1}}\n" for k in range(9000)),
    "faults": HEAD + "nodes: [1, 2]\nedges: [[1, 2]]\nfaults: [" + "{kind: drop, zz: 5}," * 9000 + "]\n",
    "candidates": HEAD + "nodes: {1: {candidates: [" + "x," * 9000 + "]}}\n",
    "lots": HEAD + "nodes: [1]\nlots: {seed: 1, nodes: {" + "".join(f"{k}: {{a: 5}}," for k in range(9000)) + "}}\n",
    "keys": HEAD + "nodes: [1]\n" + "".join(f"k{k}: 1\n" for k in range(9000)),
}


@pytest.mark.parametrize("kind", WRONG)
def test_equal_mistakes_of_a_large_file_are_counted_and_reported_once(kind: str) -> None:
    with pytest.raises(TopologyError) as error:
        parse(WRONG[kind].encode(), "t.yaml", Path())
    assert error.value.count == 9000
    assert len(str(error.value).splitlines()) == 1
    assert error.value.problems[0].line in (4, 5, 6)


def test_mistakes_in_a_list_are_not_missing_members() -> None:
    """A list with only wrong members still has them: no message claims that it has too few."""
    with pytest.raises(TopologyError) as error:
        parse((HEAD + "nodes: {1: {candidates: [x, y]}}").encode(), "t.yaml", Path())
    assert error.value.count == 2


PEAK = """
import json, resource, sys
from pathlib import Path
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.load import parse
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    parse(sys.stdin.buffer.read(), "t.yaml", Path())
except HedgerowError as error:
    print(json.dumps([error.count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before]))
"""


def test_mistakes_take_no_more_memory_than_the_values() -> None:
    """150,000 wrong values take below 100 MB; 2 kB for each mistake at once would be 300 MB."""
    text = HEAD + "nodes: {1: {candidates: [" + "x," * 150_000 + "]}}\n"
    done = subprocess.run([sys.executable, "-c", PEAK], input=text.encode(), capture_output=True, check=True)
    count, grown = json.loads(done.stdout)
    assert count == 150_000
    assert grown < 100_000  # kB
