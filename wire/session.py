"""Zenoh sessions as the loop wants them: no scouting, no clock, messages that are never dropped on purpose."""

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
from hedgerow.wire.codec import MessageError
from hedgerow.wire.credentials import Credentials, router_tls
from hedgerow.wire.limits import limit_in, limits_now
from hedgerow.wire.runtime import keep_thread

LOG = logging.getLogger("wire")
MAX_SESSIONS = 100_000
MOST_PORT = 65535
CONNECT_TIMEOUT_S = 10.0
OPEN_TIMEOUT_S = 15.0
"""How long Zenoh may take for a session, besides its own timeout."""
LEASE_S = 30.0
"""How long a process may be silent before the others take it for gone, if nothing else says so."""
LOOK_S, MOST_LOOK_S = 2.0, 30.0
"""How long a secure router is tried before a look at whether it refuses us: at first, and at most."""
MOST_SAID = 200
"""Letters of what Zenoh says that are shown; the cause comes last."""
PAUSE_S = 0.05
"""Between two tries."""
LISTEN_TIMEOUT_S = 60.0
ACCESS = "access.json"
"""The rules of access, beside the credentials of the router."""
STRANGE_KEYS = 16
"""how many keys are remembered that should not have been heard of"""


class WireError(HedgerowError):
    """A session that could not be opened, or a peer that never arrived."""

    default_code = Code.WIRE


class RefusedError(WireError):
    """A router that will not have us, or that we will not have: to wait does not help."""

    default_code = Code.REFUSED


def check_endpoint(endpoint: str, option: str = "--router") -> None:
    """Raise UserError for what is no endpoint of Zenoh's, or none that a client could connect to (`--router`)."""
    try:
        zenoh.Config().insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError:
        raise UserError(
            f"{option} {endpoint}: is no endpoint; write tcp/HOST:PORT, or tls/HOST:PORT", code=Code.OPTION
        ) from None
    port = endpoint.partition("#")[0].partition("?")[0].rpartition(":")[2]
    if endpoint.startswith(("tcp/", "tls/")) and not (re.fullmatch("[0-9]+", port) and 1 <= int(port) <= MOST_PORT):
        raise UserError(f"{option} {endpoint}: write a port from 1 to {MOST_PORT} after the host", code=Code.OPTION)
    if option == "--router" and endpoint.startswith("tls/["):  # "invalid dns name", and it would try for ever
        raise UserError(
            f"{option} {endpoint}: Zenoh takes no IPv6 address for the name in a certificate; write a name",
            code=Code.OPTION,
        )


def check_namespace(namespace: str) -> None:
    """Raise UserError for what keys cannot stand under."""
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
    """What all sessions are opened with."""
    return {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": False,
        "transport/shared_memory/enabled": False,
        # TCP looks for a cable that was pulled after 6, 13 and 25 s: a session that is given up before loses messages.
        "transport/link/tx/lease": int(1000 * LEASE_S),
        # All messages are of one priority: a queue for each of eight costs time and memory.
        "transport/unicast/qos/enabled": False,
    }


def _config(namespace: str | None, settings: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    own = {} if namespace is None else {"namespace": namespace}
    for key, value in (base_settings() | own | settings).items():
        config.insert_json5(key, json.dumps(value))
    return config


def router_settings(
    endpoint: str, credentials: Path | None = None, rules: Mapping[str, object] | None = None
) -> dict[str, object]:
    """The settings of the router of a run: with `credentials` it lets nobody in but by the `rules` of wire.access."""
    settings: dict[str, object] = {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "transport/unicast/max_sessions": MAX_SESSIONS,
        # Half a second before it opens, to hear of others: there are none.
        "scouting/delay": 0,
    }
    if credentials is not None:
        settings |= {"transport/link/tls": router_tls(credentials), **(rules or {})}
    return settings


def open_router(endpoint: str, namespace: str | None = None, credentials: Path | None = None) -> zenoh.Session:
    """A router that listens on `endpoint`, inside this process, whose own keys stand under `namespace`.

    With `credentials`, a folder with its certificate and the rules of access, it is the router of a secure run.
    Raises WireError.
    """
    rules = None
    if credentials is not None:
        rules = _rules_in(credentials)
        from hedgerow.wire.refusal import log_refusals  # noqa: PLC0415

        log_refusals()
    try:
        return _open_aside(_config(namespace, router_settings(endpoint, credentials, rules)), OPEN_TIMEOUT_S)
    except zenoh.ZError as error:
        raise WireError(f"no router on {endpoint}: {_why(error)}") from None


def _rules_in(credentials: Path) -> Mapping[str, object]:
    """What the router of a secure run keeps; one that kept nothing would let everybody in to everything."""
    whole = "take the folder `router`, whole, with --credentials"
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
            f"{credentials / ACCESS}: does not refuse what it does not allow (`access_control`); {whole}",
            code=Code.FILE_FORMAT,
        )
    return cast("Mapping[str, object]", rules)


def remove_trace(path: Path | str) -> None:
    """Remove what must not outlive a run, a file or a whole folder, if it is there: its socket, its private keys."""
    with contextlib.suppress(OSError):
        Path(path).unlink()
    # What is no folder was unlinked above. If that failed, rmtree would open it, and wait for a FIFO's writer.
    if Path(path).is_dir() and not Path(path).is_symlink():
        shutil.rmtree(path, ignore_errors=True)


def open_client(
    endpoint: str, namespace: str, credentials: Credentials | Path | None = None, timeout_s: float = CONNECT_TIMEOUT_S
) -> zenoh.Session:
    """A client of the router at `endpoint`; its keys stand under `namespace`.

    Raises UserError for what is no endpoint, RefusedError where certificates do not fit, WireError past `timeout_s`.
    With `credentials`, or the folder where they lie, it shows its certificate and demands the router's.
    """
    check_endpoint(endpoint)
    if isinstance(credentials, Path):
        credentials = Credentials.read(credentials)
    settings: dict[str, object] = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/exit_on_failure": True,
        # A router that begins or comes back finds its clients there at once, or within half a second.
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
            # Zenoh would try until the time is over, whatever the router thinks of our certificate.
            if credentials is not None and (why := _refusal(endpoint, credentials)) is not None:
                raise RefusedError(f"{why}; take keys that were made together with the router's") from None
            if time.monotonic() >= by:
                raise WireError(f"no router at {endpoint} after {timeout_s:g} s: {_why(error)}") from None
            time.sleep(PAUSE_S)  # some mistakes are found at once, again and again


def _open_aside(config: zenoh.Config, timeout_s: float) -> zenoh.Session:
    """Open a session on a thread of its own: a signal is handled by the main thread, which Zenoh would hold till then.

    Shorter tries would never reach a router that is slow to answer. Raises HedgerowError past `timeout_s`: at a limit
    of the machine, a thread of Zenoh can end so that its open never returns.
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
    """Return the cause alone of what Zenoh says, in one line, without where in its sources it says so."""
    if (limit := limit_in(str(error))) is not None:
        return limit
    words = re.sub(r"\s+at /\S+\.rs:\d+\b\.?", "", str(error))
    # Zenoh wraps a cause in what it was doing, and the cause comes last.
    said = " ".join(words.split())
    return said if len(said) <= MOST_SAID else f"…{said[-MOST_SAID:]}"


def _refusal(endpoint: str, credentials: Credentials) -> str | None:
    from hedgerow.wire.refusal import refusal  # noqa: PLC0415

    return refusal(endpoint, credentials)


def has_router(session: zenoh.Session) -> bool:
    """Return True if a client is connected to its router; a client keeps trying to reconnect."""
    return bool(session.info.routers_zid())


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

    Raises DeadlineError if one has none `timeout_s` from now.
    """
    heard, by = threading.Event(), time.monotonic() + timeout_s

    def on_change(_: zenoh.MatchingStatus) -> None:
        heard.set()

    listener = direct(on_change)
    for one in publishers:
        with one.declare_matching_listener(listener):
            while not _has_listener(one):
                if not heard.wait(max(0.0, by - time.monotonic())):
                    raise DeadlineError(
                        f"nobody listens on {one.key_expr} after {timeout_s:g} s; see that process's log"
                    )
                heard.clear()


def _has_listener(one: zenoh.Publisher) -> bool:
    # Its type is said to be bool, yet it is an object that is always true.
    status: Any = one.matching_status
    return bool(status.matching)


def direct(take: Callable[[Any], None]) -> zenoh.handlers.Callback[Any]:
    """A handler that calls `take` on the network thread, where it must not wait for anything."""

    def on_network(what: Any) -> None:
        keep_thread()
        take(what)

    return zenoh.handlers.Callback(on_network, indirect=False)


def subscriber(session: zenoh.Session, key: str, take: Callable[[bytes], None]) -> zenoh.Subscriber[None]:
    """Call `take(payload)` for each message, on the network thread: it must not wait for anything."""
    return session.declare_subscriber(key, direct(lambda sample: take(sample.payload.to_bytes())))


class Sender:
    """A publisher that counts its messages."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.key, self.said = key, 0
        self.publisher = publisher(session, key)
        self._put = self.publisher.put

    def put(self, message: bytes) -> None:
        """Send the message and count it."""
        self.said += 1
        self._put(message)


class Receiver:
    """A subscriber that counts its messages; `take` raises MessageError for a message that is not valid on its key."""

    def __init__(self, session: zenoh.Session, key: str, take: Callable[[bytes], None]) -> None:
        """`take` is called on the network thread, where it must not wait."""
        self.key, self.heard, self.refused = key, 0, 0
        self.strange: dict[str, int] = {}
        """messages that came on another key, which has a `*` in it: nobody of the run speaks so"""
        self._take = take
        self._declared = session.declare_subscriber(key, direct(self._on_sample))

    def close(self) -> None:
        """Stop receiving messages."""
        with contextlib.suppress(zenoh.ZError):  # the session may be closed
            self._declared.undeclare()  # type: ignore[no-untyped-call]

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


def counts(senders: Iterable[Sender], receivers: Iterable[Receiver]) -> dict[str, dict[str, int]]:
    """What a process said, heard, refused and should not have been told, by key."""
    receivers = list(receivers)
    return {
        "said": {sender.key: sender.said for sender in senders},
        "heard": {receiver.key: receiver.heard for receiver in receivers},
        "refused": {receiver.key: receiver.refused for receiver in receivers if receiver.refused},
        "strange": {key: number for receiver in receivers for key, number in receiver.strange.items()},
    }
