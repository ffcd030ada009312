"""Who may say and hear what: the information structure of the paper, as rules that the router of a run keeps.

Everything that is not allowed here is refused (docs/security.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from wire import keys

OBSERVER, OPERATOR, ROUTER = "observer", "operator", "router"


class Place(NamedTuple):
    """A shard among the others."""

    name: str
    """of its process, and in its certificate"""
    shard: int
    peers: Sequence[int]
    """the shards with neighbours of its nodes"""


class Rights(NamedTuple):
    """What one process may do, by keys of the run."""

    says: Sequence[str] = ()
    hears: Sequence[str] = ()
    asks: Sequence[str] = ()
    answers: Sequence[str] = ()
    shows: Sequence[str] = ()
    """its liveliness token"""
    watches: Sequence[str] = ()
    """tokens of others"""


def rights(places: Sequence[Place]) -> dict[str, Rights]:
    """What each process may do, by its name; nobody else may do anything."""
    shards = [place.shard for place in places]
    agents = {
        name: Rights(
            says=[keys.input_(p), *(keys.link(p, q) for q in peers)],
            hears=[keys.state(p), *(keys.link(q, p) for q in peers)],
            shows=[keys.alive(keys.shard_name(p), "*")],
        )
        for name, p, peers in places
    }
    plant = Rights(
        says=[*map(keys.state, shards), keys.TELEMETRY],
        hears=[*map(keys.input_, shards), keys.SEEN],
        answers=[*map(keys.control, keys.COMMANDS)],
        shows=[keys.alive(keys.PLANT, "*")],
        watches=[keys.ALIVE],
    )
    observer = Rights(says=[keys.SEEN], hears=[keys.TELEMETRY], asks=[keys.control("died"), keys.control("stop")])
    operator = Rights(asks=[keys.control(command) for command in keys.COMMANDS if command != "died"])
    return {**agents, keys.PLANT: plant, OBSERVER: observer, OPERATOR: operator}


IN, OUT = "ingress", "egress"
_MESSAGES: Mapping[str, Mapping[str, Sequence[str]]] = {
    "says": {IN: ["put"], OUT: ["declare_subscriber"]},
    "hears": {IN: ["declare_subscriber"], OUT: ["put"]},
    "asks": {IN: ["query"], OUT: ["reply", "declare_queryable"]},
    "answers": {IN: ["declare_queryable", "reply"], OUT: ["query"]},
    "shows": {IN: ["liveliness_token"]},
    "watches": {IN: ["declare_liveliness_subscriber", "liveliness_query"], OUT: ["liveliness_token"]},
}
"""What each right lets into the router from that process, and out to it.

Who says something is told that somebody listens, or it would never begin.
"""


def access_control(granted: Mapping[str, Rights], namespace: str) -> dict[str, Any]:
    """The same as the `access_control` of a Zenoh router's configuration: by the name in a certificate, else denied."""
    rules = {name: [*_rules(name, some, namespace)] for name, some in granted.items()}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for some in rules.values() for rule in some],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in granted],
        "policies": [{"rules": [rule["id"] for rule in some], "subjects": [name]} for name, some in rules.items()],
    }


def _rules(name: str, granted: Rights, namespace: str) -> Iterator[dict[str, Any]]:
    for right, some in granted._asdict().items():
        for flow, messages in _MESSAGES[right].items() if some else ():
            yield {
                "id": f"{name} {right} {flow}",
                "permission": "allow",
                "flows": [flow],
                "messages": messages,
                "key_exprs": [f"{namespace}/{key}" for key in some],
            }
