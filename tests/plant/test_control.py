"""Requests of strangers to a plant: each is refused with a message, and the run continues undisturbed."""

from __future__ import annotations

import contextlib
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.ground.assignment import layout, truth_of
from hedgerow.orchestrator.launch.fault_changes import with_fault
from hedgerow.orchestrator.runs import registry
from hedgerow.plant.fault_entry import FaultEntries
from hedgerow.plant.world import World
from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.errors import HedgerowError, UserError
from hedgerow.topologies.fault_kinds import FAULT_KINDS
from hedgerow.topologies.faults import effects
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.message import REPORT_ROWS
from hedgerow.wire.session import close, open_client
from tests.tools.processes import Orchestrator, orchestrator, parquet_bytes
from tests.tools.schedules import schedules

STEPS = 60
DEADLINE_S = 30.0
PAPER7 = resolve(load("paper7"), Path())
TRUTH = truth_of(PAPER7, layout(PAPER7, None))
ENTRIES = FaultEntries(World(TRUTH).graph, TRUTH.ids, TRUTH.shards, TRUTH.candidates)
COMMANDS = [command for command in keys.COMMANDS if command != "stop"] + ["join", "stop"]

NO_JSON = [
    b"",
    b"\0",
    b"\xff\xfe\xfa",
    "Hülle".encode("latin-1"),
    b"{",
    b"[" * 200_000,
    b'{"a":' * 200_000,
    b'{"steps": ' + b"9" * 100_000 + b"}",
    b'{"rate": NaN}',
    b'{"rate": -Infinity}',
]
NO_OBJECT = [b"null", b"3", b'"stop"', b"[]", b"[{}]", b'"\\ud800"', b'"' + b"x" * 500_000 + b'"']
HUGE = [b" " * 2**25, b'{"entry": "' + b"x" * 2**25 + b'"}']

HUNDRED_DIGITS = 10**100
ENTRY: dict[str, Any] = {"kind": "drop", "link": [1, 2], "steps": [0, 5]}


def asking(command: str, key: str, *values: Any, **rest: Any) -> list[tuple[str, dict[str, Any]]]:
    """Return a request for each of these values, with valid other fields."""
    return [(command, {**rest, key: value}) for value in values]


MEANT: list[tuple[str, dict[str, Any]]] = [
    *asking("step", "steps", 0, -1, 1.5, True, "1", None, HUNDRED_DIGITS, [1], {}),
    *asking("rate", "rate", -1, 1e300, HUNDRED_DIGITS, "5", None, True, [[1]]),
    *asking("heal", "fault", 0, -1, 1, 1.0, "1", True, HUNDRED_DIGITS, [1], {}),
    *asking("died", "shard", -1, 7, 1.0, "0", None, True, HUNDRED_DIGITS, life=0),
    *asking("died", "life", -1, 2, HUNDRED_DIGITS, "0", None, shard=0),
    ("died", {}),
    *asking("join", "codec", None, "1", HUNDRED_DIGITS, [[]]),
    *asking("join", "process", "x" * 10**5, "\ud800", "a\nerror: b", ["x"], 3, codec=0),
    *asking("join", "hedgerow", "x" * 10**5, ["x"], codec=0),
    *asking("join", "network", "x" * 10**5, ["x"], codec=0),
    *asking("fault", "entry", None, [], {}, {"kind": 3}, "x"),
]
BAD_CHANCES: list[Any] = [-1, 2, HUNDRED_DIGITS, "1", [], True]
BAD_TABLES: list[Any] = ["x", -1, 3, {}, {"x": []}, {"-1": []}, {"1": 0}, {"1": [[1, 99]]}]
BAD_GROUPS: list[Any] = [3, [], [[1]], [[1], []], [[1], [1]], [[1, 1], [2]], [[1], [9]]]
WRONG: list[dict[str, Any]] = [
    *({**ENTRY, "steps": bad} for bad in (3, [1], ["a", "b"], [0, 1.5], [5, 5], [-1, 3], [True, 3], [0, 2**63])),
    *({**ENTRY, "link": bad} for bad in (None, 3, [1], [1, 99], [1, 7], [1, 1], ["1", 2], [1, 2, 4], [[1], 2])),
    *({**ENTRY, "probability": bad} for bad in BAD_CHANCES),
    {**ENTRY, "kind": "fire"},
    {**ENTRY, "kind": ["drop"]},
    {**ENTRY, "colour": 1},
    {**ENTRY, "at": {"3": [[1, 2]]}},
    {**ENTRY, "from": 1, "to": 2},
    {"kind": "drop", "from": 1},
    {"kind": "drop"},
    *({"kind": "drop", "at": bad} for bad in BAD_TABLES),
    *({"kind": "delay", "link": [1, 2], "by": bad} for bad in (0, -1, 1.5, HUNDRED_DIGITS, None, "3")),
    {"kind": "cut", "link": [1, 2]},
    *({"kind": "partition", "groups": bad} for bad in BAD_GROUPS),
    {"kind": "partition", "groups": [[1], [2]], "cut": 1},
    {"kind": "crash", "node": 1},
    {"kind": "crash", "node": 1, "process": 0, "at": 3},
    {"kind": "crash", "process": 7, "at": 3},
    *({"kind": "crash", "node": 1, "at": 3, "restart_after": bad} for bad in (0, -1, HUNDRED_DIGITS, None)),
    *({"kind": "jump", "node": 4, "at": 0, "a": bad} for bad in ("random", 0.1234, 2, None, True)),
    {"kind": "jump", "node": 99, "at": 0, "a": 0.5},
]
MEANT += asking("fault", "entry", *WRONG)
LAST = 2**62
MEANT += asking("fault", "entry", {**ENTRY, "steps": [LAST - 1, LAST]}, {"kind": "drop", "at": {str(LAST): [[1, 2]]}})
"""Their steps would pass the last possible one, because a command counts from the present step."""


def answers(session: zenoh.Session, command: str, payload: bytes) -> dict[str, Any]:
    """Return the one answer of a plant, which must arrive."""
    key = keys.join(0) if command == "join" else keys.control(command)
    replies = [reply.ok for reply in session.get(key, payload=payload, timeout=DEADLINE_S)]
    assert len(replies) == 1, (command, payload[:80])
    assert replies[0] is not None
    answer: dict[str, Any] = json.loads(replies[0].payload.to_string())
    return answer


def test_a_plant_refuses_an_invalid_request_with_a_message(here: Path) -> None:
    """Each of some hundred queries is answered in one short line, and the trajectory is unaffected."""
    quiet = ("--viewer", "none", "--no-record")
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(Orchestrator("up", "paper7", *quiet, "--steps", str(STEPS), "--rate", "0.001"))
        network.wait_for("running")
        entry = registry.find(None)
        session = open_client(entry.endpoint, entry.namespace)
        stack.callback(close, session)
        asked = [(command, payload) for command in COMMANDS for payload in (*NO_JSON, *NO_OBJECT)]
        asked += [("fault", payload) for payload in HUGE]
        asked += [(command, json.dumps(request).encode()) for command, request in MEANT]
        for command, payload in asked:
            error = answers(session, command, payload)["error"]
            assert error.startswith(f"{command}: "), (command, payload[:80], error)
            assert len(error) < 500
            assert error.isprintable()
        for wide in ("**", "control/*", "control/join/*", "**/stop", "control/$*p"):
            for reply in session.get(wide, payload=b"{}", timeout=DEADLINE_S):
                assert reply.err is not None
                assert f": asked by '{wide}'; a command is" in reply.err.payload.to_string()
        assert not answers(session, "status", b"{}")["paused"]
        assert answers(session, "rate", b'{"rate": 0}')["step"] == 1
        assert network.wait() == 0, network.output
    assert "Traceback" not in network.output
    assert not [log for log in (here / "runs/latest/logs").iterdir() if "Traceback" in log.read_text()]
    reference = orchestrator("simulate", "paper7", "--steps", str(STEPS), "--no-record", "--run-dir", "reference")
    assert reference.returncode == 0
    assert parquet_bytes(here / "runs/latest") == parquet_bytes(here / "reference")


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inside: st.lists(inside, max_size=3) | st.dictionaries(st.text(max_size=5), inside, max_size=3),
    max_leaves=8,
)
IDS = st.sampled_from([1, 2, 3, 4, 7, 99, "1", True, None, 2.0])
PAIRS = st.lists(IDS, min_size=1, max_size=3)
COUNT = st.integers(-1, 20) | st.sampled_from([FOREVER, 2**63 - 1, 1.5, "3"])
VALUES: dict[str, st.SearchStrategy[Any]] = {
    "kind": st.sampled_from(["drop", "delay", "cut", "partition", "sensor", "actuator", "crash", "jump", "fire"]),
    "link": PAIRS,
    "edge": PAIRS,
    "from": IDS,
    "to": IDS,
    "node": IDS,
    "groups": st.lists(st.lists(IDS, max_size=2), max_size=3),
    "process": st.integers(-1, 8),
    "at": COUNT | st.dictionaries(COUNT.map(str), st.lists(PAIRS, max_size=2), max_size=2),
    "steps": st.lists(COUNT, max_size=3),
    "probability": st.floats(-0.5, 1.5) | st.none(),
    "by": COUNT,
    "a": st.sampled_from([*PAPER7.nodes[4].candidates, 0.5, "random", 3]),  # type: ignore[misc]
    "cut": st.booleans() | st.integers(0, 1),
    "restart_after": COUNT,
}


@st.composite
def entries(draw: st.DrawFn) -> dict[str, Any]:
    """Draw an entry with the keys of a kind, and sometimes without one of them or with a strange one."""
    kind = draw(VALUES["kind"])
    own = FAULT_KINDS.get(kind)
    keys_of = {*itertools.chain(*own.forms), *own.required, *own.optional} if own else set()
    wanted = draw(st.sets(st.sampled_from(sorted(keys_of)))) if keys_of else set()
    strange = {draw(st.sampled_from(sorted(VALUES)))} if draw(st.integers(0, 9)) == 0 else set()
    return {"kind": kind, **{key: draw(VALUES.get(key, ANYTHING)) for key in sorted(wanted | strange)}}


@given(entries() | schedules(PAPER7, most=1).map(lambda listed: listed[0] if listed else {"kind": "x"}))
@settings(max_examples=400)
def test_the_plant_accepts_what_a_resolved_file_may_contain(entry: dict[str, Any]) -> None:
    """An accepted entry has the effects of the file, and the observer can write it into the file.

    An entry in the shortest form of a valid fault is accepted.
    """
    entry = json.loads(json.dumps(entry))
    try:
        added: Any = ENTRIES.effects(entry, 0)
    except UserError:
        with contextlib.suppress(HedgerowError):
            (fault,) = with_fault(PAPER7, entry).faults
            assert fault.written() != entry
        return
    changed = with_fault(PAPER7, entry)
    assert added == effects(changed.faults, changed)
    world = World(TRUTH)
    world.faults.add(added)
    for _ in range(3):
        world.begin()
        world.states()
        world.step(np.zeros(world.graph.n), np.zeros((REPORT_ROWS, world.graph.n)), [b""] * len(PAPER7.ids))


@pytest.mark.parametrize(
    "entry",
    [
        {"kind": "drop", "link": [1, 99]},
        {"kind": "drop", "link": [1, 7]},
        {"kind": "fire"},
        {"kind": "jump", "node": 4, "at": 0, "a": "random"},
        {"kind": "\ud800"},
        {"kind": "drop", "link": [1, 2], "steps": [5, 5]},
    ],
)
def test_an_observer_reports_an_invalid_fault(entry: dict[str, Any]) -> None:
    with pytest.raises(HedgerowError):
        with_fault(PAPER7, entry)
