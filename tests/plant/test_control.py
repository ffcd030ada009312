"""Requests of strangers to a plant: each is refused with a message, and the run continues undisturbed."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.ground.assignment import layout, truth_of
from hedgerow.orchestrator.launch.fault_changes import with_fault
from hedgerow.orchestrator.runs import registry
from hedgerow.plant import request as requests
from hedgerow.plant.world import World
from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.errors import HedgerowError, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.message import REPORT_ROWS
from hedgerow.wire.session import close, open_client
from tests.tools.processes import Orchestrator, orchestrator, parquet_bytes

STEPS = 60
DEADLINE_S = 30.0
PAPER7 = resolve(load("paper7"), Path())
TRUTH = truth_of(PAPER7, layout(PAPER7, None))
GRAPH = World(TRUTH).graph
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
EFFECT: dict[str, Any] = {"kind": "drop", "targets": [0], "start": 0, "stop": 5, "table": None}
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
    *asking("fault", "effects", None, {}, [3], [EFFECT] * 9, "x", entry=ENTRY),
    *asking("fault", "entry", None, [], {}, {"kind": 3}, "x", effects=[EFFECT]),
    *asking("fault", "entry", *({**ENTRY, "steps": bad} for bad in (3, [1], ["a", "b"], [0, 1.5])), effects=[EFFECT]),
    *asking("fault", "entry", {"kind": "drop", "at": "x"}, {"kind": "drop", "at": -1}, effects=[EFFECT]),
    *asking("fault", "entry", {"kind": "drop", "at": {"x": []}}, effects=[EFFECT]),
]
WRONG: dict[str, list[Any]] = {
    "kind": ["fire", ["drop"], None],
    "targets": [None, 3, [-1], [10**6], [HUNDRED_DIGITS], [0.0], [True], [0, 0]],
    "start": [-1, HUNDRED_DIGITS, 1.5, None, "0"],
    "stop": [-1, HUNDRED_DIGITS, 1.5, None, "0"],
    "probability": [-1, 2, HUNDRED_DIGITS, "1", []],
    "by": [-1, HUNDRED_DIGITS, 2.5],
    "a": [1e300, "1"],
    "table": [3, {"x": [0]}, {"-1": [0]}, {"1": 0}, {"1": [99]}, {str(HUNDRED_DIGITS): []}],
}
for name, values in WRONG.items():
    MEANT += asking("fault", "effects", *([EFFECT | {name: bad}] for bad in values), entry=ENTRY)
MEANT += asking("fault", "effects", [EFFECT | {"kind": "jump", "targets": []}], entry=ENTRY)


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
COUNT = st.integers(0, 20) | st.sampled_from([FOREVER, 2**63 - 1, -1])
LIKE_EFFECTS = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["drop", "delay", "cut", "sensor", "actuator", "crash", "jump"]) | ANYTHING,
        "targets": st.lists(st.integers(-1, 20), max_size=4) | ANYTHING,
        "start": COUNT,
        "stop": COUNT | ANYTHING,
    },
    optional={
        "probability": st.floats(0, 1) | ANYTHING,
        "by": COUNT | ANYTHING,
        "a": st.floats() | ANYTHING,
        "table": st.dictionaries(COUNT.map(str), st.lists(st.integers(0, 30), max_size=3), max_size=3) | ANYTHING,
    },
)


@given(st.lists(LIKE_EFFECTS, max_size=2))
def test_a_world_steps_on_under_any_effects_that_are_not_refused(written: list[Any]) -> None:
    world = World(TRUTH)
    payload = json.dumps({"effects": written}).encode()
    try:
        effects = requests.effects(requests.read(payload, world.graph), world.graph, 0)
    except UserError:
        return
    world.faults.add(effects)
    for _ in range(4):
        world.begin()
        world.states()
        assert world.comes_back(0) in (True, False)
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
