"""Events on `telemetry` that no plant sent: in an open network, any process may write them."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.orchestrator.ground.assignment import layout, views_of
from hedgerow.orchestrator.launch.intake import Intake
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.supervisor import Processes
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.verdict import Ending, Verdict
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import encode_batch, encode_end, encode_event, encode_telemetry
from hedgerow.wire.session import Receiver, Sender
from tests.tools.networks import read, simulate

FORGED_AT = 10
DROP = {"kind": "drop", "link": [2, 4], "steps": [5, 9]}
PAPER7 = hg.load("paper7", f"faults={json.dumps([DROP])}")
LARGE = read(
    "{name: large, b: 0.01, steps: 12, seed: 1, graph: {kind: ring, nodes: 20010},"
    " defaults: {candidates: [0.2, 0.3], x0: 1}}"
)


def jump(topology: Topology, at: int) -> dict[str, Any]:
    """A jump of node 3 to a candidate that is not its a."""
    network, k = topology.network, topology.position(3)
    a = max(network.candidates[:, k].tolist(), key=lambda one: abs(one - network.a[k]))
    return {
        "event": "fault",
        "fault": len(topology.faults),
        "entry": {"kind": "jump", "node": 3, "a": a, "at": at},
        "at": at,
    }


class Idle:
    """The processes of a run, which receive orders and ignore them."""

    def kill(self, *_: object) -> None:
        pass

    def revive(self, shard: int) -> None:
        pass

    def slow_law(self, *_: object) -> str:
        return ""


class Nowhere:
    """Both ends of a channel, with nothing on it."""

    def put(self, message: bytes) -> None:
        pass


def taken(topology: Topology, folder: Path, forged: Sequence[Any], at: int = FORGED_AT) -> Verdict:
    """Return the verdict of a run without a defect, with some events before the row of a step."""
    made = create(topology, folder)
    shards = layout(topology, min(7, topology.process_count))
    views = views_of(topology, shards)
    ending = Ending(run=folder.name, engine="zenoh", processes=len(shards))
    run = Recording(topology, made, Watching(record=False), ending, replayed=True)
    intake = Intake(run, made, shards, views, Quiet(), ending, threading.Event())
    intake._seen, intake._receiver = cast(Sender, Nowhere()), cast(Receiver, Nowhere())
    ran = simulate(topology, shards)
    rows = [encode_telemetry(row) for row in ran.rows]
    events = [(encode_event(at, event),) for event in forged]
    batches: list[Any] = [rows[:at], events, rows[at:], [(encode_end(ran.end),)]]
    for number, messages in enumerate(filter(None, batches)):
        intake._put(encode_batch(number, messages))
        intake.take(cast(Processes, Idle()))
    return run.close()


def test_the_rows_alone_are_valid(tmp_path: Path) -> None:
    verdict = taken(PAPER7, tmp_path / "run", [])
    assert verdict.verdict == "valid", verdict.content["reasons"]


PAST: dict[str, Callable[[], dict[str, Any]]] = {
    "a jump in the past": lambda: jump(PAPER7, 3),
    "a drop in the past": lambda: {"event": "fault", "fault": 1, "entry": {**DROP, "steps": [0, 3]}, "at": 0},
    "a drop that began in the past": lambda: {
        "event": "fault",
        "fault": 1,
        "entry": {**DROP, "steps": [9, 99]},
        "at": 9,
    },
    "the end of a fault in the past": lambda: {"event": "heal", "fault": 0, "at": 7},
}


@pytest.mark.parametrize("what", PAST)
def test_a_change_of_the_past_is_refused(what: str, tmp_path: Path) -> None:
    verdict = taken(PAPER7, tmp_path / "run", [PAST[what]()])
    assert verdict.verdict == "valid", verdict.content["reasons"]
    run = load_run(tmp_path / "run")
    assert "refused_message" in [event["event"] for event in run.events]
    assert run.topology.faults == PAPER7.faults
    assert run.first_difference() is None


@pytest.mark.parametrize("topology", [PAPER7, LARGE], ids=["paper7", "more nodes than are replayed"])
def test_a_jump_that_did_not_happen_is_invalid(topology: Topology, tmp_path: Path) -> None:
    verdict = taken(topology, tmp_path / "run", [jump(topology, FORGED_AT)])
    check = verdict.content["checks"]["dynamics"]
    assert (verdict.verdict, check["ok"], check["step"], check["node"]) == ("INVALID", False, FORGED_AT, 3)


KINDS = (
    "counts",
    "kill",
    "revive",
    "lost",
    "back",
    "fault",
    "heal",
    "refused",
    "pause",
    "resume",
    "rate",
    "x",
    7,
    None,
)
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-2, 12),
    st.just(2**63),
    st.floats(),
    st.text(max_size=4),
    st.just({}),
    st.just([{}] * 7),
    st.builds(
        dict,
        kind=st.sampled_from(["jump", "drop", "cut", "crash", "sensor", "x"]),
        node=st.integers(0, 9),
        at=st.integers(0, 40),
        a=st.floats(0, 1),
    ),
)
FIELDS = ("shard", "life", "restart", "fault", "entry", "at", "who", "cause", "plant", "shards", "rate")


@given(
    events=st.lists(
        st.builds(
            lambda kind, fields: {"event": kind, **fields},
            st.sampled_from(KINDS),
            st.dictionaries(st.sampled_from(FIELDS), VALUES, min_size=3),
        ),
        min_size=1,
        max_size=6,
    )
)
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
def test_any_event_is_refused_or_shows_in_the_verdict(
    events: list[dict[str, Any]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A valid run has the faults of its file, or their effects begin after its end; its folder can be replayed."""
    folder = tmp_path_factory.mktemp("forged") / "run"
    verdict = taken(PAPER7, folder, events)
    if verdict.verdict == "valid":
        assert load_run(folder).first_difference() is None
