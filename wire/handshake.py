"""Who may take part: the same message format, the same release, the same network, and nobody twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import zenoh

from topologies.errors import UserError
from wire import keys
from wire.codec import VERSION
from wire.session import LEASE_S

LOOK_AGAIN_S = 0.5


def introduction(network: str) -> dict[str, Any]:
    """What a process says of itself: the format it speaks, its release, and the fingerprint of its network."""
    return {"codec": VERSION, "hedgerow": _release(), "network": network}


@cache  # it is looked up on the disk, and the plant is asked under its lock
def _release() -> str:
    try:
        return version("hedgerow")
    except PackageNotFoundError:  # run from a folder of sources
        return "unknown"


def mismatch(network: str, theirs: Mapping[str, Any]) -> str | None:
    """Why we and somebody who said `theirs` cannot work together, None if we can; both sides are named."""
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


def wait_for_room(
    session: zenoh.Session, namespace: str, say: Callable[[str], object], stopped: Callable[[], bool] = lambda: False
) -> None:
    """Return once no plant is there, or `stopped()`; UserError where one stays for longer than the token of a dead one.

    Two plants in one namespace would end each other's networks.
    """
    there, by, said = f"a plant is there already at {namespace}", time.monotonic() + LEASE_S, False
    while not stopped() and any(reply.ok for reply in session.liveliness().get(keys.alive(keys.PLANT, "*"))):
        if time.monotonic() > by:
            raise UserError(f"{there}; end that run, or give another --namespace")
        if not said:
            say(f"{there}; waiting up to {LEASE_S:g} s for its end")
            said = True
        time.sleep(LOOK_AGAIN_S)
