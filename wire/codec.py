"""Every message of the loop, byte for byte (docs/wire.md).

A message is a header and arrays behind it, all little-endian. Both ends know the number of nodes and incidences that
they share. So this module, and no other, refuses a message of the wrong length.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.wire import bounded_json
from hedgerow.wire.message import (
    REPORT_ROWS,
    TAKEN,
    Array,
    Buffer,
    End,
    Flags,
    Input,
    Kind,
    Link,
    MessageError,
    Record,
    RoundTripTimes,
    Span,
    State,
    Telemetry,
)

VERSION = 4
FEW_STATES = 512
"""Up to this number, states are copied faster than a view of them is made."""

_HEADER = struct.Struct("<BBHIq")
"""version, kind, 0, number of nodes, step"""

HEADER_BYTES = _SIZE = _HEADER.size
_F8 = np.dtype("<f8")
_U1 = np.dtype("u1")
_STEP = struct.Struct("<q")
_SHORT = struct.Struct("<Qq")
_SHORT_LINK = struct.Struct("<Qqq")
"""the same headers, with all before the step as one number, which `_code` gives"""
_SPAN = struct.Struct("<IIIII")
_PLACE = struct.Struct("<qq")
_LINK_HEADER = struct.Struct(_HEADER.format + "q")
"""the same, and the first step"""

# A lookup in an enumeration costs as much as unpacking a header; a call of a named tuple's class costs three times
# that. So the messages of every step use neither.
_STATE, _INPUT, _LINK, _TELEMETRY = map(int, (Kind.STATE, Kind.INPUT, Kind.LINK, Kind.TELEMETRY))
_new = tuple.__new__
_LINK_CODE = VERSION | _LINK << 8


def _pack(kind: int, n: int, t: int, *arrays: Buffer) -> bytes:
    return join((_HEADER.pack(VERSION, kind, 0, n, t), *arrays))


def _code(kind: int, n: int) -> int:
    """Return version, kind and number of nodes of a header as the one number that these eight bytes are."""
    return VERSION | kind << 8 | n << 32


class Form:
    """A message of floats alone, for a process that handles short ones without numpy.

    `pack(code, t, *values)` gives its bytes and `unpack` takes them apart; a link message has its first step behind t.
    """

    def __init__(self, kind: Kind, n: int, numbers: int) -> None:
        self.code = _code(kind, n)
        self._struct = struct.Struct(f"{_SHORT_LINK.format if kind == Kind.LINK else _SHORT.format}{numbers}d")
        self.size, self.pack, self.unpack = self._struct.size, self._struct.pack, self._struct.unpack
        self.unpack_from = self._struct.unpack_from


def header(kind: int, n: int, t: int) -> bytes:
    """Return the first HEADER_BYTES of a message of n nodes at step t."""
    return _HEADER.pack(VERSION, kind, 0, n, t)


def _length(part: Buffer) -> int:
    return len(part) if isinstance(part, bytes) else part.nbytes


def _count(doubles: Buffer) -> int:
    return _length(doubles) // 8


def join(parts: Iterable[Buffer]) -> bytes:
    """Return the concatenation of all parts."""
    return b"".join(parts)  # type: ignore[arg-type]  # arrays are buffers


def gather(parts: Iterable[Buffer]) -> Array:
    """Return the doubles of several messages as one array.

    The messages stay bytes until all of a step are here: one conversion of many costs as much as one conversion of
    each.
    """
    return np.frombuffer(join(parts), _F8)


def kind_of(message: bytes) -> int:
    """Return the kind byte of a message; only its presence is checked."""
    return message[1] if len(message) >= _SIZE else -1


def step_of(message: bytes | memoryview) -> int:
    """Return the step in a header of HEADER_BYTES; nothing is checked."""
    return _STEP.unpack_from(message, _SIZE - _STEP.size)[0]  # type: ignore[no-any-return]


def _open(message: bytes | memoryview, kind: int, n: int, size: int) -> int:
    """Return the step of a message; raise MessageError if its header or length is wrong."""
    if len(message) == _SIZE + size:
        version, found, _, nodes, t = _HEADER.unpack_from(message)
        if version == VERSION and found == kind and nodes == n and t >= 0:
            return t  # type: ignore[no-any-return]
    raise MessageError(_complaint(message, kind, n, size))


def _complaint(message: bytes | memoryview, kind: int, n: int, size: int) -> str:
    if len(message) < _SIZE:
        return f"{len(message)} bytes are too short for a header of {_SIZE}"
    version, found, _, nodes, t = _HEADER.unpack_from(message)
    if version != VERSION:
        return f"version {version}, and this process speaks {VERSION}: install the same release everywhere"
    if (found, nodes, len(message)) != (kind, n, _SIZE + size):
        right = f"{Kind(kind).name} ({kind}) with {n} nodes in {_SIZE + size}"
        return f"kind {found} with {nodes} nodes in {len(message)} bytes, expected {right}"
    return f"step {t} is before the first"


def _floats(message: bytes, count: int, skip: int = 0) -> Array:
    return np.frombuffer(message, _F8, count, _SIZE + 8 * skip)


def encode_state(t: int, x: Buffer, flags: Buffer, spans: Sequence[Span] = ()) -> bytes:
    """Return the bytes of a State message."""
    return _pack(_STATE, _count(x), t, x, pack_flags(flags, spans))


def pack_flags(flags: Buffer, spans: Sequence[Span]) -> bytes:
    """Return the bytes of a State message behind the states."""
    return bytes(flags) + b"".join([_SPAN.pack(*span) for span in spans])


def encode_quiet_states(t: int, x: Array, sizes: Iterable[int]) -> list[bytes]:
    """Return the State messages of all shards, of `sizes` nodes each; each carries x alone, and all flags are set.

    With the bytes of `pack_flags` behind it, each is the message with those flags and spans.
    """
    start, messages, last, head = 0, list[bytes](), -1, b""
    # A view of a long array: a copy of the whole and one of the part would cost as much as the message.
    view = np.ascontiguousarray(x).view(_U1) if len(x) > FEW_STATES else None
    whole = x.tobytes() if view is None else b""
    for k in sizes:
        if k != last:
            last, head = k, header(_STATE, k, t)
        stop = start + 8 * k
        messages.append(head + whole[start:stop] if view is None else join((head, view[start:stop])))
        start = stop
    return messages


def decode_state(message: bytes, k: int, m: int) -> State:
    """Return the State of k nodes and m incidences."""
    end = _SIZE + 8 * k
    if len(message) == end:
        code, t = _SHORT.unpack_from(message)
        if code == _code(_STATE, k) and t >= 0:
            return _new(State, (t, np.frombuffer(message, _F8, k, _SIZE), b"", ()))
    if len(message) in (end, end + m):
        t = _open(message, _STATE, k, len(message) - _SIZE)
        return _new(State, (t, np.frombuffer(message, _F8, k, _SIZE), message[end:], ()))
    end += m
    count = max(0, len(message) - end) // _SPAN.size
    t = _open(message, _STATE, k, 8 * k + m + count * _SPAN.size)
    x, flags = _floats(message, k), message[end - m : end]
    spans = [Span(*numbers) for numbers in _SPAN.iter_unpack(message[end:])]
    if any(span.incidence >= m for span in spans):
        raise MessageError(f"a span of incidence {max(span.incidence for span in spans)}, and there are {m}")
    return State(t, x, flags, spans)


def decode_spans(message: bytes, start: int, m: int) -> list[Span] | None:
    """Return the spans of a State message of m incidences, from byte `start` on; None if they are malformed."""
    if (len(message) - start) % _SPAN.size:
        return None
    spans = []
    for numbers in _SPAN.iter_unpack(message[start:]):
        if numbers[0] >= m:
            return None
        spans.append(_new(Span, numbers))
    return spans


def encode_record(record: Record) -> bytes:
    """Return the bytes of a Record message."""
    arrays = (_STEP.pack(record.first), record.returning.astype(_U1), record.x, record.u, record.edge_open)
    return _pack(Kind.RECORD, len(record.returning), record.t, *arrays)


def decode_record(message: bytes, degrees: Sequence[int] | NDArray[np.int64]) -> Record:
    """Return the Record for a shard, given the degrees of its nodes."""
    k = len(degrees)
    fixed = 8 + k
    returning = np.frombuffer(message[_SIZE + 8 : _SIZE + fixed], _U1).astype(bool)
    if len(returning) != k:
        raise MessageError(_complaint(message, Kind.RECORD, k, fixed))
    r, m = int(returning.sum()), int(np.dot(returning, degrees))
    row = 16 * r + m
    steps = (len(message) - _SIZE - fixed) // row if row else 0
    t = _open(message, Kind.RECORD, k, fixed + steps * row)
    (first,) = _STEP.unpack_from(message, _SIZE)
    if first < 0 or first + steps != t:
        raise MessageError(f"{steps} steps from {first} on, in a record up to step {t}")
    at = _SIZE + fixed
    x, u = np.frombuffer(message, _F8, 2 * steps * r, at).reshape(2, steps, r)
    edge_open = np.frombuffer(message, _U1, steps * m, at + 16 * steps * r).reshape(steps, m)
    return Record(t, returning, first, x, u, edge_open)


def encode_input(t: int, u: Buffer, report: Buffer, used: Buffer) -> bytes:
    """Return the bytes of an Input message; `report` is ahat and margin."""
    return _pack(_INPUT, _count(u), t, u, report, used)


def decode_input(message: bytes | memoryview, k: int, m: int) -> Input:
    """Return the Input of k nodes with m incidences."""
    size, whole = 8 * k, memoryview(message)
    numbers = size * (1 + REPORT_ROWS)
    t = _open(message, _INPUT, k, numbers if len(message) == _SIZE + numbers else numbers + m)
    u, ahat, margin, used = _SIZE, _SIZE + size, _SIZE + 2 * size, _SIZE + 3 * size
    return _new(Input, (t, whole[u:ahat], whole[ahat:margin], whole[margin:used], whole[used:]))


def link_step(message: bytes, n: int) -> int:
    """Return the step of a Link message of n nodes; raise MessageError, as `decode_link` does, if it is malformed."""
    if len(message) == _SIZE + 8 + 16 * n:
        code, t, first = _SHORT_LINK.unpack_from(message)
        if code == _LINK_CODE | n << 32 and t == first >= 0:
            return t  # type: ignore[no-any-return]
    return decode_link(message, n).t


def link_inputs(message: bytes) -> tuple[int, tuple[float, ...]]:
    """Return the first step of a Link message that `link_step` accepted, and all inputs in it, row by row."""
    count = (len(message) - _LINK_HEADER.size) // 16
    (first,) = _STEP.unpack_from(message, _SIZE)
    return first, struct.unpack_from(f"<{count}d", message, len(message) - 8 * count)


def pack_link(t: int, first: int, n: int, x: Sequence[float], u: Sequence[float]) -> bytes:
    """Return the bytes of a Link message of n nodes, from the numbers of all its rows."""
    return struct.pack(f"{_SHORT_LINK.format}{2 * len(x)}d", _LINK_CODE | n << 32, t, first, *x, *u)


def encode_link(link: Link, n: int) -> bytes:
    """Return the bytes of a Link message of n nodes."""
    t, first, x, u = link
    return _LINK_HEADER.pack(VERSION, _LINK, 0, n, t, first) + x + u


def decode_link(message: bytes, n: int) -> Link:
    """Return the Link of n boundary nodes, with one row or more."""
    size = max(1, (len(message) - _LINK_HEADER.size) // (16 * n)) * 16 * n
    t = _open(message, _LINK, n, 8 + size)
    (first,) = _STEP.unpack_from(message, _SIZE)
    rows = size // (16 * n)
    if not 0 <= first <= t + 1 - rows:
        raise MessageError(f"{rows} rows from step {first} on, in a link message of step {t}")
    at, middle = _SIZE + 8, _SIZE + 8 + size // 2
    return _new(Link, (t, first, message[at:middle], message[middle:]))


def encode_telemetry(row: Telemetry, whole: bool = False) -> tuple[Buffer, ...]:
    """Return a Telemetry message in parts, because it is long and is sent in a batch.

    If `whole`, all edges are open, all links are up and every input was used; the message then has no flags.
    """
    t, x, u, w, report, *bits = row
    return (_HEADER.pack(VERSION, _TELEMETRY, 0, len(x), t), x, u, w, report, *(() if whole else bits))


def decode_telemetry(message: bytes, n: int, e: int) -> Telemetry:
    """Return the Telemetry of n nodes and e edges."""
    rows = 3 + REPORT_ROWS
    size = 8 * n * rows
    whole = len(message) == _SIZE + size
    t = _open(message, _TELEMETRY, n, size if whole else size + 5 * e)
    values = _floats(message, n * rows).reshape(rows, n)
    if whole:
        edge_open, link_up, used = _whole(e)
    else:
        bits = np.frombuffer(message, _U1, 5 * e, _SIZE + size)
        edge_open, link_up, used = bits[:e], bits[e : 3 * e], bits[3 * e :]
    return Telemetry(t, values[0], values[1], values[2], values[3:], edge_open, link_up, used)


@cache
def _whole(e: int) -> tuple[Flags, Flags, Flags]:
    """Return the flags of a step in which all e edges are open, all links are up and every input was used."""
    edge_open, link_up, used = (np.broadcast_to(np.uint8(bit), c) for bit, c in ((1, e), (1, 2 * e), (TAKEN, 2 * e)))
    return edge_open, link_up, used


def encode_place(t: int, start: int, length: int) -> bytes:
    """Return the message with the place of the telemetry of t in the shared memory [bytes]."""
    return _pack(Kind.PLACE, 0, t, _PLACE.pack(start, length))


def decode_place(message: bytes) -> tuple[int, int]:
    """Return the place and the length of a row in the shared memory [bytes]; raise MessageError for negative ones."""
    _open(message, Kind.PLACE, 0, _PLACE.size)
    start, length = _PLACE.unpack_from(message, _SIZE)
    if start < 0 or length < _SIZE:
        raise MessageError(f"a row of {length} bytes at {start}")
    return start, length


def encode_round_trips(round_trips: RoundTripTimes) -> bytes:
    """Return the bytes of a RoundTripTimes message."""
    return _pack(Kind.ROUND_TRIPS, round_trips.seconds.shape[1], round_trips.t, round_trips.seconds)


def decode_round_trips(message: bytes, p: int) -> RoundTripTimes:
    """Return the RoundTripTimes of p shards, for one step or more."""
    size = max(1, (len(message) - _SIZE) // (8 * p)) * 8 * p
    t = _open(message, Kind.ROUND_TRIPS, p, size)
    return RoundTripTimes(t, _floats(message, size // 8).reshape(-1, p))


def encode_end(end: End) -> bytes:
    """Return the bytes of an End message; to a shard it carries no states."""
    return _pack(Kind.END, len(end.x), end.t, end.x, np.array([end.elapsed_s]), _STEP.pack(end.forgotten))


def decode_end(message: bytes, n: int) -> End:
    """Return the End with n final states."""
    t = _open(message, Kind.END, n, 8 * n + 16)
    (forgotten,) = _STEP.unpack_from(message, _SIZE + 8 * n + 8)
    return End(t, _floats(message, n), float(_floats(message, 1, n)[0]), forgotten)


def telemetry_bytes(n: int, e: int) -> int:
    """Return the maximum length of a Telemetry message of n nodes and e edges."""
    return _SIZE + 8 * n * (3 + REPORT_ROWS) + 5 * e


def encode_batch(number: int, messages: Iterable[Sequence[Buffer]]) -> bytes:
    """Return a batch of messages from plant to observer, each in its parts."""
    parts: list[Buffer] = [_STEP.pack(number)]
    for message in messages:
        parts += (_STEP.pack(sum(map(_length, message))), *message)
    return join(parts)


def decode_batch(whole: bytes) -> tuple[int, list[bytes]]:
    """Return the number of a batch, and its messages, one or more."""
    stop, messages = _STEP.size, list[bytes]()
    while (start := stop + _STEP.size) <= len(whole):
        (size,) = _STEP.unpack_from(whole, stop)
        if not _SIZE <= size <= len(whole) - start:
            break
        stop = start + size
        messages.append(whole[start:stop])
    if not messages or stop != len(whole):
        raise MessageError(f"{len(whole)} bytes are no number with messages behind it, each behind its length")
    return _STEP.unpack_from(whole)[0], messages


def encode_seen(number: int) -> bytes:
    """Return the message from observer to plant that it received every batch up to this number."""
    return _pack(Kind.SEEN, 0, number)


def decode_seen(message: bytes) -> int:
    """Return the number in a `seen` message."""
    return _open(message, Kind.SEEN, 0, 0)


def encode_event(t: int, event: Mapping[str, Any]) -> bytes:
    """Return a message from plant to observer about an event at step t; it travels between the rows of telemetry.

    Raises MessageError for an event that JSON cannot hold.
    """
    try:
        return _pack(Kind.EVENT, 0, t, json.dumps(event).encode())
    except (ValueError, TypeError, RecursionError) as error:
        raise MessageError(f"an event that is no JSON object: {error}") from None


def decode_event(message: bytes, most_bytes: int = bounded_json.MOST_BYTES) -> dict[str, Any]:
    """Return the event in a message with its `step`, rebuilt from plain types; raise MessageError otherwise."""
    t = _open(message, Kind.EVENT, 0, max(0, len(message) - _SIZE))
    try:
        event: dict[str, Any] = bounded_json.decode(message[_SIZE:], most_bytes)
        return {**event, "step": t}
    except (ValueError, TypeError) as error:
        raise MessageError(f"an event that is no JSON object: {error}") from None
