"""Arrays and a few settings in one .npz file, which any NumPy reads; nothing in it is code."""

from __future__ import annotations

import contextlib
import json
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.errors import Code, UserError

NodeId = int | str
Arrays = dict[str, Any]
_SETTINGS = "settings"
_MIXED = "ids"
"""among the settings: arrays of ids of which some are names, or integers beyond 64 bits"""
_BROKEN: tuple[type[Exception], ...] = (
    *(OSError, ValueError, TypeError, LookupError, EOFError, AttributeError, RuntimeError, MemoryError, OverflowError),
    *(SyntaxError, struct.error, zipfile.BadZipFile, zlib.error),
)
"""what NumPy and zipfile raise for a damaged file"""


def id_array(ids: Sequence[NodeId]) -> NDArray[Any]:
    """Return node ids as an array: of int64 if all of them fit, else of objects."""
    if isinstance(ids, range):
        return np.arange(ids.start, ids.stop, ids.step)
    whole = all(isinstance(node, int) and -(2**63) <= node < 2**63 for node in ids)
    found: NDArray[Any] = np.empty(len(ids), dtype=np.int64 if whole else object)
    found[:] = ids
    return found


def write(path: Path, settings: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write `arrays`, ids among them, and `settings`, which are what JSON can hold."""
    # Objects would be pickled, and a pickle is code: ids of both kinds become JSON.
    mixed = {name: array.tolist() for name, array in arrays.items() if array.dtype == object}
    plain = {name: array for name, array in arrays.items() if name not in mixed}
    text = np.frombuffer(json.dumps({**settings, _MIXED: mixed}).encode(), dtype=np.uint8)
    with path.open("wb") as file:
        # Without allow_pickle: numpy 2.0 would store it as an array of that name.
        np.savez(file, **{_SETTINGS: text, **plain})  # type: ignore[arg-type]


def read(path: Path) -> tuple[dict[str, Any], Arrays]:
    """The settings and the arrays that `write` wrote; UserError for a file that cannot be read as such."""
    with reading(path):
        with np.load(path, allow_pickle=False) as file:
            arrays: Arrays = {name: _array(path, file, name) for name in file.files}
        settings: dict[str, Any] = json.loads(arrays.pop(_SETTINGS, np.array([], dtype=np.uint8)).tobytes() or "{}")
        return settings, arrays | {name: id_array(ids) for name, ids in settings.pop(_MIXED, {}).items()}


def _array(path: Path, file: Any, name: str) -> NDArray[Any]:
    try:
        array: NDArray[Any] = file[name]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise UserError(
            f"{path}: `{name}` is an array of Python objects, which numpy reads only as code; give it a type before "
            f"numpy.savez: {name}.astype(str) for names, {name}.astype(float) for numbers",
            code=Code.FILE_FORMAT,
        ) from None
    return array


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Whatever a damaged file, or another's, comes to while the block makes sense of it, is a UserError."""
    try:
        yield
    except _BROKEN as error:
        raise UserError(
            f"{path}: cannot be read as a .npz file: {error}; write it with numpy.savez", code=Code.FILE_FORMAT
        ) from None
