"""The rights of clients at the router of a secure network: certificates, keys, tokens and commands."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import zenoh

from hedgerow.orchestrator.ground.assignment import layout, places, views_of
from hedgerow.orchestrator.launch.certificates import Authority, for_this_run
from hedgerow.plant.request import BYTES_PER_INCIDENCE, LEAST_BYTES
from hedgerow.topologies.errors import Code
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.access import MOST_JOINS_PER_S, OBSERVER, OPERATOR, ROUTER, Place
from hedgerow.wire.ports import free_port
from hedgerow.wire.session import WireError, close, direct, open_client, open_router
from tests.tools.rights import KEYS, PAPER7, PLACES, RIGHTS, WILD, N

NAMESPACE = "hedgerow/access"
DEADLINE_S = 30.0


class Secure:
    """The router of a secure paper7, without its processes: all clients belong to the test."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack, processes: Sequence[Place] = PLACES) -> None:
        self.folder, self._stack = folder, stack
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        stack.enter_context(for_this_run(folder, processes, NAMESPACE, "127.0.0.1"))
        self.router = open_router(self.endpoint, NAMESPACE, folder / ROUTER)
        stack.callback(close, self.router)

    def client(self, credentials: Path | None) -> zenoh.Session:
        """Return a session with these credentials; raise WireError if they are refused."""
        session = open_client(self.endpoint, NAMESPACE, credentials, timeout_s=2)
        self._stack.callback(close, session)
        return session


@pytest.fixture
def secure(tmp_path: Path) -> Iterator[Secure]:
    with contextlib.ExitStack() as stack:
        yield Secure(tmp_path / "keys", stack)


class Heard:
    """All messages between sessions: (sender, key) by receiver."""

    def __init__(self) -> None:
        self.what: dict[str, set[tuple[str, str]]] = {}
        self._changed = threading.Condition()

    def listen(self, name: str, session: zenoh.Session, on: list[str]) -> list[object]:
        """Subscribe to these keys, one by one."""
        mine = self.what.setdefault(name, set())

        def take(sample: zenoh.Sample) -> None:
            with self._changed:
                mine.add((sample.payload.to_string(), str(sample.key_expr)))
                self._changed.notify_all()

        callback = zenoh.handlers.Callback(take, indirect=False)
        return [session.declare_subscriber(key, callback, allowed_origin=zenoh.Locality.REMOTE) for key in on]

    def wait(self, name: str, sent: set[tuple[str, str]]) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: sent <= self.what[name], DEADLINE_S), sent - self.what[name]


def test_of_all_pairs_of_writer_key_and_reader_exactly_the_allowed_ones_succeed(secure: Secure) -> None:
    """Each client subscribes to every key and to wildcards, and publishes on every key; the rules decide what arrives.

    Each sends the forbidden messages first. The router processes the messages of one client in order. When the plant
    has received the last message of each client, all are through, and the messages of the plant follow.
    """
    sessions = {name: secure.client(secure.folder / name) for name in RIGHTS if name != keys.PLANT}
    heard = Heard()
    declared = [heard.listen(name, session, [*KEYS, *WILD]) for name, session in sessions.items()]
    declared.append(heard.listen(keys.PLANT, secure.router, KEYS))
    for name, session in sessions.items():
        for keys_of in ([key for key in [*KEYS, *WILD] if key not in RIGHTS[name].publishes], RIGHTS[name].publishes):
            for key in keys_of:
                session.put(key, name, congestion_control=zenoh.CongestionControl.BLOCK)
            # A message on `**` counts on every key: a message right after it would exceed the rate.
            list(session.get(keys.control("status"), timeout=DEADLINE_S))
        list(session.get(keys.control("status"), timeout=DEADLINE_S))  # an answer, or none: it is behind them
    for name in sessions:
        heard.wait(keys.PLANT, {(name, key) for key in RIGHTS[name].publishes})
    for key in RIGHTS[keys.PLANT].publishes:
        secure.router.put(key, keys.PLANT, congestion_control=zenoh.CongestionControl.BLOCK)
    for name in sessions:
        mine = {(keys.PLANT, key) for key in RIGHTS[keys.PLANT].publishes if key in RIGHTS[name].subscribes}
        heard.wait(name, mine)
    # The operator may not subscribe to anything.
    list(sessions[OPERATOR].get(keys.control("status"), timeout=DEADLINE_S))

    allowed = {
        reader: {
            (writer, key) for writer, some in RIGHTS.items() for key in some.publishes if key in granted.subscribes
        }
        for reader, granted in RIGHTS.items()
    }
    allowed[keys.PLANT] = {(name, key) for name in sessions for key in RIGHTS[name].publishes}
    # The plant is the router: it receives every permitted message, and each one has a permitted sender.
    assert heard.what == allowed
    pairs = [(reader, key) for reader in sessions for key in KEYS if key in RIGHTS[reader].subscribes]
    assert len(pairs) == 2 * len(PAPER7.edges) + N + 1
    del declared


def test_tokens_and_commands_are_their_owners(secure: Secure) -> None:
    """No client can show another's token or ask for another's place, and an agent cannot command the plant."""
    tokens: set[str] = set()
    late_rows = threading.Condition()

    def see(sample: zenoh.Sample) -> None:
        with late_rows:
            tokens.add(str(sample.key_expr))
            late_rows.notify_all()

    def answer(query: zenoh.Query) -> None:
        query.reply(str(query.key_expr), b"{}")

    watched = secure.router.liveliness().declare_subscriber("**", zenoh.handlers.Callback(see, indirect=False))
    declared: list[object] = [watched]
    for command in keys.COMMANDS:
        callback = zenoh.handlers.Callback(answer, indirect=False)
        declared.append(secure.router.declare_queryable(keys.control(command), callback))
    callback = zenoh.handlers.Callback(answer, indirect=False)
    declared.append(secure.router.declare_queryable(keys.join("*"), callback))
    names = [*(keys.shard_name(p) for p in range(N)), keys.PLANT]
    declared += [secure.router.liveliness().declare_token(keys.alive(name)) for name in names]
    commands = [*keys.COMMANDS, *(f"join/{who}" for who in (*range(N), OBSERVER))]
    obeyed, seen = set(), set()
    for name in RIGHTS:
        if name == keys.PLANT:
            continue
        session = secure.client(secure.folder / name)
        own = RIGHTS[name].shows
        for one in names:  # before it claims to be them all
            there = session.liveliness().get(keys.alive(one, "*"), timeout=DEADLINE_S)
            seen |= {(name, one) for reply in there if reply.ok is not None}
        for one in sorted(names, key=lambda one: keys.alive(one, "*") in own):
            declared.append(session.liveliness().declare_token(keys.alive(one, 3)))
        for command in commands:
            if any(reply.ok is not None for reply in session.get(keys.control(command), timeout=DEADLINE_S)):
                obeyed.add((name, command))
    tokens_of_shards = {keys.alive(keys.shard_name(p), 3) for p in range(N)}
    with late_rows:
        assert late_rows.wait_for(lambda: tokens_of_shards <= tokens, DEADLINE_S)
    assert tokens == tokens_of_shards | {keys.alive(name) for name in names}
    assert obeyed == {(OBSERVER, "died"), (OBSERVER, "stop"), (OBSERVER, "status")} | {
        (OPERATOR, command) for command in keys.COMMANDS if command != "died"
    } | {(OBSERVER, "join/observer")} | {(f"agent-{p + 1}", f"join/{p}") for p in range(N)}
    agents = [f"agent-{p + 1}" for p in range(N)]
    assert seen == {(name, keys.PLANT) for name in (*agents, OBSERVER)} | {
        (name, keys.shard_name(p)) for p, name in enumerate(agents)
    }


def test_endless_requests_for_a_place_are_limited(secure: Secure) -> None:
    """Each request costs the plant an answer, and every observer receives a refusal; other requests still arrive."""
    asked, began = Counter[str](), time.monotonic()

    def answer(query: zenoh.Query) -> None:
        asked[str(query.key_expr)] += 1
        query.reply(str(query.key_expr), b"{}")

    declared = secure.router.declare_queryable(keys.join("*"), direct(answer))
    one, other = (secure.client(secure.folder / name) for name in ("agent-1", "agent-2"))
    for _ in range(500):
        list(one.get(keys.join(0), timeout=DEADLINE_S))
    assert any(reply.ok is not None for reply in other.get(keys.join(1), timeout=DEADLINE_S))
    assert 1 <= asked[keys.join(0)] <= 1 + MOST_JOINS_PER_S * (time.monotonic() - began) < 500
    asked.clear()
    assert not list(secure.client(secure.folder / "agent-3").get(keys.join(2), payload=bytes(8192), timeout=DEADLINE_S))
    assert not asked
    del declared


def test_the_largest_command_reaches_the_plant_of_a_small_network(tmp_path: Path) -> None:
    """Without back-filling, an agent's largest message has some hundred bytes; a fault may name a link at each step."""
    network = resolve(load("paper7", ["backfill=false"]))
    small = places(views_of(network, layout(network, None)))
    command = bytes(LEAST_BYTES + BYTES_PER_INCIDENCE * 2 * len(network.edges))
    assert max(place.largest for place in small) < len(command) / 100
    with contextlib.ExitStack() as stack:
        secure = Secure(tmp_path / "keys", stack, small)

        def answer(query: zenoh.Query) -> None:
            query.reply(str(query.key_expr), str(len(query.payload or b"")))

        declared = secure.router.declare_queryable(keys.control("fault"), direct(answer))
        operator = secure.client(secure.folder / OPERATOR)
        (reply,) = operator.get(keys.control("fault"), payload=command, timeout=DEADLINE_S)
        assert reply.ok is not None
        assert int(reply.ok.payload.to_string()) == len(command)
        del declared


def test_a_client_without_a_certificate_of_the_run_is_refused(secure: Secure, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    Authority().issue(tmp_path / "other/agent-1", "agent-1")
    for credentials in (None, tmp_path / "other/agent-1"):
        with pytest.raises(WireError) as refused:
            secure.client(credentials)
        assert refused.value.code == (Code.REFUSED if credentials else Code.WIRE)


def test_an_unknown_name_has_no_rights(secure: Secure, tmp_path: Path) -> None:
    """The certificate is from the run's own authority but has another name: it can connect, and has no rights."""
    with contextlib.ExitStack() as stack:
        authority = Authority()
        endpoint = f"tls/127.0.0.1:{free_port()}"
        authority.issue(tmp_path / "plant", keys.PLANT, host="127.0.0.1")
        (tmp_path / "plant/access.json").write_text((secure.folder / "router/access.json").read_text())
        router = open_router(endpoint, NAMESPACE, tmp_path / "plant")
        stack.callback(close, router)
        heard = Heard()
        sessions = {}
        for name in ("agent-8", "agent-1"):
            authority.issue(tmp_path / name, name)
            sessions[name] = open_client(endpoint, NAMESPACE, tmp_path / name)
            stack.callback(close, sessions[name])
        declared = [heard.listen("plant", router, KEYS), heard.listen("agent-8", sessions["agent-8"], [*KEYS, *WILD])]
        for name, session in sessions.items():
            for key in sorted(KEYS, key=lambda key: key in RIGHTS["agent-1"].publishes):
                session.put(key, name, congestion_control=zenoh.CongestionControl.BLOCK)
            list(session.get(keys.control("status"), timeout=1))
        heard.wait("plant", {("agent-1", key) for key in RIGHTS["agent-1"].publishes})
        for p in range(N):
            router.put(keys.state(p), "plant")
        assert heard.what["plant"] == {("agent-1", key) for key in RIGHTS["agent-1"].publishes}
        assert heard.what["agent-8"] == set()
        del declared
