"""The access rules of a secure router: which process may send and receive which messages, and how many.

They are the information structure of the paper.

The router refuses everything that these rules do not allow (docs/security.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hedgerow.wire import keys

OBSERVER, OPERATOR, ROUTER = "observer", "operator", "router"


class Place(NamedTuple):
    """The place of one shard in the network."""

    name: str
    """the name of its process, which its certificate contains"""
    shard: int
    peers: Sequence[int]
    """the shards with neighbours of its nodes"""
    largest: int = 0
    """the size of the largest message that it ever sends [bytes]"""
    incidences: int = 0
    """ends of edges at its nodes"""


class Rights(NamedTuple):
    """The rights of one process, as keys of the run."""

    publishes: Sequence[str] = ()
    subscribes: Sequence[str] = ()
    asks: Sequence[str] = ()
    answers: Sequence[str] = ()
    shows: Sequence[str] = ()
    """its liveliness token"""
    watches: Sequence[str] = ()
    """tokens of others"""


def rights(places: Sequence[Place]) -> dict[str, Rights]:
    """Return the rights of each process, by its name; no other process has any right."""
    shards = [place.shard for place in places]
    agents = {
        name: Rights(
            publishes=[keys.input_(p), *(keys.link(p, q) for q in peers)],
            subscribes=[keys.state(p), *(keys.link(q, p) for q in peers)],
            asks=[keys.join(p)],
            shows=[keys.alive(keys.shard_name(p), "*")],
            watches=[keys.alive(keys.shard_name(p), "*"), keys.alive(keys.PLANT, "*")],
        )
        for name, p, peers, *_ in places
    }
    plant = Rights(
        publishes=[*map(keys.state, shards), keys.TELEMETRY],
        subscribes=[*map(keys.input_, shards), keys.SEEN],
        answers=[*map(keys.control, keys.COMMANDS), keys.join("*")],
        shows=[keys.alive(keys.PLANT, "*"), keys.alive(keys.ROOM, "*")],
        watches=[keys.ALIVE],
    )
    observer = Rights(
        publishes=[keys.SEEN],
        subscribes=[keys.TELEMETRY],
        asks=[*map(keys.control, ("died", "stop", "status")), keys.join(OBSERVER)],
        shows=[keys.alive(keys.ROOM, "*")],
        watches=[keys.alive(keys.PLANT, "*"), keys.alive(keys.ROOM, "*")],
    )
    operator = Rights(asks=[keys.control(command) for command in keys.COMMANDS if command != "died"])
    return {**agents, keys.PLANT: plant, OBSERVER: observer, OPERATOR: operator}


IN, OUT = "ingress", "egress"
_MESSAGES: Mapping[str, Mapping[str, Sequence[str]]] = {
    "publishes": {IN: ["put"], OUT: ["declare_subscriber"]},
    "subscribes": {IN: ["declare_subscriber"], OUT: ["put"]},
    "asks": {IN: ["query"], OUT: ["reply", "declare_queryable"]},
    "answers": {IN: ["declare_queryable", "reply"], OUT: ["query"]},
    "shows": {IN: ["liveliness_token"]},
    "watches": {IN: ["declare_liveliness_subscriber", "liveliness_query"], OUT: ["liveliness_token"]},
}
"""The directions that each right opens in the router: in from that process, and out to it.

A process that may publish is also informed of its subscribers. Without this, it would wait for a subscriber forever.
"""


MOST_PER_S = 20_000.0
"""The maximum rate of an agent's messages on one key [1/s].

An agent sends one message per step, and only after all messages of the step before arrived. So this limit admits the
fastest possible loop.
"""
MOST_JOINS_PER_S, JOIN_BYTES = 10.0, 4096
"""The maximum rate [1/s] and size [bytes] of an agent's requests to join; an agent asks twice per second.

The plant holds its lock for each request, and every observer receives a refusal. So requests must be few and short.
"""


def rules(places: Sequence[Place], namespace: str, plant_is_client: bool, request_bytes: int = 0) -> dict[str, Any]:
    """Return the access rules and rate limits of the router of a secure run, as settings of Zenoh.

    If the plant is the router, no process may connect under the plant's name, and a command to the plant has at most
    `request_bytes`.
    """
    granted = rights(places)
    published = [(place, [f"{namespace}/{key}" for key in granted[place.name].publishes]) for place in places]
    if not plant_is_client:
        del granted[keys.PLANT]
    joins = [f"{namespace}/{keys.join(place.shard)}" for place in places]
    settings: dict[str, Any] = {
        "access_control": access_control(granted, namespace),
        "downsampling": [
            _often(["put", "delete"], [key for _, some in published for key in some], MOST_PER_S),
            _often(["query"], joins, MOST_JOINS_PER_S),
        ],
        "low_pass_filter": [
            *(_large(place.name, "put", some, place.largest) for place, some in published),
            _large("joins", "query", joins, JOIN_BYTES),
        ],
    }
    if not plant_is_client:  # otherwise an agent could send records and telemetry too
        settings["transport/link/rx/max_message_size"] = 2 * max(request_bytes, *(place.largest for place in places))
    return settings


def _often(messages: Sequence[str], said_on: Sequence[str], most_per_s: float) -> dict[str, Any]:
    rules = [{"key_expr": key, "freq": most_per_s} for key in said_on]
    return {"flows": [IN], "messages": messages, "rules": rules}


def _large(name: str, message: str, said_on: Sequence[str], most_bytes: int) -> dict[str, Any]:
    return {"id": name, "flows": [IN], "messages": [message], "key_exprs": said_on, "size_limit": most_bytes}


def access_control(granted: Mapping[str, Rights], namespace: str) -> dict[str, Any]:
    """Return the same rights as the `access_control` of a Zenoh router, by the name in a certificate; deny the rest."""
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
