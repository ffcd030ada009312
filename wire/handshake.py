"""The conditions to take part: the same message format, the same release, the same network, and only one plant."""

from __future__ import annotations

import contextlib
import secrets
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import zenoh

from hedgerow.topologies.errors import Code, UserError
from hedgerow.wire import keys
from hedgerow.wire.codec import VERSION
from hedgerow.wire.release import release
from hedgerow.wire.session import LEASE_S

LOOK_AGAIN_S = 0.5


def introduction(network: str) -> dict[str, Any]:
    """Return the introduction of a process: its message format, its release, and the fingerprint of its network."""
    return {"codec": VERSION, "hedgerow": release("hedgerow"), "network": network}


def mismatch(network: str, theirs: Mapping[str, Any]) -> str | None:
    """Return the reason why we and a process with the introduction `theirs` cannot work together, None if we can.

    The reason names both sides.
    """
    ours = introduction(network)
    words = {"codec": "message format", "hedgerow": "hedgerow", "network": "network"}
    different = [
        f"{word} {theirs.get(key)} there, {ours[key]} here"
        for key, word in words.items()
        if theirs.get(key) != ours[key]
    ]
    if not different:
        return None
    if theirs.get("codec") == ours["codec"] and theirs.get("hedgerow") == ours["hedgerow"]:
        cure = "both must come from one `orchestrator bundle` of one file, seed and --set"
    else:
        cure = "install the same release on both machines"
    return f"{'; '.join(different)}: {cure}"


@contextlib.contextmanager
def room(
    session: zenoh.Session, namespace: str, say: Callable[[str], object], stopped: Callable[[], bool] = lambda: False
) -> Iterator[None]:
    """Hold the namespace for one plant while the block lasts; wait for any other plant, or until `stopped()`.

    Raise UserError if another plant stays for longer than the token of a dead plant. Two plants in one namespace would
    end each other's networks. So a new plant shows a token, checks again, and starts if it is the only one. A plant
    that sees a smaller number withdraws its token. So one of two new plants remains, and a plant that has started is
    never disturbed.
    """
    ours, shown = keys.alive(keys.ROOM, f"{secrets.randbelow(10**10):010d}"), None
    there, by, reported = f"another plant already runs at {namespace}", time.monotonic() + LEASE_S, False
    try:
        while not stopped():
            others = _there(session) - {ours}
            if not others and shown is not None:
                break
            if not others:
                shown = session.liveliness().declare_token(ours)
                continue
            if shown is not None and min(others) < ours:  # this includes the token of a plant
                shown.undeclare()  # type: ignore[no-untyped-call]
                shown = None
            if time.monotonic() > by:
                raise UserError(f"{there}; end that run, or give another --namespace", code=Code.REFUSED)
            if shown is None and not reported:
                say(f"{there}; waiting up to {LEASE_S:g} s for its end")
                reported = True
            time.sleep(LOOK_AGAIN_S)
        yield
    finally:
        if shown is not None:
            with contextlib.suppress(zenoh.ZError):  # the session may be closed
                shown.undeclare()  # type: ignore[no-untyped-call]


def _there(session: zenoh.Session) -> set[str]:
    """Return the tokens of the plants that run and of those that are about to start."""
    looked = (session.liveliness().get(keys.alive(name, "*")) for name in (keys.PLANT, keys.ROOM))
    return {str(reply.ok.key_expr) for replies in looked for reply in replies if reply.ok is not None}
