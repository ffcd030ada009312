"""Every message of the loop, byte for byte (docs/wire.md).

A message is a header and arrays behind it, all little-endian. Both ends know how many nodes and incidences
they share, so that a length which does not fit is refused here and nowhere else.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topologies.errors import HedgerowError

VERSION = 1
REPORT_WIDTH = 3
"""Numbers that a node reports about itself: ahat, its index, the margin J_(2) - J_(1)."""

_HEADER = struct.Struct("<BBHIq")
"""version, kind, 0, how many nodes, step"""

_SIZE = _HEADER.size
_F8 = np.dtype("<f8")
_U1 = np.dtype("u1")

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]
Buffer = bytes | NDArray[Any]


class Kind(IntEnum):
    """What a message is."""

    STATE = 0
    INPUT = 1
    LINK = 2
    TELEMETRY = 3
    END = 4
    SEEN = 5


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
    """Plant to shard, at t: x (k,), and a byte of Flag bits per incidence of the shard (m,)."""

    t: int
    x: Array
    flags: bytes


class Input(NamedTuple):
    """Shard to plant, at t: u (k,), and what its nodes report about themselves (k, REPORT_WIDTH); see `gather`."""

    t: int
    u: bytes
    report: bytes


class Link(NamedTuple):
    """Shard to shard, at t: x and u of the sender's nodes with a neighbour there, both (n,); see `gather`."""

    t: int
    x: bytes
    u: bytes


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


def _pack(kind: int, n: int, t: int, *arrays: Buffer) -> bytes:
    return b"".join((_HEADER.pack(VERSION, kind, 0, n, t), *arrays))  # type: ignore[arg-type]  # arrays are buffers


def _count(doubles: Buffer) -> int:
    return (len(doubles) if isinstance(doubles, bytes) else doubles.nbytes) // 8


def gather(parts: Iterable[bytes]) -> Array:
    """The doubles of several messages as one array.

    They stay bytes until all of a step are here: one look at many costs what a look at each would.
    """
    return np.frombuffer(b"".join(parts), _F8)


def kind_of(message: bytes) -> int:
    """The kind byte of a message, unchecked beyond its presence."""
    return message[1] if len(message) >= _SIZE else -1


def _open(message: bytes, kind: int, n: int, size: int) -> int:
    """The step of a message whose header and length are right; raise MessageError for any other."""
    if len(message) == _SIZE + size:
        version, found, _, nodes, t = _HEADER.unpack_from(message)
        if version == VERSION and found == kind and nodes == n and t >= 0:
            return t  # type: ignore[no-any-return]
    raise MessageError(_complaint(message, kind, n, size))


def _complaint(message: bytes, kind: int, n: int, size: int) -> str:
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


def encode_state(t: int, x: Buffer, flags: Buffer) -> bytes:
    """A State message."""
    return _pack(Kind.STATE, _count(x), t, x, flags)


def decode_state(message: bytes, k: int, m: int) -> State:
    """A State of k nodes and m incidences."""
    t = _open(message, Kind.STATE, k, 8 * k + m)
    return State(t, _floats(message, k), message[_SIZE + 8 * k :])


def encode_input(t: int, u: Buffer, report: Buffer) -> bytes:
    """An Input message."""
    return _pack(Kind.INPUT, _count(u), t, u, report)


def decode_input(message: bytes, k: int) -> Input:
    """An Input of k nodes."""
    t = _open(message, Kind.INPUT, k, 8 * k * (1 + REPORT_WIDTH))
    return Input(t, message[_SIZE : _SIZE + 8 * k], message[_SIZE + 8 * k :])


def encode_link(t: int, x: Buffer, u: Buffer) -> bytes:
    """A Link message."""
    return _pack(Kind.LINK, _count(x), t, x, u)


def decode_link(message: bytes, n: int) -> Link:
    """A Link of n boundary nodes."""
    t = _open(message, Kind.LINK, n, 16 * n)
    return Link(t, message[_SIZE : _SIZE + 8 * n], message[_SIZE + 8 * n :])


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
    bits = np.frombuffer(message, _U1, 3 * e, _SIZE + 8 * n * floats)
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
    return _pack(Kind.SEEN, 0, t)


def decode_seen(message: bytes) -> int:
    """The step of a `seen` message."""
    return _open(message, Kind.SEEN, 0, 0)
