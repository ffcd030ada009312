"""The Zenoh sessions of the loop: no scouting, no clock, and messages that are never dropped on purpose."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, cast

import zenoh

from hedgerow.topologies.errors import Code, DeadlineError, HedgerowError, UserError
from hedgerow.topologies.escape import escape
from hedgerow.topologies.json_file import read_json
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.limits import limit_in, limits_now
from hedgerow.wire.message import MessageError
from hedgerow.wire.runtime import KEPT, keep_thread

LOG = logging.getLogger("wire")
MAX_SESSIONS = 100_000
MOST_PORT = 65535
CONNECT_TIMEOUT_S = 10.0
OPEN_TIMEOUT_S = 15.0
"""The longest time for opening a session, in addition to the timeout of Zenoh [s]."""
LEASE_S = 30.0
"""The silence after which a process counts as gone, if nothing else reports it earlier [s]."""
LOOK_S, MOST_LOOK_S = 2.0, 30.0
"""The wait for a secure router before a check whether it refuses us [s]: the first, and the longest."""
MOST_SAID = 200
"""The maximum length of a message from Zenoh that is shown. The cause is at its end."""
PAUSE_S = 0.05
"""The time between two tries [s]."""
LISTEN_TIMEOUT_S = 60.0
ACCESS = "access.json"
"""The rules of access, beside the credentials of the router."""
STRANGE_KEYS = 16
"""The maximum number of unexpected keys that are counted."""


class WireError(HedgerowError):
    """A session that did not open, or a peer that did not arrive."""

    default_code = Code.WIRE


class RefusedError(WireError):
    """A refusal by the router, or by us of the router. Waiting does not help."""

    default_code = Code.REFUSED


def check_endpoint(endpoint: str, option: str = "--router") -> None:
    """Raise UserError for a text that is not a Zenoh endpoint, or not one that a client can connect to (`--router`)."""
    try:
        zenoh.Config().insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError:
        raise UserError(
            f"{option} {endpoint}: is no endpoint; write tcp/HOST:PORT, or tls/HOST:PORT", code=Code.OPTION
        ) from None
    port = endpoint.partition("#")[0].partition("?")[0].rpartition(":")[2]
    if endpoint.startswith(("tcp/", "tls/")) and not (re.fullmatch("[0-9]+", port) and 1 <= int(port) <= MOST_PORT):
        raise UserError(f"{option} {endpoint}: write a port from 1 to {MOST_PORT} after the host", code=Code.OPTION)
    if option == "--router" and endpoint.startswith("tls/["):  # Zenoh reports "invalid dns name" and tries forever
        raise UserError(
            f"{option} {endpoint}: Zenoh takes no IPv6 address for the name in a certificate; write a name",
            code=Code.OPTION,
        )


def check_namespace(namespace: str) -> None:
    """Raise UserError for a namespace that cannot prefix a key."""
    if escape(namespace, keep="") != namespace:
        raise UserError(f"--namespace {namespace}: holds control characters. Remove them.", code=Code.OPTION)
    try:
        wild = "*" in str(zenoh.KeyExpr(namespace))
    except zenoh.ZError:
        wild = True
    if wild:
        raise UserError(
            f"--namespace {namespace}: is no key of Zenoh's; write words with / between, without * $ ? and #"
        )


def base_settings() -> dict[str, object]:
    """Return the settings that all sessions share."""
    return {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": False,
        "transport/shared_memory/enabled": False,
        # TCP looks for an unplugged cable after 6, 13 and 25 s. A session that ends earlier loses messages.
        "transport/link/tx/lease": int(1000 * LEASE_S),
        # All messages have one priority. Eight queues, one for each priority, would cost time and memory.
        "transport/unicast/qos/enabled": False,
    }


def _config(namespace: str | None, settings: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    own = {} if namespace is None else {"namespace": namespace}
    for key, value in (base_settings() | own | settings).items():
        config.insert_json5(key, json.dumps(value))
    return config


def router_settings(
    endpoint: str, tls: Mapping[str, object] | None = None, rules: Mapping[str, object] | None = None
) -> dict[str, object]:
    """Return the settings of the router of a run.

    With `tls` it has credentials, and accepts only clients that the `rules` of wire.access allow.
    """
    settings: dict[str, object] = {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "transport/unicast/max_sessions": MAX_SESSIONS,
        # The router would wait half a second for other routers before it opens; there are none.
        "scouting/delay": 0,
    }
    if tls is not None:
        settings |= {"transport/link/tls": dict(tls), **(rules or {})}
    return settings


def open_router(endpoint: str, namespace: str | None = None, credentials: Path | None = None) -> zenoh.Session:
    """Open a router in this process that listens on `endpoint`; its own keys have the prefix `namespace`.

    With `credentials`, a folder with its certificate and the rules of access, it is the router of a secure run.
    Raises WireError.
    """
    tls = rules = None
    if credentials is not None:
        rules = _rules_in(credentials)
        tls = Credentials.read(credentials).router_tls()
        from hedgerow.wire.refusal import log_refusals  # noqa: PLC0415

        log_refusals()
    try:
        return _open_aside(_config(namespace, router_settings(endpoint, tls, rules)), OPEN_TIMEOUT_S)
    except zenoh.ZError as error:
        raise WireError(f"no router on {endpoint}: {_why(error)}") from None


def _rules_in(credentials: Path) -> Mapping[str, object]:
    """Return the access rules of the router of a secure run; raise UserError if there are none.

    Without rules, every client could read and write everything.
    """
    whole = "give the complete folder `router` with --credentials"
    try:
        rules: Any = read_json(credentials / ACCESS)
    except (OSError, UserError) as error:
        why = getattr(error, "strerror", None) or error
        raise WireError(f"{credentials}: no keys of a router: {ACCESS}: {why}; {whole}") from None
    control = rules.get("access_control") if isinstance(rules, dict) else None
    if not (
        isinstance(control, dict) and control.get("enabled") is True and control.get("default_permission") == "deny"
    ):
        raise UserError(
            f"{credentials / ACCESS}: permits messages outside its rules (`access_control`); {whole}",
            code=Code.FILE_FORMAT,
        )
    return cast("Mapping[str, object]", rules)


def remove_trace(path: Path | str) -> None:
    """Remove a file or folder that must not outlive a run, if it exists: its socket, its private keys."""
    with contextlib.suppress(OSError):
        Path(path).unlink()
    # Anything but a folder was unlinked above. If that failed, rmtree would open it, and would wait for the writer of a
    # FIFO.
    if Path(path).is_dir() and not Path(path).is_symlink():
        shutil.rmtree(path, ignore_errors=True)


def open_client(
    endpoint: str, namespace: str, credentials: Credentials | Path | None = None, timeout_s: float = CONNECT_TIMEOUT_S
) -> zenoh.Session:
    """Open a client of the router at `endpoint`; its keys have the prefix `namespace`.

    Raise UserError for an invalid endpoint, RefusedError if the certificates do not fit, WireError after `timeout_s`.
    With `credentials`, or the folder that holds them, it shows its certificate and demands the router's.
    """
    check_endpoint(endpoint)
    if isinstance(credentials, Path):
        credentials = Credentials.read(credentials)
    settings: dict[str, object] = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/exit_on_failure": True,
        # When a router starts or returns, its clients reconnect at once or within half a second.
        "connect/retry": {"period_init_ms": 10, "period_max_ms": 500, "period_increase_factor": 2},
    }
    if credentials is not None:
        if not endpoint.startswith("tls/"):
            raise RefusedError(f"--router {endpoint}: a secure network needs a router that speaks TLS: tls/HOST:PORT")
        settings["transport/link/tls"] = credentials.tls()
    by = time.monotonic() + timeout_s
    patience_s = timeout_s if credentials is None else LOOK_S
    while True:
        left = max(0.0, by - time.monotonic())
        settings["connect/timeout_ms"] = int(1000 * min(left, patience_s))
        try:
            return _open_aside(_config(namespace, settings), patience_s + OPEN_TIMEOUT_S)
        except zenoh.ZError as error:
            patience_s = min(2 * patience_s, MOST_LOOK_S)
            # Zenoh would try until the timeout, even if the router refuses our certificate.
            if credentials is not None and (why := _refusal(endpoint, credentials)) is not None:
                raise RefusedError(f"{why}; take keys that were made together with the router's") from None
            if time.monotonic() >= by:
                raise WireError(f"no router at {endpoint} after {timeout_s:g} s: {_why(error)}") from None
            time.sleep(PAUSE_S)  # some mistakes fail at once on every try


def _open_aside(config: zenoh.Config, timeout_s: float) -> zenoh.Session:
    """Open a session on a separate thread. Zenoh would block the main thread, which handles the signals.

    Several short tries would never reach a router that is slow to answer. Raises HedgerowError past `timeout_s`: at a
    limit of the machine, a thread of Zenoh can end so that its open never returns.
    """
    opened: SimpleQueue[zenoh.Session | BaseException] = SimpleQueue()

    def open_it() -> None:
        try:
            opened.put(zenoh.open(config))
        except BaseException as error:  # a panic is no Exception
            opened.put(error)

    threading.Thread(target=open_it, name="open", daemon=True).start()
    try:
        result = opened.get(timeout=timeout_s)
    except Empty:
        raise HedgerowError(
            f"Zenoh opened no session within {timeout_s:g} s. {limits_now()}", code=Code.LIMIT
        ) from None
    if isinstance(result, BaseException):
        raise result
    return result


def _why(error: zenoh.ZError) -> str:
    """Return the cause in a message from Zenoh, in one line, without positions in its source code."""
    if (limit := limit_in(str(error))) is not None:
        return limit
    words = re.sub(r"\s+at /\S+\.rs:\d+\b\.?", "", str(error))
    # Zenoh puts the cause last, after a description of its action.
    sent = " ".join(words.split())
    return sent if len(sent) <= MOST_SAID else f"…{sent[-MOST_SAID:]}"


def _refusal(endpoint: str, credentials: Credentials) -> str | None:
    from hedgerow.wire.refusal import refusal  # noqa: PLC0415

    return refusal(endpoint, credentials)


def has_router(session: zenoh.Session) -> bool:
    """Return True if a client is connected to its router; a client keeps trying to reconnect."""
    return bool(session.info.routers_zid())


def close(session: zenoh.Session) -> None:
    """Close the session; abandon it silently if it does not answer."""
    with contextlib.suppress(zenoh.ZError):
        session.close()  # type: ignore[no-untyped-call]


def publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Return a publisher of the loop: reliable, in order; it waits instead of dropping messages.

    It is not express: messages that leave together share one packet, which makes the loop 1.5 times as fast.
    """
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        reliability=zenoh.Reliability.RELIABLE,
        express=False,
    )


def wait_for_listeners(publishers: Sequence[zenoh.Publisher], timeout_s: float = LISTEN_TIMEOUT_S) -> None:
    """Wait until every publisher has a subscriber. From then on no message is lost.

    Raises DeadlineError if one has none `timeout_s` from now.
    """
    received, by = threading.Event(), time.monotonic() + timeout_s

    def on_change(_: zenoh.MatchingStatus) -> None:
        received.set()

    listener = direct(on_change)
    for one in publishers:
        with one.declare_matching_listener(listener):
            while not _has_listener(one):
                if not received.wait(max(0.0, by - time.monotonic())):
                    raise DeadlineError(
                        f"{one.key_expr} has no subscriber after {timeout_s:g} s; see that process's log"
                    )
                received.clear()


def _has_listener(one: zenoh.Publisher) -> bool:
    # Its declared type is bool, but it is an object that is always true.
    status: Any = one.matching_status
    return bool(status.matching)


def direct(take: Callable[[Any], None]) -> zenoh.handlers.Callback[Any]:
    """Return a handler that calls `take` on the network thread, where `take` must not block."""

    def on_network(what: Any) -> None:
        keep_thread()
        take(what)

    return zenoh.handlers.Callback(on_network, indirect=False)


def subscriber(session: zenoh.Session, key: str, take: Callable[[bytes], None]) -> zenoh.Subscriber[None]:
    """Call `take(payload)` for each message on the network thread; `take` must not block."""
    return session.declare_subscriber(key, direct(lambda sample: take(sample.payload.to_bytes())))


class Sender:
    """A publisher that counts its messages; equal messages in a row count once, as at a Receiver."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.key, self.sent = key, 0
        self.publisher = publisher(session, key)
        self._put = self.publisher.put
        self._last: bytes | None = None

    def put(self, message: bytes) -> None:
        """Send the message and count it."""
        if message != self._last:
            self.sent += 1
            self._last = message
        self._put(message)


class Receiver:
    """A subscriber that counts its messages; `take` raises MessageError for a message that is not valid on its key.

    Equal messages in a row count once: Zenoh sometimes delivers each message twice, and a copy has nothing new.
    """

    def __init__(self, session: zenoh.Session, key: str, take: Callable[[bytes], None]) -> None:
        """Subscribe to `key`; `take` is called on the network thread and must not block."""
        self.key, self.received, self.refused = key, 0, 0
        self.strange: dict[str, int] = {}
        """the number of messages by unexpected keys; such a key contains a `*`, which no process of a run uses"""
        own = zenoh.KeyExpr(key)
        last: bytes | None = None

        def on_sample(sample: zenoh.Sample) -> None:
            nonlocal last
            # One function for what every message needs: a call more costs as much as the copy of a payload.
            if not hasattr(KEPT, "here"):
                keep_thread()
            if sample.key_expr != own:
                self._refuse_key(str(sample.key_expr))
                return
            message = sample.payload.to_bytes()
            try:
                take(message)
            except MessageError as error:
                self._refuse(error)
            else:
                if message != last:
                    self.received += 1
                    last = message

        self._declared = session.declare_subscriber(key, zenoh.handlers.Callback(on_sample, indirect=False))

    def close(self) -> None:
        """Stop receiving messages."""
        with contextlib.suppress(zenoh.ZError):  # the session may be closed
            self._declared.undeclare()  # type: ignore[no-untyped-call]

    def _refuse_key(self, key: str) -> None:
        if not self.strange:
            LOG.warning("%s: refused: a message on %s, which is no key of the run", self.key, key)
        if key in self.strange or len(self.strange) < STRANGE_KEYS:
            self.strange[key] = self.strange.get(key, 0) + 1

    def _refuse(self, error: MessageError) -> None:
        self.refused += 1
        if self.refused == 1:
            LOG.warning("%s: refused: %s", self.key, error)


def counts(senders: Iterable[Sender], receivers: Iterable[Receiver]) -> dict[str, dict[str, int]]:
    """Return the message counts of a process by key: sent, received, refused, and on unexpected keys."""
    receivers = list(receivers)
    return {
        "sent": {sender.key: sender.sent for sender in senders},
        "received": {receiver.key: receiver.received for receiver in receivers},
        "refused": {receiver.key: receiver.refused for receiver in receivers if receiver.refused},
        "strange": {key: number for receiver in receivers for key, number in receiver.strange.items()},
    }
