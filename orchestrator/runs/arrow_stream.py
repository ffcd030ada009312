"""The batches of an Arrow stream that another program may have written: their memory is known before they are read."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.topologies import budget


def batches(stream: Path) -> tuple[pa.Schema, Iterator[pa.RecordBatch]]:
    """Return the schema of a stream, and its whole batches, which stay in the file; those of a killed writer end early.

    Raises ArrowInvalid or EOFError if not even the schema is there.
    """
    reader = pa.ipc.MessageReader.open_stream(pa.memory_map(spelled(stream)))
    try:
        schema = pa.ipc.read_schema(reader.read_next_message())
    except StopIteration:
        raise EOFError("there is no schema") from None
    return schema, _whole(stream, reader, schema)


def _whole(stream: Path, reader: Any, schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    while True:
        try:
            message = reader.read_next_message()
        except (StopIteration, pa.ArrowInvalid, OSError):  # the end, or where a killed writer left off
            return
        yield read_batch(stream, message, schema)


def read_batch(stream: Path, message: Any, schema: pa.Schema) -> pa.RecordBatch:
    """Return the batch in a message of a stream; raise UserError if it takes more memory than is allowed.

    A compressed batch can become a thousand times as large. Raises ValueError for a message that is no batch.
    """
    if message.type != "record batch":
        raise ValueError(f"it has a {message.type} where rows should be")
    budget.require(stream, _unpacked(message))
    return pa.ipc.read_record_batch(message, schema)


_BUFFER = struct.Struct("<qq")
_UNPACKED = struct.Struct("<q")


def _unpacked(message: Any) -> int:
    """Return the bytes that the compressed buffers of a batch become; 0 for a batch that is not compressed.

    The message is a flatbuffer (Arrow's format/Message.fbs). A compressed buffer begins with its length.
    """
    head, body = memoryview(message.metadata), memoryview(message.body)
    try:
        batch = _follow(head, _field(head, _follow(head, 0), 2))
        if not _field(head, batch, 3):
            return 0
        vector = _follow(head, _field(head, batch, 2))
        total = 0
        for offset, length in _BUFFER.iter_unpack(head[vector + 4 : vector + 4 + 16 * _number("<I", head, vector)]):
            if length >= _UNPACKED.size:
                total += max(_UNPACKED.unpack_from(body, offset)[0], length)
        return total
    except (struct.error, ValueError) as error:
        raise ValueError(f"a batch is damaged: {error}") from None


def _number(form: str, buffer: memoryview, at: int) -> int:
    # A negative place would be counted from the end.
    if at < 0:
        raise ValueError("an offset leads out of the message")
    (number,) = struct.unpack_from(form, buffer, at)
    return int(number)


def _follow(buffer: memoryview, at: int) -> int:
    """Return the place that the offset at `at` leads to."""
    return at + _number("<I", buffer, at)


def _field(buffer: memoryview, table: int, number: int) -> int:
    """Return the place of a field of a table; 0 if it is absent."""
    layout = table - _number("<i", buffer, table)
    if 4 + 2 * number >= _number("<H", buffer, layout):
        return 0
    offset = _number("<H", buffer, layout + 4 + 2 * number)
    return table + offset if offset else 0
