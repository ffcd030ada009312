"""Processes that violate the information structure of a network that runs: their attempts, and the results."""

from __future__ import annotations

import contextlib
import json
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import zenoh

from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.wire import keys
from hedgerow.wire.access import MOST_PER_S
from hedgerow.wire.codec import VERSION, encode_input, encode_link, encode_state
from hedgerow.wire.message import Link
from hedgerow.wire.session import close, open_client
from tests.tools.processes import QUIET, Orchestrator, orchestrator, parquet_bytes
from tests.tools.rights import KEYS, RIGHTS, WILD, N
from tests.tools.verdicts import verdict_of

STEPS = 300


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
        return verdict_of(self.run)

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
