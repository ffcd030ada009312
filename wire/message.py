"""Every message of the loop: its kind, its flags and its fields. `hedgerow.wire.codec` writes and reads them."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.errors import Code, HedgerowError

REPORT_ROWS = 2
"""Numbers that a node reports about itself: ahat and the margin J_(2) - J_(1)."""

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Buffer = bytes | memoryview | NDArray[Any]


class Kind(IntEnum):
    """The kind of a message."""

    STATE = 0
    INPUT = 1
    LINK = 2
    TELEMETRY = 3
    END = 4
    SEEN = 5
    RECORD = 6
    EVENT = 7
    ROUND_TRIPS = 8
    PLACE = 9


class Flag(IntEnum):
    """The flag bits of one incidence in a state message.

    In an input message, `OPEN` and `RECEIVE` mark the inputs of t - 1 that the node used.

    In an input message, the six bits above these two count the late and back-filled rows that arrived.
    """

    OPEN = 1
    """the edge carried flow at t - 1"""
    RECEIVE = 2
    """the link from the neighbour delivers at t - 1: its message of that step has arrived or will arrive"""
    SEND = 4
    """the link to the neighbour is up at t: send it this step's message"""


ALL_UP = Flag.OPEN | Flag.RECEIVE | Flag.SEND
TAKEN = Flag.OPEN | Flag.RECEIVE
LATE, MOST_LATE = 2, 63
"""the lowest bit of the count of late rows; the largest count, which also means any larger number"""


class MessageError(HedgerowError):
    """Bytes that are not the message that their key requires."""

    default_code = Code.MESSAGE


class Span(NamedTuple):
    """The rows that cross the links of one incidence, if they are more than the row of the step.

    The link from the neighbour delivers at t - 1 the row t - 1 - received_late and received_back rows before it. The
    link to the neighbour delivers at t the row t - sent_late and sent_back rows before it.
    """

    incidence: int
    received_late: int
    received_back: int
    sent_late: int
    sent_back: int


class State(NamedTuple):
    """Plant to shard, at t: x (k,), NaN without a reading, and a byte of Flag bits per incidence of the shard (m,).

    Without flags, all bits are set (ALL_UP) and there are no spans. A link that is up and has no span carries only the
    row of the current step.
    """

    t: int
    x: Array
    flags: bytes
    spans: Sequence[Span] = ()


class Record(NamedTuple):
    """Plant to shard, before the state of t: the history of the r nodes that rejoin, as states, inputs and open edges.

    Steps `first` .. t - 1, S of them: x and u (S, r), NaN where there was none, and which of their incidences' edges
    were open (S, m_r).
    """

    t: int
    returning: Mask
    """True for the nodes of the shard that rejoin, (k,)"""
    first: int
    x: Array
    u: Array
    edge_open: Flags


class Input(NamedTuple):
    """Shard to plant, at t: u (k,), ahat and margin (k,), and Flag bits (m,) of the inputs of t - 1 that the nodes
    used.

    u is NaN where an input is missing. There are no bits if the nodes used every input. See `gather`.
    """

    t: int
    u: Buffer
    ahat: Buffer
    margin: Buffer
    used: Buffer


class Link(NamedTuple):
    """Shard to shard, at t: x and u of the sender's n nodes with a neighbour there, one row per step from `first` on.

    This is usually the row of t alone; see `gather`.
    """

    t: int
    first: int
    x: bytes
    u: bytes


class Telemetry(NamedTuple):
    """Plant to observer, at t: x, u, w (n,), report (REPORT_ROWS, n), edges open (E,), links up (2E,).

    u is NaN where no input arrived, and the report is NaN where the node was absent. `used` (2E,) has the Flag bits of
    the inputs of t - 1 that the nodes report as used.
    """

    t: int
    x: Array
    u: Array
    w: Array
    report: Array
    edge_open: Flags
    link_up: Flags
    used: Flags


class RoundTripTimes(NamedTuple):
    """Plant to observer: the answer times of P shards [s], from step t on, (S, P); NaN for no answer."""

    t: int
    seconds: Array


class End(NamedTuple):
    """Plant to all processes, after the last step: the final state (n,). No message follows."""

    t: int
    x: Array
    elapsed_s: float
    """the time from the first state sent to the last input received, by the plant's clock"""
    forgotten: int = 0
    """the number of rows of neighbours' inputs that the history dropped before they could be back-filled"""
