"""Zenoh sessions as the loop wants them: no scouting, no clock, messages that are never dropped on purpose."""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import shutil
import socket
import threading
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from topologies.errors import DeadlineError, HedgerowError
from wire.codec import MessageError

LOG = logging.getLogger("wire")
MAX_SESSIONS = 100_000
CONNECT_TIMEOUT_S = 10.0
LISTEN_TIMEOUT_S = 60.0
PRIVATE_KEY, CERTIFICATE, CA, ACCESS = "key.pem", "cert.pem", "ca.pem", "access.json"
"""What the credentials of a process are, file by file; the rules are the router's."""
STRANGE_KEYS = 16
"""how many keys are remembered that should not have been heard of"""


class WireError(HedgerowError):
    """A session that could not be opened, or a peer that never came."""


def base_settings() -> dict[str, object]:
    """What all sessions are opened with."""
    return {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": False,
        "transport/shared_memory/enabled": False,
        # All messages are of one priority: a queue for each of eight costs time and memory.
        "transport/unicast/qos/enabled": False,
    }


def _config(namespace: str | None, settings: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    own = {} if namespace is None else {"namespace": namespace}
    for key, value in (base_settings() | own | settings).items():
        config.insert_json5(key, json.dumps(value))
    return config


def tls(side: str, credentials: Path) -> dict[str, object]:
    """Settings of a link whose two ends show each other a certificate; `side` is `listen` or `connect`."""
    return {
        "root_ca_certificate": str(credentials / CA),
        f"{side}_private_key": str(credentials / PRIVATE_KEY),
        f"{side}_certificate": str(credentials / CERTIFICATE),
        "enable_mtls": True,
        "verify_name_on_connect": True,
    }


def router_settings(endpoint: str, credentials: Path | None = None, access: object = None) -> dict[str, object]:
    """The settings of the router of a run: with `credentials` it lets nobody in but as `access` says."""
    settings: dict[str, object] = {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "transport/unicast/max_sessions": MAX_SESSIONS,
        # Half a second before it opens, to hear of others: there are none.
        "scouting/delay": 0,
    }
    if credentials is not None:
        settings |= {"transport/link/tls": tls("listen", credentials), "access_control": access}
    return settings


def open_router(endpoint: str, namespace: str | None = None, credentials: Path | None = None) -> zenoh.Session:
    """A router that listens on `endpoint`, inside this process, whose own keys stand under `namespace`.

    With `credentials`, a folder with its certificate and the rules of access, it is the router of a secure run.
    Raises WireError.
    """
    access = json.loads((credentials / ACCESS).read_text(encoding="utf-8")) if credentials is not None else None
    try:
        return zenoh.open(_config(namespace, router_settings(endpoint, credentials, access)))
    except zenoh.ZError as error:
        raise WireError(f"no router on {endpoint}: {error}") from None


def remove_socket(socket: Path) -> None:
    """Remove what a router that was killed leaves of its Unix socket, if anything."""
    for path in (socket, Path(f"{socket}.lock")):
        path.unlink(missing_ok=True)


def free_port() -> int:
    """A TCP port of this machine that nobody uses, and that the kernel gives to nobody else for a minute.

    A connection that was closed on it keeps it out of the kernel's choice (TIME_WAIT); who asks for it by its number
    gets it.
    """
    with socket.create_server(("127.0.0.1", 0)) as listener:
        with socket.create_connection(listener.getsockname()):
            listener.accept()[0].close()
        return int(listener.getsockname()[1])


def remove_secrets(folder: Path) -> None:
    """Remove the certificates and private keys of a run, if they are there."""
    shutil.rmtree(folder, ignore_errors=True)


def open_client(
    endpoint: str, namespace: str, credentials: Path | None = None, timeout_s: float = CONNECT_TIMEOUT_S
) -> zenoh.Session:
    """A client of the router at `endpoint`; its keys stand under `namespace`. Raises WireError past `timeout_s`.

    With `credentials`, a folder with its certificate, it shows that and demands the router's.
    """
    settings: dict[str, object] = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": int(timeout_s * 1000),
        "connect/exit_on_failure": True,
        # A router that begins or comes back finds its clients there at once, or within half a second.
        "connect/retry": {"period_init_ms": 10, "period_max_ms": 500, "period_increase_factor": 2},
    }
    if credentials is not None:
        settings["transport/link/tls"] = tls("connect", credentials)
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


class Voice:
    """A publisher that counts what it said."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.key, self.said = key, 0
        self.publisher = publisher(session, key)
        self._put = self.publisher.put

    def put(self, message: bytes) -> None:
        """Say it."""
        self.said += 1
        self._put(message)


Mail = queue.SimpleQueue[Callable[[], None]]
"""Work that the network thread leaves to another."""


class Ear:
    """A subscriber that counts what it heard; `take` raises MessageError for what is no message of its key."""

    def __init__(
        self, session: zenoh.Session, key: str, take: Callable[[bytes], None], mail: Mail | None = None
    ) -> None:
        """`take` is called on the network thread, where it must not wait; or by who takes things out of `mail`."""
        self.key, self.heard, self.refused = key, 0, 0
        self.strange: dict[str, int] = {}
        """messages that came on another key, which has a `*` in it: nobody of the run speaks so"""
        self._take = take
        on_sample = self._on_sample if mail is None else lambda sample: mail.put(partial(self._on_sample, sample))
        self._declared = session.declare_subscriber(key, zenoh.handlers.Callback(on_sample, indirect=False))

    def _on_sample(self, sample: zenoh.Sample) -> None:
        if (key := str(sample.key_expr)) != self.key:
            if not self.strange:
                LOG.warning("%s: refused: a message on %s, which is no key of the run", self.key, key)
            if key in self.strange or len(self.strange) < STRANGE_KEYS:
                self.strange[key] = self.strange.get(key, 0) + 1
            return
        try:
            self._take(sample.payload.to_bytes())
        except MessageError as error:
            self.refused += 1
            if self.refused == 1:
                LOG.warning("%s: refused: %s", self.key, error)
        else:
            self.heard += 1


def counts(voices: Iterable[Voice], ears: Iterable[Ear]) -> dict[str, dict[str, int]]:
    """What a process said, heard, refused and should not have been told, by key."""
    ears = list(ears)
    return {
        "said": {voice.key: voice.said for voice in voices},
        "heard": {ear.key: ear.heard for ear in ears},
        "refused": {ear.key: ear.refused for ear in ears if ear.refused},
        "strange": {key: number for ear in ears for key, number in ear.strange.items()},
    }
