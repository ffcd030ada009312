"""Zenoh sessions as the loop wants them: no scouting, no clock, messages that are never dropped on purpose."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import zenoh

from topologies.errors import DeadlineError, HedgerowError

MAX_SESSIONS = 100_000
CONNECT_TIMEOUT_S = 10.0
LISTEN_TIMEOUT_S = 60.0


class WireError(HedgerowError):
    """A session that could not be opened, or a peer that never came."""


def _config(namespace: str | None, settings: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    quiet: dict[str, object] = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": False,
        "transport/shared_memory/enabled": False,
        # All messages are of one priority: a queue for each of eight costs time and memory.
        "transport/unicast/qos/enabled": False,
    }
    if namespace is not None:
        quiet |= {"namespace": namespace}
    for key, value in (quiet | settings).items():
        config.insert_json5(key, json.dumps(value))
    return config


def open_router(endpoint: str, namespace: str | None = None) -> zenoh.Session:
    """A router that listens on `endpoint`, inside this process, whose own keys stand under `namespace`.

    Raises WireError.
    """
    try:
        return zenoh.open(
            _config(
                namespace,
                {
                    "mode": "router",
                    "listen/endpoints": [endpoint],
                    "transport/unicast/max_sessions": MAX_SESSIONS,
                    # Half a second before it opens, to hear of others: there are none.
                    "scouting/delay": 0,
                },
            )
        )
    except zenoh.ZError as error:
        raise WireError(f"no router on {endpoint}: {error}") from None


def remove_socket(socket: Path) -> None:
    """Remove what a router that was killed leaves of its Unix socket, if anything."""
    for path in (socket, Path(f"{socket}.lock")):
        path.unlink(missing_ok=True)


def open_client(endpoint: str, namespace: str, timeout_s: float = CONNECT_TIMEOUT_S) -> zenoh.Session:
    """A client of the router at `endpoint`; its keys stand under `namespace`. Raises WireError past `timeout_s`."""
    settings: dict[str, object] = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": int(timeout_s * 1000),
        "connect/exit_on_failure": True,
        # A router that begins or comes back finds its clients there at once, or within half a second.
        "connect/retry": {"period_init_ms": 10, "period_max_ms": 500, "period_increase_factor": 2},
    }
    try:
        return zenoh.open(_config(namespace, settings))
    except zenoh.ZError as error:
        raise WireError(f"no router at {endpoint} after {timeout_s:g} s: {error}") from None


def close(session: zenoh.Session) -> None:
    """Leave the network; one that does not answer any more is left without a word."""
    with contextlib.suppress(zenoh.ZError):
        session.close()  # type: ignore[no-untyped-call]


def publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """A publisher of the loop: reliable, in order, and it waits rather than drops.

    Not express: messages that leave together travel in one packet, which makes the loop half as fast again.
    """
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        reliability=zenoh.Reliability.RELIABLE,
        express=False,
    )


def wait_for_listeners(publishers: Sequence[zenoh.Publisher], timeout_s: float = LISTEN_TIMEOUT_S) -> None:
    """Return once every publisher has a subscriber, so that nothing said from now on is lost.

    Raises DeadlineError past `timeout_s`.
    """
    heard = threading.Event()

    def on_change(_: zenoh.MatchingStatus) -> None:
        heard.set()

    listener = zenoh.handlers.Callback(on_change, indirect=False)
    for one in publishers:
        with one.declare_matching_listener(listener):
            while not _has_listener(one):
                if not heard.wait(timeout_s):
                    raise DeadlineError(
                        f"nobody listens on {one.key_expr} after {timeout_s:g} s; see that process's log"
                    )
                heard.clear()


def _has_listener(one: zenoh.Publisher) -> bool:
    # Its type is said to be bool, yet it is an object that is always true.
    status: Any = one.matching_status
    return bool(status.matching)


def subscriber(session: zenoh.Session, key: str, take: Callable[[bytes], None]) -> zenoh.Subscriber[None]:
    """Call `take(payload)` for each message, on the network thread: it must not wait for anything."""

    def on_sample(sample: zenoh.Sample) -> None:
        take(sample.payload.to_bytes())

    return session.declare_subscriber(key, zenoh.handlers.Callback(on_sample, indirect=False))
