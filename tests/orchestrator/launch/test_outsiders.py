"""Outsiders: the possible effects of a process without rights, or with the rights of one agent, on a run."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.ground.assignment import layout, places, truth_of, views_of
from hedgerow.orchestrator.launch.endpoints import Connection
from hedgerow.orchestrator.launch.fork_client import Order
from hedgerow.orchestrator.launch.restarts import RESTARTS, UNREACHED_S
from hedgerow.orchestrator.launch.supervisor import Processes
from hedgerow.orchestrator.metrics.message_audit import audit
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.orchestrator.views.rerun import one_port
from hedgerow.plant.allowance import COMMANDS_AT_ONCE, COMMANDS_PER_S, JOINS_AT_ONCE, TOKENS_AT_ONCE, Allowance
from hedgerow.plant.process import Plant
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.codec import decode_event, kind_of
from hedgerow.wire.handshake import introduction
from hedgerow.wire.message import Kind
from hedgerow.wire.refusal import refused
from hedgerow.wire.session import close, open_client, open_router, subscriber
from hedgerow.wire.stream import Inbox
from tests.tools.machines import ROOT
from tests.tools.processes import Orchestrator, orchestrator

QUIET = ("--viewer", "none", "--no-record")
PAPER7 = resolve(load("paper7"), Path())
LAYOUT = layout(PAPER7, None)
VIEWS = views_of(PAPER7, LAYOUT)
NAMESPACE = "hedgerow/outsiders"
DEADLINE_S = 30.0


class Started:
    """The processes of a fork server that starts none."""

    def __init__(self) -> None:
        self.pids: dict[str, int] = {}
        self.codes: dict[str, int] = {}

    def fork(self, *orders: Order) -> None:
        for order in orders:
            self.codes.pop(order.name, None)
            self.pids[order.name] = 1

    def kill(self, name: str) -> None:
        self.codes[name] = -9


class Lives:
    """One supervised agent with lives that the test ends, on a clock of the test."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        monkeypatch.setattr("orchestrator.launch.supervisor.time.monotonic", lambda: self.now)
        self.fork_client = Started()
        (folder / "processes").mkdir(parents=True)
        (folder / "logs").mkdir()
        self.processes = Processes(self.fork_client, RunFolder(folder), Connection("tcp/x:1", "n", listens=True))  # type: ignore[arg-type]
        self.processes.start_agents([VIEWS[0]])

    def end(self, reached: bool | None) -> list[str]:
        """End the life at hand and wait for the next; the kinds of events."""
        self.fork_client.codes["agent-1"] = -9
        happened = self.processes.tend(lambda _, __: reached)
        if (due := self.processes.next_due) is not None:
            self.now = max(self.now, due)
            happened += self.processes.tend(lambda _, __: reached)
        return [event["kind"] for event in happened]


@pytest.fixture
def lives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lives:
    return Lives(tmp_path / "run", monkeypatch)


def test_a_life_that_never_reached_the_router_uses_up_no_restart(lives: Lives) -> None:
    for _ in range(4 * RESTARTS):
        assert "down" not in lives.end(reached=False)
    for _ in range(RESTARTS):
        assert "down" not in lives.end(reached=True)
    assert lives.end(reached=True)[-2:] == ["died", "down"]
    assert [dead.name for dead in lives.processes.down] == ["agent-1"]


def test_an_agent_that_never_reaches_the_router_stays_down_in_bounded_time(lives: Lives) -> None:
    began, ended = lives.now, 0
    while "down" not in lives.end(reached=False):
        ended += 1
        assert ended < UNREACHED_S
    assert UNREACHED_S <= lives.now - began < 1.1 * UNREACHED_S
    assert lives.processes.down[0].code == -9


def test_before_the_first_step_a_few_failures_of_any_kind_are_enough(lives: Lives) -> None:
    for _ in range(RESTARTS):
        lives.end(reached=False)
        assert not lives.processes.failing
    lives.end(reached=False)
    assert [dead.name for dead in lives.processes.failing] == ["agent-1"]


def test_no_life_follows_before_the_plant_knows_of_the_death(lives: Lives) -> None:
    for kinds in (["died"], [], []):
        assert lives.end(reached=None) == kinds
        assert lives.processes.next_due is None
    lives.end(reached=True)
    assert lives.processes.restarts == 1


@given(st.lists(st.tuples(st.floats(0, 10), st.floats(0, 50)), max_size=60))
def test_an_allowance_grants_no_more_than_its_rate(asked: list[tuple[float, float]]) -> None:
    allowance, now = Allowance(10, 40), time.monotonic() + 1
    began, granted = now, 0.0
    for pause, units in asked:
        now += pause
        granted += units if allowance.take(units, now) else 0
        assert granted <= 40 + 10 * (now - began) + 1e-6
    assert allowance.take(40, now + 4)


class Scene:
    """The plant of paper7 as a router, and one outsider with the right to publish on every key of it."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack) -> None:
        endpoint = f"unixsock-stream/{folder}/s"
        router = open_router(endpoint, NAMESPACE)
        self.plant = Plant(truth_of(PAPER7, LAYOUT), router, 0.0, 5.0, network="0123abcd")
        stack.callback(self.plant.close)
        self.session = open_client(endpoint, NAMESPACE)
        stack.callback(close, self.session)
        self.events: list[dict[str, Any]] = []
        self._inbox = Inbox()
        self._listener = subscriber(self.session, keys.TELEMETRY, self._take)

    def _take(self, whole: bytes) -> None:
        self.events += [decode_event(one) for one in self._inbox.put(whole) if kind_of(one) == Kind.EVENT]

    def ask(self, key: str, **request: Any) -> dict[str, Any]:
        (reply,) = self.session.get(key, payload=json.dumps(request), timeout=DEADLINE_S)
        assert reply.ok is not None
        answer: dict[str, Any] = json.loads(reply.ok.payload.to_string())
        return answer


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with contextlib.ExitStack() as stack:
        yield Scene(tmp_path, stack)


def test_a_refused_process_is_named_by_its_key_and_each_cause_is_reported_once(scene: Scene) -> None:
    theirs = {**introduction("0123abcd"), "hedgerow": "9.9", "number": 1}
    for _ in range(5):
        assert "error" in scene.ask(keys.join(0), process="agent-7", **theirs)
    scene.ask(keys.join(0), process="agent-7", **{**theirs, "hedgerow": "agent-7 is refused"})
    for k in range(20):
        scene.ask(keys.join(0), process="agent-7", **{**theirs, "hedgerow": f"9.{k}"})
    reported = [event for event in scene.events if event["event"] == "refused"]
    assert {event["who"] for event in reported} == {"agent 1"}
    causes = [event["cause"] for event in reported]
    assert len(set(causes)) == len(causes) <= 4
    assert not any("agent-7" in cause for cause in causes)


def test_a_place_that_is_asked_for_too_often_delays_no_other(scene: Scene) -> None:
    ours = {**introduction("0123abcd"), "process": "x", "number": 1}
    answers = [scene.ask(keys.join(0), **ours) for _ in range(int(2 * JOINS_AT_ONCE))]
    assert "life" in answers[0]
    assert [answer["wait"] for answer in answers if "error" in answer]
    assert scene.ask(keys.join(1), **ours)["life"] == 0
    assert "error" not in scene.ask(keys.control("stop"))


def test_large_commands_are_bounded_by_their_bytes_and_hold_up_no_other_command(scene: Scene) -> None:
    most = 2 * int(COMMANDS_AT_ONCE * 4096 / 500_000)
    answers = [scene.ask(keys.control("status"), filler="x" * 500_000) for _ in range(most)]
    assert "step" in answers[0]
    assert COMMANDS_PER_S < 10 * COMMANDS_AT_ONCE
    assert any(answer.get("wait") for answer in answers)
    assert "error" not in scene.ask(keys.control("stop"))


def test_tokens_above_the_rate_are_seen_later_and_the_newest_life_wins(scene: Scene) -> None:
    most = int(3 * TOKENS_AT_ONCE)
    tokens = [scene.session.liveliness().declare_token(keys.alive(keys.shard_name(0), life)) for life in range(most)]
    scene.ask(keys.control("status"))  # behind all of them
    shard = scene.plant.shards.all[0]
    assert shard.life < most - 1
    by = time.monotonic() + DEADLINE_S
    pause = threading.Event()
    while shard.life < most - 1:
        assert time.monotonic() < by
        with scene.plant.changed:
            scene.plant._see_late_tokens()
        pause.wait(0.02)
    assert shard.ready
    assert shard.seen == most - 1
    del tokens


def test_a_plant_reports_if_a_life_had_reached_the_router(scene: Scene) -> None:
    assert scene.ask(keys.control("died"), shard=0, life=0) == {"unreached": True}
    token = scene.session.liveliness().declare_token(keys.alive(keys.shard_name(0), 1))
    assert scene.ask(keys.control("died"), shard=0, life=1) == {}
    del token


def test_the_audit_counts_the_messages_between_plant_and_observer() -> None:
    word: dict[str, Any] = {"sent": {keys.TELEMETRY: 5}, "received": {keys.SEEN: 9}, "refused": {}, "strange": {}}
    event = {"plant": word, "shards": [None] * len(VIEWS)}
    observed: dict[str, Any] = {"sent": {keys.SEEN: 8}, "received": {keys.TELEMETRY: 6}, "refused": {}, "strange": {}}
    found = audit(places(VIEWS), event, observed)
    assert {(one.key, one.sender, one.receiver): (one.sent, one.received) for one in found.observer} == {
        (keys.TELEMETRY, "plant", "observer"): (5, 6),
        (keys.SEEN, "observer", "plant"): (8, 9),
    }
    assert len(found.wrong) == 2


def test_a_run_counts_every_key(here: Path) -> None:
    """The run is long enough for the observer to acknowledge something before the end."""
    assert orchestrator("up", "paper7", "--steps", "2000", *QUIET).returncode == 0
    information = json.loads((here / "runs/latest/verdict.json").read_text())["information"]
    assert {one["key"] for one in information["observer"]} == {keys.TELEMETRY, keys.SEEN}
    assert all(0 < one["received"] <= one["sent"] for one in information["observer"]), information["observer"]


def test_a_browser_that_sends_no_head_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(one_port, "HEAD_S", 0.1)

    async def visit() -> bytes:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await one_port._answer(reader, writer, 1, 1)

        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
            writer.write(b"GET / HTTP/1.1\r\n")
            got = await asyncio.wait_for(reader.read(), 10)
            writer.close()
            return got

    assert asyncio.run(visit()) == b""


def test_every_container_is_confined_and_the_page_is_on_loopback_alone() -> None:
    services = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    for name, service in services.items():
        assert service["cap_drop"] == ["ALL"], name
        assert service["read_only"] is True, name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert "/tmp" in service["tmpfs"], name
        assert service["deploy"]["resources"]["limits"].keys() == {"memory", "cpus"}, name
        assert service["pids_limit"] <= 256, name
        assert int(service["healthcheck"]["start_period"].removesuffix("s")) <= 120, name
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", [])), name


def test_every_pod_is_confined_too() -> None:
    done = orchestrator("compose", "paper7", "--format", "kubernetes")
    pods = [
        one["spec"]["template"]["spec"] for one in yaml.safe_load_all(done.stdout) if "template" in one.get("spec", {})
    ]
    assert len(pods) == 10
    for pod in pods:
        (container,) = pod["containers"]
        security = container["securityContext"]
        assert security["capabilities"] == {"drop": ["ALL"]}
        assert security["readOnlyRootFilesystem"]
        assert not security["allowPrivilegeEscalation"]
        assert container["resources"]["limits"].keys() == {"memory", "cpu"}
        assert {one["name"] for one in container["volumeMounts"]} == {one["name"] for one in pod["volumes"]}


def test_a_connection_without_a_handshake_is_no_refused_certificate() -> None:
    logged = "zenoh_link_tls::unicast: tls handshake eof. Hint: increase the system open file limit."
    notice = refused(f"2026-11-28T02:45:58Z  WARN acc-0 {logged}")
    assert notice is not None
    assert "certificate" not in notice


@pytest.mark.slow
def test_an_agent_that_is_killed_while_the_router_is_busy_is_back_in_the_end(here: Path) -> None:
    """The end of each bare connection blocks the acceptor of Zenoh's TLS for 0.1 s."""
    with Orchestrator("up", "paper7", "--secure", "--steps", "1000000", "--rate", "50", *QUIET) as network:
        network.wait_for("running")
        start = next(json.loads(line) for line in Path("runs/latest/events.jsonl").read_text().splitlines())
        host, port = start["endpoint"].removeprefix("tls/").split(":")
        for _ in range(120):
            socket.create_connection((host, int(port)), 5).close()
        os.kill(network.children["agent-3"], signal.SIGKILL)
        network.wait_for_event("back")
        network.send(signal.SIGINT)
        network.wait()
    verdict = json.loads(Path("runs/latest/verdict.json").read_text())
    assert verdict["down"] == []
    assert verdict["restarts"] >= 1
