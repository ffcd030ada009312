"""The plant's process over a real router, in this process, with agents and an observer that send only the necessary
messages.
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from hedgerow.orchestrator.ground.assignment import layout, truth_of
from hedgerow.plant.process import Plant
from hedgerow.topologies.errors import DeadlineError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.codec import decode_event, decode_state, encode_event, encode_input, encode_seen, kind_of
from hedgerow.wire.handshake import introduction
from hedgerow.wire.message import REPORT_ROWS, Kind
from hedgerow.wire.session import close, open_client, open_router, subscriber
from hedgerow.wire.stream import Inbox

NAMESPACE = "hedgerow/plant"
DEADLINE_S = 60.0
NEVER_S = 1000.0
PAPER7 = resolve(load("paper7", ["steps=1000000"]), Path())
TRUTH = truth_of(PAPER7, layout(PAPER7, 2))


class Scene:
    """A plant on a separate thread, and its participants."""

    def __init__(self, endpoint: str, stack: contextlib.ExitStack) -> None:
        self._endpoint, self._stack = endpoint, stack
        self._changed = threading.Condition()
        self._agents: dict[int, zenoh.Session] = {}
        self._declared: list[object] = []
        self._inbox = Inbox()
        self.states: list[int] = []
        """the steps with a state for shard 0"""
        self.events: list[dict[str, Any]] = []
        self.failure: BaseException | None = None

    def start(self, rate: float, deadline_s: float) -> None:
        """Start the plant, and an observer that acknowledges only at the end."""
        session = open_router(self._endpoint, NAMESPACE)
        self.plant = Plant(TRUTH, session, rate, deadline_s)
        self._stack.callback(self.plant.close)
        self._operator = self._open()
        self._declared.append(subscriber(self._operator, keys.TELEMETRY, self._observe))
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self._stack.callback(self.end)

    def _open(self) -> zenoh.Session:
        session = open_client(self._endpoint, NAMESPACE)
        self._stack.callback(close, session)
        return session

    def _run(self) -> None:
        try:
            self.plant.run()
        except BaseException as error:
            with self._changed:
                self.failure = error
                self._changed.notify_all()

    def end(self) -> None:
        """Stop the plant."""
        self.ask("stop")
        self._thread.join(DEADLINE_S)
        assert not self._thread.is_alive()

    def _observe(self, whole: bytes) -> None:
        with self._changed:
            for message in self._inbox.put(whole):
                if kind_of(message) == Kind.EVENT:
                    self.events.append({**decode_event(message)})
                elif kind_of(message) == Kind.END:
                    self._operator.put(keys.SEEN, encode_seen(self._inbox.last))
            self._changed.notify_all()

    def get_under_way(self) -> None:
        """The plant and both agents, ten steps on."""
        self.start(0.0, NEVER_S)
        for p in (0, 1):
            self.join(p)
        self.wait_for(lambda: len(self.states) >= 10)

    def join(self, p: int, life: int = 0) -> None:
        """Start an agent process that answers every state at once."""
        session = self._agents[p] = self._open()
        k, m = len(TRUTH.shards[p]), self.plant.shards.all[p].incidences

        def take(message: bytes) -> None:
            if kind_of(message) == Kind.STATE:
                t = decode_state(message, k, m).t
                with contextlib.suppress(zenoh.ZError):  # it dies
                    session.put(keys.input_(p), _input(p, t))
                with self._changed:
                    if p == 0:
                        self.states.append(t)
                    self._changed.notify_all()
            elif kind_of(message) == Kind.END:
                session.put(keys.input_(p), encode_event(0, {"event": "counted"}))

        self._declared.append(subscriber(session, keys.state(p), take))
        self._declared.append(session.liveliness().declare_token(keys.alive(keys.shard_name(p), life)))

    def declare_token(self, key: str) -> zenoh.LivelinessToken:
        """Declare the token of a process that is not ours."""
        return self._operator.liveliness().declare_token(key)

    def say(self, p: int, t: int) -> None:
        """Send an input of a shard, from any sender."""
        self._operator.put(keys.input_(p), _input(p, t))

    def die(self, p: int, life: int = 0) -> None:
        """End the process of an agent, and report it."""
        close(self._agents[p])
        assert self.ask("died", shard=p, life=life) == {}

    def ask(self, command: str, **request: Any) -> Any:
        """Return the plant's answer."""
        (reply,) = self._operator.get(keys.control(command), payload=json.dumps(request), timeout=DEADLINE_S)
        assert reply.ok is not None
        return json.loads(reply.ok.payload.to_string())

    def wait_for(self, what: Callable[[], Any]) -> None:
        """Wait until it is so."""
        with self._changed:
            assert self._changed.wait_for(what, DEADLINE_S), (self.states[-3:], self.events, self.failure)

    def happened(self, event: str, times: int = 1) -> Callable[[], bool]:
        """Return True if the plant has reported the event so often."""
        return lambda: [one["event"] for one in self.events].count(event) >= times


def _input(p: int, t: int) -> bytes:
    k = len(TRUTH.shards[p])
    return encode_input(t, np.zeros(k).tobytes(), np.zeros((REPORT_ROWS, k)).tobytes(), b"")


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with contextlib.ExitStack() as stack:
        yield Scene(f"unixsock-stream/{tmp_path}/router.sock", stack)


def test_a_step_is_paced_by_the_rate_alone(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the plant itself causes a step: there are no observer and no repetition."""
    monkeypatch.setattr("hedgerow.plant.process.RESEND_AFTER_S", NEVER_S)
    scene.start(20.0, NEVER_S)
    for p in (0, 1):
        scene.join(p)
    scene.wait_for(lambda: len(scene.states) >= 10)


@pytest.mark.parametrize("back", [[0], [0, 1]])
def test_a_deserted_network_continues_with_the_first_returning_agent(scene: Scene, back: list[int]) -> None:
    scene.get_under_way()
    for p in (0, 1):
        scene.die(p)
    scene.wait_for(scene.happened("lost", 2))
    for p in back:
        scene.join(p, life=1)
        scene.wait_for(scene.happened("back", p + 1))
    at = next(one["at"] for one in scene.events if one["event"] == "back")
    scene.wait_for(lambda: scene.states[-1] >= at + 10)
    assert at in scene.states
    assert at - 1 not in scene.states  # no node acts at the step of its return


def test_no_state_is_sent_while_an_agent_of_the_run_before_could_answer(scene: Scene) -> None:
    scene.start(0.0, NEVER_S)
    other = (scene.plant.number + 1) % 2**31
    left_behind = scene.declare_token(keys.alive(keys.shard_name(0), 0, other))
    for p in (0, 1):
        scene.join(p)
    while scene.ask("status")["absent"]:
        pass
    assert not scene.ask("status")["running"]
    assert scene.states == []
    left_behind.undeclare()  # type: ignore[no-untyped-call]
    scene.wait_for(lambda: len(scene.states) >= 10)


def test_a_network_without_returning_agents_ends_with_their_names(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A late input of a dead agent may arrive: it does not count as its return."""
    monkeypatch.setattr("hedgerow.plant.process.START_DEADLINE_S", 2.0)
    scene.get_under_way()
    for p in (0, 1):
        scene.die(p)
    scene.wait_for(scene.happened("lost", 2))
    scene.say(0, scene.states[-1])
    scene.wait_for(lambda: scene.failure)
    assert isinstance(scene.failure, DeadlineError)
    assert all(shard.name in str(scene.failure) for shard in scene.plant.shards.all)


def test_an_agent_that_dies_right_after_its_return_is_lost_again(scene: Scene) -> None:
    scene.get_under_way()
    scene.die(1)
    scene.wait_for(scene.happened("lost"))
    scene.ask("pause")
    scene.join(1, life=1)
    with scene.plant.changed:
        assert scene.plant.changed.wait_for(lambda: scene.plant.shards.all[1].back, DEADLINE_S)
    scene.ask("step", steps=1)
    scene.wait_for(scene.happened("back"))  # and the state of that step is held
    scene.die(1, life=1)
    scene.ask("resume")
    scene.wait_for(scene.happened("lost", 2))
    scene.wait_for(lambda: scene.states[-1] >= scene.events[-1]["step"] + 10)


def test_a_finished_run_has_no_place(scene: Scene) -> None:
    """A process that asks must wait for the next run; it would receive nothing more of this one."""
    scene.start(0.0, NEVER_S)
    for p in (0, 1):
        scene.join(p)
    scene.wait_for(scene.states.__len__)
    scene.end()
    answer = scene.ask("join/0", process="somebody", **introduction(""))
    assert answer == {"error": "the run is over", "wait": True}
