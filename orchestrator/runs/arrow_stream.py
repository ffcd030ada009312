"""The batches of an Arrow stream from another program: their memory is checked before they are read."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.topologies import budget


def batches(stream: Path) -> tuple[pa.Schema, Iterator[pa.RecordBatch]]:
    """Return the schema of a stream, and its complete batches, which stay in the file; a killed writer may leave fewer.

    Raise ArrowInvalid or EOFError if the schema is missing.
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
        except (StopIteration, pa.ArrowInvalid, OSError):  # the end, or the point where the writer was killed
            return
        yield read_batch(stream, message, schema)


def read_batch(stream: Path, message: Any, schema: pa.Schema) -> pa.RecordBatch:
    """Return the batch in a message of a stream; raise UserError if it takes more memory than allowed.

    A compressed batch can grow a thousand times. Raise ValueError for a message that is not a batch.
    """
    if message.type != "record batch":
        raise ValueError(f"it has a {message.type} where rows should be")
    budget.require(stream, _unpacked(message))
    return pa.ipc.read_record_batch(message, schema)


_BUFFER = struct.Struct("<qq")
_UNPACKED = struct.Struct("<q")


def _unpacked(message: Any) -> int:
    """Return the uncompressed size of the buffers of a batch [bytes]; 0 for an uncompressed batch.

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
    """Return the place that the offset at `at` points to."""
    return at + _number("<I", buffer, at)


def _field(buffer: memoryview, table: int, number: int) -> int:
    """Return the place of a field of a table; 0 if it is absent."""
    layout = table - _number("<i", buffer, table)
    if 4 + 2 * number >= _number("<H", buffer, layout):
        return 0
    offset = _number("<H", buffer, layout + 4 + 2 * number)
    return table + offset if offset else 0
