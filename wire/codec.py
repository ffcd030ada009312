"""Every message of the loop, byte for byte (docs/wire.md).

A message is a header and arrays behind it, all little-endian. Both ends know how many nodes and incidences
they share, so that a length which does not fit is refused here and nowhere else.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from topologies.errors import HedgerowError

VERSION = 1
REPORT_WIDTH = 4
"""Numbers that a node reports about itself: ahat, index, margin J_(2) - J_(1), a_LS."""

_HEADER = struct.Struct("<BBHIq")
"""version, kind, 0, how many nodes, step"""

_F8 = np.dtype("<f8")
_U1 = np.dtype("u1")

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]


class Kind(IntEnum):
    """What a message is."""

    STATE = 0
    INPUT = 1
    LINK = 2
    TELEMETRY = 3
    END = 4


class Flag(IntEnum):
    """Bits of one incidence in a state message."""

    OPEN = 1
    """the edge carried flow at t - 1"""
    HEAR = 2
    """the link from the neighbour was up at t - 1: its message of that step has come or will"""
    TELL = 4
    """the link to the neighbour is up at t: send it this step's message"""


ALL_UP = Flag.OPEN | Flag.HEAR | Flag.TELL


class MessageError(HedgerowError):
    """Bytes that are not the message which their key promises."""


class State(NamedTuple):
    """Plant to shard, at t: x (k,), and Flag bits per incidence of the shard (m,)."""

    t: int
    x: Array
    flags: Flags


class Input(NamedTuple):
    """Shard to plant, at t: u (k,), and what its nodes report about themselves (k, REPORT_WIDTH)."""

    t: int
    u: Array
    report: Array


class Link(NamedTuple):
    """Shard to shard, at t: x and u of the sender's nodes with a neighbour there, both (n,)."""

    t: int
    x: Array
    u: Array


class Telemetry(NamedTuple):
    """Plant to observer, at t: x, u, w (n,), report (n, REPORT_WIDTH), edges open (E,), links up (2E,)."""

    t: int
    x: Array
    u: Array
    w: Array
    report: Array
    edge_open: Flags
    link_up: Flags


class End(NamedTuple):
    """Plant to everybody, after the last step: the final state (n,), and no more comes."""

    t: int
    x: Array
    elapsed_s: float
    """from the first state sent to the last input taken, by the plant's clock"""


def _pack(kind: Kind, n: int, t: int, *arrays: NDArray[np.generic]) -> bytes:
    return b"".join((_HEADER.pack(VERSION, kind, 0, n, t), *(array.tobytes() for array in arrays)))


def kind_of(message: bytes) -> int:
    """The kind byte of a message, unchecked beyond its presence."""
    return message[1] if len(message) >= _HEADER.size else -1


def _open(message: bytes, kind: Kind, n: int, size: int) -> int:
    """The step of a message whose header and length are right; raise MessageError for any other."""
    if len(message) < _HEADER.size:
        raise MessageError(f"{len(message)} bytes are too short for a header of {_HEADER.size}")
    version, found, _, nodes, t = _HEADER.unpack_from(message)
    if version != VERSION:
        raise MessageError(f"version {version}, and this process speaks {VERSION}: install the same release everywhere")
    if (found, nodes, len(message)) != (kind, n, _HEADER.size + size):
        right = f"{kind.name} ({kind}) with {n} nodes in {_HEADER.size + size}"
        raise MessageError(f"kind {found} with {nodes} nodes in {len(message)} bytes, expected {right}")
    if t < 0:
        raise MessageError(f"step {t} is before the first")
    return int(t)


def _floats(message: bytes, count: int, skip: int = 0) -> Array:
    return np.frombuffer(message, _F8, count, _HEADER.size + 8 * skip)


def encode_state(t: int, x: Array, flags: Flags) -> bytes:
    """A State message."""
    return _pack(Kind.STATE, len(x), t, x, flags)


def decode_state(message: bytes, k: int, m: int) -> State:
    """A State of k nodes and m incidences."""
    t = _open(message, Kind.STATE, k, 8 * k + m)
    return State(t, _floats(message, k), np.frombuffer(message, _U1, m, _HEADER.size + 8 * k))


def encode_input(t: int, u: Array, report: Array) -> bytes:
    """An Input message."""
    return _pack(Kind.INPUT, len(u), t, u, report)


def decode_input(message: bytes, k: int) -> Input:
    """An Input of k nodes."""
    t = _open(message, Kind.INPUT, k, 8 * k * (1 + REPORT_WIDTH))
    return Input(t, _floats(message, k), _floats(message, k * REPORT_WIDTH, k).reshape(k, REPORT_WIDTH))


def encode_link(t: int, x: Array, u: Array) -> bytes:
    """A Link message."""
    return _pack(Kind.LINK, len(x), t, x, u)


def decode_link(message: bytes, n: int) -> Link:
    """A Link of n boundary nodes."""
    t = _open(message, Kind.LINK, n, 16 * n)
    return Link(t, _floats(message, n), _floats(message, n, n))


def encode_telemetry(row: Telemetry) -> bytes:
    """A Telemetry message."""
    return _pack(
        Kind.TELEMETRY,
        len(row.x),
        row.t,
        row.x,
        row.u,
        row.w,
        row.report,
        row.edge_open,
        row.link_up,
    )


def decode_telemetry(message: bytes, n: int, e: int) -> Telemetry:
    """A Telemetry row of n nodes and e edges."""
    floats = 3 + REPORT_WIDTH
    t = _open(message, Kind.TELEMETRY, n, 8 * n * floats + 3 * e)
    values = _floats(message, n * floats)
    bits = np.frombuffer(message, _U1, 3 * e, _HEADER.size + 8 * n * floats)
    report = values[3 * n :].reshape(n, REPORT_WIDTH)
    return Telemetry(t, values[:n], values[n : 2 * n], values[2 * n : 3 * n], report, bits[:e], bits[e:])


def encode_end(end: End) -> bytes:
    """An End message; to a shard it carries no states."""
    return _pack(Kind.END, len(end.x), end.t, end.x, np.array([end.elapsed_s]))


def decode_end(message: bytes, n: int) -> End:
    """An End with n final states."""
    t = _open(message, Kind.END, n, 8 * n + 8)
    return End(t, _floats(message, n), float(_floats(message, 1, n)[0]))


def encode_seen(t: int) -> bytes:
    """Observer to plant: telemetry up to step t is taken in."""
    return _HEADER.pack(VERSION, 0, 0, 0, t)


def decode_seen(message: bytes) -> int:
    """The step of a `seen` message."""
    return _open(message, Kind(0), 0, 0)
