"""The tables of docs/wire.md agree with the code: bytes of messages, keys, commands, events, deadlines, settings."""

from __future__ import annotations

import importlib
import json
import re
from types import FunctionType
from typing import Any

import numpy as np
import pytest

from hedgerow.wire import codec, keys, session
from hedgerow.wire.message import REPORT_ROWS, End, Flag, Kind, Link, Record, RoundTripTimes, Span, Telemetry
from tests.tools.documents import ROOT, table

K, M, N, E, T, S = 3, 5, 4, 2, 7, 2
BACK = np.array([True, False, True])
R, D = 2, 3
"""The returning nodes, and their incidences."""
ARRAYS = {
    name: np.arange(1.0, 1 + size).reshape(shape) / 7 + offset
    for offset, (name, size, shape) in enumerate(
        [("x", N, (N,)), ("u", N, (N,)), ("w", N, (N,)), ("report", N * REPORT_ROWS, (REPORT_ROWS, N))]
    )
}
FLAGS = {
    "flags": np.array([7, 1, 2, 4, 0], np.uint8),
    "edge_open": np.array([1, 0], np.uint8),
    "link_up": np.array([1, 0, 0, 1], np.uint8),
}
X, U, W, REPORT = ARRAYS["x"], ARRAYS["u"], ARRAYS["w"], ARRAYS["report"]
USED = np.array([3, 0, 1, 3, 2], np.uint8)
SPANS = [Span(1, 0, 3, 0, 0), Span(4, 2, 1, 5, 6)]
ROWS = {"first": np.array(T - 2), "x": np.arange(S * N).reshape(S, N) / 3, "u": np.arange(S * N).reshape(S, N) / 5}
PAST = {
    "x": ROWS["x"][:, :R].copy(),
    "u": ROWS["u"][:, :R].copy(),
    "edge_open": np.array([[1, 0, 1], [0, 1, 1]], np.uint8),
}
TRIPS = np.arange(1.0, 1 + S * N).reshape(S, N) / 9
EVENT = {"event": "lost", "shard": 1}
TEXT = np.frombuffer(json.dumps(EVENT).encode(), np.uint8)
MESSAGES: dict[str, tuple[bytes, dict[str, Any]]] = {
    "state": (codec.encode_state(T, X[:K], FLAGS["flags"], SPANS), {"x": X[:K], **FLAGS, "spans": np.array(SPANS)}),
    "record": (
        codec.encode_record(Record(T, BACK, T - 2, *PAST.values())),
        {"first": ROWS["first"], "back": BACK, **PAST},
    ),
    "input": (
        codec.encode_input(T, U[:K], REPORT[:, :K].copy(), USED),
        {"u": U[:K], "report": REPORT[:, :K], "used": USED},
    ),
    "link": (codec.encode_link(Link(T, T - 2, ROWS["x"].tobytes(), ROWS["u"].tobytes()), N), ROWS),
    "telemetry": (
        codec.join(
            codec.encode_telemetry(Telemetry(T, X, U, W, REPORT, FLAGS["edge_open"], FLAGS["link_up"], USED[: 2 * E]))
        ),
        {**ARRAYS, **FLAGS, "used": USED[: 2 * E]},
    ),
    "round_trips": (codec.encode_round_trips(RoundTripTimes(T, TRIPS)), {"seconds": TRIPS}),
    "event": (codec.encode_event(T, EVENT), {"event": TEXT}),
    "end": (
        codec.encode_end(End(T, X, 1.25, 3)),
        {**ARRAYS, "elapsed_s": np.array(1.25), "forgotten": np.array(3)},
    ),
    "place": (codec.encode_place(T, 4096, 512), {"start": np.array(4096), "length": np.array(512)}),
    "seen": (codec.encode_seen(T), {}),
}
TYPES = {"u8": "<u1", "u16": "<u2", "u32": "<u4", "i64": "<i8", "f64": "<f8"}


def packed_by(heading: str, values: dict[str, Any], s: int = S) -> bytes:
    """The bytes that a table of docs/wire.md makes of some values, in the sizes that the messages here have."""

    def number(expression: str) -> int:
        return int(eval(expression, {}, {"k": K, "m": M, "n": N, "e": E, "t": T, "r": R, "d": D, "s": s}))

    packed = b""
    for row in table("wire.md", heading):
        kind, *shape = re.findall(r"[^\[\]]+", row["type"])
        field, _, constant = (part.strip() for part in row["field"].partition("="))
        value = np.array(number(constant)) if constant else np.asarray(values[field])
        assert value.shape == tuple(map(number, shape)), f"{field} is {value.shape}"
        piece = value.astype(TYPES[kind]).tobytes()
        assert (number(row["offset"]), number(row["bytes"])) == (len(packed), len(piece)), field
        packed += piece
    return packed


@pytest.mark.parametrize("name", MESSAGES)
def test_the_byte_tables_are_the_codec(name: str) -> None:
    """Bytes packed by the table of docs/wire.md are the bytes that wire.codec packs."""
    message, values = MESSAGES[name]
    assert packed_by(name, values, len(TEXT) if name == "event" else S) == message


def test_optional_parts_of_messages_and_of_a_batch() -> None:
    """A state may end before its spans, or before its flags, and others before their bits; a batch has one message, or
    several, in one part or in more."""
    whole, _ = MESSAGES["state"]
    assert codec.encode_state(T, X[:K], FLAGS["flags"]) == whole[: -20 * S]
    assert codec.encode_state(T, X[:K], b"") == whole[: -20 * S - M]
    assert codec.encode_input(T, U[:K], REPORT[:, :K].copy(), b"") == MESSAGES["input"][0][:-M]
    content = Telemetry(T, X, U, W, REPORT, *(np.ones(size, np.uint8) for size in (E, 2 * E, 2 * E)))
    assert codec.join(codec.encode_telemetry(content, whole=True)) == MESSAGES["telemetry"][0][: -5 * E]
    message = np.frombuffer(whole, np.uint8)
    packed = packed_by("batch", {"number": np.array(T), "message": message}, len(message))
    assert packed == codec.encode_batch(T, [(whole,)])
    assert packed + packed[8:] == codec.encode_batch(T, [(whole,), (whole[:16], whole[16:])])


def test_every_message_has_a_table() -> None:
    """Each encoder of wire.codec, and each kind, is in docs/wire.md."""
    encoders = {name.removeprefix("encode_") for name in vars(codec) if name.startswith("encode_")}
    assert encoders == {*MESSAGES, "batch", "quiet_states"}
    assert {kind.name.lower() for kind in Kind} == MESSAGES.keys()
    bits = {row["name"]: int(row["bit"]) for row in table("wire.md", "state", 1)}
    assert bits == {flag.name: flag.value for flag in Flag}
    assert [row["number of a span"] for row in table("wire.md", "state", 2)] == [*Span._fields]


def test_the_keys_are_those_of_the_code() -> None:
    """Each key of wire.keys has a row in docs/wire.md, and there are no further rows."""
    patterns = {
        "state": keys.state(0).replace("0", "{p}"),
        "input_": keys.input_(0).replace("0", "{p}"),
        "link": keys.link(0, 1).replace("0", "{p}").replace("1", "{q}"),
        "alive": keys.alive("{name}", "{life}"),
        "ROOM": keys.alive(keys.ROOM, "{number}"),
        "control": keys.control("{command}"),
        "join": keys.join("{p}"),
        "TELEMETRY": keys.TELEMETRY,
        "SEEN": keys.SEEN,
    }
    known = {name for name, value in vars(keys).items() if isinstance(value, FunctionType) or name.isupper()}
    assert known - {"ALIVE", "COMMANDS", "PLANT", "chunk", "quote", "shard_name"} == patterns.keys()
    assert {row["key"] for row in table("wire.md", "Keys")} == set(patterns.values())


def test_the_commands_and_events_are_those_of_the_code() -> None:
    """Each command that the plant answers, each event that it reports, and no other, has a row in docs/wire.md."""
    files = ("control", "process", "shards")
    control, process, shards = ((ROOT / f"plant/{name}.py").read_text(encoding="utf-8") for name in files)
    commands = set(re.findall(r'"(\w+)": self\._\w+,', control))
    # A process that joins has a separate key.
    assert commands == {row["command"] for row in table("wire.md", "Commands")} == {*keys.COMMANDS, "join"}
    events = set(re.findall(r'\.(?:_report|report_event)\(\s*"(\w+)"', control + process + shards))
    assert events == {row["event"] for row in table("wire.md", "event", 1)}


def test_the_deadlines_are_those_of_the_code() -> None:
    """Each constant in docs/wire.md has the value on the page."""
    for row in table("wire.md", "Deadlines"):
        names = row["constant"].split(".")
        depth = next(k for k, name in enumerate(names) if not name.islower())
        value: Any = importlib.import_module(".".join(["hedgerow", *names[:depth]]))
        for name in names[depth:]:
            value = getattr(value, name)
            value = value() if isinstance(value, type) else value
        assert value == float(row["seconds"]), row["constant"]


def test_the_session_settings_are_those_of_the_code() -> None:
    """Each setting in docs/wire.md is a setting of the sessions."""
    config = session._config(None, {})
    for row in table("wire.md", "Router and sessions"):
        assert config.get_json(row["setting"]) == row["value"], row["setting"]
