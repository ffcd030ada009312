"""Who may take part: the same message format, the same release, the same network, and nobody twice."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from wire.codec import VERSION


def introduction(network: str) -> dict[str, Any]:
    """What a process says of itself: the format it speaks, its release, and the fingerprint of its network."""
    try:
        release = version("hedgerow")
    except PackageNotFoundError:  # run from a folder of sources
        release = "unknown"
    return {"codec": VERSION, "hedgerow": release, "network": network}


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
