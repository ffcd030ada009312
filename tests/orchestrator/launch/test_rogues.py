"""Processes that violate the information structure, over real Zenoh: their attempts, and the results."""

from __future__ import annotations

import contextlib
import itertools
import json
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import zenoh

from hedgerow.orchestrator.ground.assignment import layout, places, views_of
from hedgerow.orchestrator.launch.certificates import Authority, for_this_run
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.plant.request import BYTES_PER_INCIDENCE, LEAST_BYTES
from hedgerow.topologies.errors import Code
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.access import MOST_JOINS_PER_S, MOST_PER_S, OBSERVER, OPERATOR, ROUTER, Place, rights
from hedgerow.wire.codec import VERSION, encode_input, encode_link, encode_state
from hedgerow.wire.message import Link
from hedgerow.wire.ports import free_port
from hedgerow.wire.session import WireError, close, direct, open_client, open_router
from tests.tools.processes import Orchestrator, orchestrator, parquet_bytes

QUIET = ("--viewer", "none", "--no-record")
NAMESPACE = "hedgerow/rogues"
N = 7
STEPS = 300
DEADLINE_S = 30.0
PAPER7 = resolve(load("paper7"), Path())
PLACES = places(views_of(PAPER7, layout(PAPER7, None)))
RIGHTS = rights(PLACES)
KEYS = [
    *(keys.state(p) for p in range(N)),
    *(keys.input_(p) for p in range(N)),
    *(keys.link(p, q) for p, q in itertools.permutations(range(N), 2)),
    keys.TELEMETRY,
    keys.SEEN,
]
WILD = ["**", "link/**", "link/*/1", "state/*"]


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


# A network that runs, and a rogue in it.


def put(session: zenoh.Session, key: str, message: bytes) -> None:
    session.put(key, message, congestion_control=zenoh.CongestionControl.BLOCK)


def garbage(good: bytes) -> list[bytes]:
    """Return invalid messages of a key, made from a valid one."""
    version, kind, _, n, t = struct.unpack_from("<BBHIq", good)
    return [
        b"",
        b"\0",
        bytes(16 * 2**20),
        struct.pack("<BBHIq", VERSION + 1, kind, 0, n, t) + good[16:],
        struct.pack("<BBHIq", version, kind, 0, n + 1, t) + good[16:],
        struct.pack("<BBHIq", version, 99, 0, n, t) + good[16:],
        struct.pack("<BBHIq", version, kind, 0, n, -1) + good[16:],
        good[:-2],
        good + b"\0",
        np.random.default_rng(1).bytes(len(good)),
    ]


def link(t: int, value: float = 1.0) -> bytes:
    number = struct.pack("<d", value)
    return encode_link(Link(t, t, number, number), 1)


def input_(t: int, value: float = 1.0) -> bytes:
    """From an agent of one neighbour, as agent 1 of paper7 is."""
    return encode_input(t, struct.pack("<d", value), struct.pack("<2d", value, 0), bytes([3]))


def state(t: int, value: float = 1.0, m: int = 3) -> bytes:
    return encode_state(t, struct.pack("<d", value), bytes([7] * m))


FLOOD = 100_000
FLOOD_S = 1.5


class Victim:
    """paper7 after its first hundred slow steps, waiting during any disturbance; and a way into it."""

    def __init__(self, here: Path, stack: contextlib.ExitStack, *options: str) -> None:
        self._here, self._stack = here, stack
        run = ("up", "paper7", *QUIET, "--steps", str(STEPS), "--rate", "10", *options)
        self.network = stack.enter_context(Orchestrator(*run))
        self.network.wait_for("running")
        self.network.wait_for_step(5)
        assert orchestrator("step", "100").returncode == 0
        self.entry = json.loads(orchestrator("ps", "--json").stdout)[0]

    def rogue(self, name: str) -> zenoh.Session:
        """The intruder uses the keys of a process, if the run has keys."""
        own = self.entry["credentials"]
        credentials = Path(own).parent / name if own else None
        session = open_client(self.entry["endpoint"], self.entry["namespace"], credentials)
        self._stack.callback(close, session)
        return session

    def step(self) -> int:
        """The one that it is at."""
        return int(json.loads(orchestrator("status", "--json").stdout)["step"])

    def wait_for_refusal(self, name: str, key: str) -> None:
        self.network.wait_for_log(name, f"{key}: refused")

    @property
    def run(self) -> Path:
        return self._here / "runs/latest"

    def verdict(self) -> dict[str, Any]:
        """Its verdict, once it made its last step."""
        assert orchestrator("rate", "0").returncode == 0
        assert orchestrator("resume").returncode == 0
        self.network.wait()
        verdict: dict[str, Any] = json.loads((self.run / "verdict.json").read_text())
        return verdict

    def end(self) -> dict[str, Any]:
        """Return the verdict; the numbers must be those of an undisturbed run."""
        verdict = self.verdict()
        reference = orchestrator("simulate", "paper7", "--steps", str(STEPS), "--no-record", "--run-dir", "reference")
        assert reference.returncode == 0
        assert parquet_bytes(self.run) == parquet_bytes(self._here / "reference"), self.network.output
        return verdict

    def named(self) -> Counter[str]:
        """Count the keys of refused messages in the logs of all processes."""
        logs = (self.run / "logs").glob("*.log")
        lines = [line for log in logs for line in log.read_text().splitlines() if ": refused: " in line]
        return Counter(line.split(" wire: ")[1].split(": refused")[0] for line in lines)


@pytest.fixture
def victim(here: Path) -> Iterator[Callable[..., Victim]]:
    with contextlib.ExitStack() as stack:
        yield lambda *options: Victim(here, stack, *options)


def test_a_stolen_certificate_gives_only_the_rights_of_its_agent(victim: Callable[..., Victim]) -> None:
    """The certificate is that of agent 1, with agent 2 as its only neighbour.

    The router drops all other messages, and the agent's own channels refuse garbage.

    The intruder forges, replays, floods, eavesdrops, claims lives and sends commands; the run continues unchanged, and
    is valid.
    """
    running = victim("--secure")
    rogue = running.rogue("agent-1")
    overheard: list[str] = []
    eavesdropper = rogue.declare_subscriber(
        "**",
        lambda sample: overheard.append(str(sample.key_expr)),
        allowed_origin=zenoh.Locality.REMOTE,
    )
    own = {*RIGHTS["agent-1"].publishes}
    flood = rogue.declare_publisher(keys.link(1, 2), congestion_control=zenoh.CongestionControl.BLOCK)
    for _ in range(FLOOD):
        flood.put(link(0))
    for key in [*KEYS, *WILD]:
        if key not in own:
            for good in (link(100), input_(100), state(100), state(100, m=1)):
                put(rogue, key, good)
    tokens = [rogue.liveliness().declare_token(keys.alive(keys.shard_name(p), 5)) for p in range(1, N)]
    for command in keys.COMMANDS:
        assert not [reply for reply in rogue.get(keys.control(command), payload=b"{}", timeout=1.0) if reply.ok]
    slowly = threading.Event()
    for key, good in ((keys.link(0, 1), link(0)), (keys.input_(0), input_(0))):
        for bad in garbage(good):
            put(rogue, key, bad)
            slowly.wait(100 / MOST_PER_S)
    running.wait_for_refusal("agent-2", keys.link(0, 1))
    running.wait_for_refusal("plant", keys.input_(0))
    close(rogue)
    verdict = running.end()
    assert verdict["verdict"] == "valid", verdict["reasons"]
    assert set(overheard) <= {keys.link(1, 0), keys.state(0)}
    refused = {one["key"]: one["refused"] for one in verdict["information"]["channels"] if one["refused"]}
    # The router accepts from an agent neither a message of 16 MB nor, on a busy machine, one right after another.
    assert refused.keys() == {keys.link(0, 1), keys.input_(0)}
    assert max(refused.values()) <= 9
    assert running.named() == {keys.link(0, 1): 1, keys.input_(0): 1}
    del eavesdropper, tokens


def test_the_audit_finds_false_messages_under_a_stolen_certificate(victim: Callable[..., Victim]) -> None:
    """These are valid inputs of this step and of the next that agent 1 never sent; one that is NaN counts as
    missing.
    """
    running = victim("--secure")
    rogue = running.rogue("agent-1")
    now, slowly = running.step(), threading.Event()
    for t in (now - 1, now, now + 1, now + 1000):
        for value in (float("nan"), float("inf"), 1e300):
            put(rogue, keys.link(0, 1), link(t, value))
            put(rogue, keys.input_(0), input_(t, value))
            slowly.wait(100 / MOST_PER_S)
    close(rogue)
    verdict = running.verdict()
    wrong = " ".join(verdict["checks"]["information"]["why"])
    assert verdict["verdict"] == "INVALID"
    assert "agent-2 received" in wrong
    assert "messages on link/0/1, but agent-1 sent" in wrong
    assert "messages on input/0, but agent-1 sent" in wrong
    assert verdict["steps_done"] == STEPS
    assert np.isfinite(load_run(running.run).x).all()


def test_flooding_of_its_own_channels_delays_no_process(victim: Callable[..., Victim]) -> None:
    """The intruder sends as many messages as possible on each channel, and one of 64 MB, during the run: few get
    through.

    No agent is late, no edge is closed, no memory grows; an invalid message is refused, and named once.
    """
    running = victim("--secure")
    rogue = running.rogue("agent-1")
    assert orchestrator("rate", "4").returncode == 0
    assert orchestrator("resume").returncode == 0
    before, began, sent = running.step(), time.monotonic(), 0
    for key in (keys.link(0, 1), keys.input_(0)):
        flood = rogue.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        flood.put(bytes(64 * 2**20))
        until = time.monotonic() + FLOOD_S
        while time.monotonic() < until:
            flood.put(b"")
            sent += 1
    running.wait_for_refusal("agent-2", keys.link(0, 1))
    running.wait_for_refusal("plant", keys.input_(0))
    steps, took_s = running.step() - before, time.monotonic() - began
    assert orchestrator("pause").returncode == 0
    assert steps >= took_s, f"{steps} steps in {took_s:.1f} s, and 4 are due in one"
    sizes = {name: psutil.Process(pid).memory_info().rss for name, pid in running.network.children.items()}
    assert max(sizes.values()) < 100e6, sizes
    close(rogue)
    verdict = running.end()
    assert verdict["verdict"] == "valid", verdict["reasons"]
    assert verdict["missing_inputs"] == 0
    refused = {one["key"]: one["refused"] for one in verdict["information"]["channels"] if one["refused"]}
    assert refused.keys() == {keys.link(0, 1), keys.input_(0)}
    assert max(refused.values()) < min(MOST_PER_S * took_s, sent / 2)
    assert running.named() == {keys.link(0, 1): 1, keys.input_(0): 1}


def test_on_an_open_router_garbage_changes_nothing_and_the_audit_finds_forged_messages(
    victim: Callable[..., Victim],
) -> None:
    """Without security, any client may publish on any key.

    Garbage is refused; the past and the far future have no effect.

    But a process that accepted a message which its neighbour never sent received a forged one, and the verdict reports
    this.
    """
    running = victim()
    rogue = running.rogue("")
    for key, good in ((keys.link(0, 1), link(0)), (keys.input_(0), input_(0)), (keys.state(1), state(0))):
        for bad in garbage(good):
            for _ in range(1 if len(bad) > 1000 else 100):
                put(rogue, key, bad)
    put(rogue, keys.SEEN, b"?")
    put(rogue, keys.TELEMETRY, b"?")
    rogue.delete(keys.link(0, 1))
    tokens = [
        rogue.liveliness().declare_token(f"alive/{name}") for name in ("shard-x/0", "shard-99/0", "shard-0/-1", "x")
    ]
    for key in ("link/*/1", "input/*", "**"):
        put(rogue, key, link(1))
    for value in (1.0, float("nan"), float("inf")):
        put(rogue, keys.link(0, 1), link(0, value))  # the past
        put(rogue, keys.input_(0), input_(0, value))
        put(rogue, keys.state(1), state(0, value))
        put(rogue, keys.link(0, 1), link(STEPS + 1000, value))  # the future
        put(rogue, keys.input_(0), input_(STEPS + 1000, value))
        put(rogue, keys.state(1), state(STEPS + 1000, value))
    for t in range(10_000):
        put(rogue, keys.link(3, 1), link(STEPS + t))
    running.wait_for_refusal("agent-2", keys.state(1))
    close(rogue)
    verdict = running.end()
    assert verdict["verdict"] == "INVALID"
    wrong = " ".join(verdict["checks"]["information"]["why"])
    assert all(check["ok"] for name, check in verdict["checks"].items() if name != "information")
    for who, key in (
        ("agent-2", keys.link(0, 1)),
        ("agent-2", keys.link(3, 1)),
        ("agent-2", keys.state(1)),
        ("plant", keys.input_(0)),
    ):
        assert f"{who} received" in wrong
        assert f"messages on {key}, but" in wrong
    assert "which no process uses" in wrong
    assert verdict["reasons"][0].startswith("information fails: ")
    assert max(running.named().values()) <= N + 1
    del tokens
