"""Arrays and a few settings in one .npz file, which any NumPy reads; it contains no code."""

from __future__ import annotations

import contextlib
import json
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, FileRefusedError, HedgerowError, UserError
from hedgerow.topologies.regular_file import open_regular

NodeId = int | str
Arrays = dict[str, Any]
_SETTINGS = "settings"
_MIXED = "ids"
"""the key in the settings for arrays of ids that include names, or integers beyond 64 bits"""


def id_array(ids: Sequence[NodeId]) -> NDArray[Any]:
    """Return node ids as an array: of int64 if all fit, otherwise of objects."""
    if isinstance(ids, range):
        return np.arange(ids.start, ids.stop, ids.step)
    whole = all(isinstance(node, int) and -(2**63) <= node < 2**63 for node in ids)
    found: NDArray[Any] = np.empty(len(ids), dtype=np.int64 if whole else object)
    found[:] = ids
    return found


def write(path: Path, settings: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write `arrays`, ids included, and `settings`, which JSON must be able to hold."""
    # Objects would be pickled, and a pickle is code: ids of both kinds become JSON.
    mixed = {name: array.tolist() for name, array in arrays.items() if array.dtype == object}
    plain = {name: array for name, array in arrays.items() if name not in mixed}
    text = np.frombuffer(json.dumps({**settings, _MIXED: mixed}).encode(), dtype=np.uint8)
    with path.open("wb") as file:
        # Without allow_pickle: numpy 2.0 would store it as an array of that name.
        np.savez(file, **{_SETTINGS: text, **plain})  # type: ignore[arg-type]


@dataclass(frozen=True)
class Head:
    """The shape, the type and the uncompressed size of an array in a file [bytes]."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    size: int


def read(path: Path, memory: Callable[[Mapping[str, Head]], int] | None = None) -> tuple[dict[str, Any], Arrays]:
    """Return the settings and the arrays that `write` wrote.

    memory: returns the memory that the reader of these arrays needs [bytes], or raises ValueError for arrays that it
    refuses; by default, the size of the arrays. It is called before any array is unpacked. Raise UserError for a file
    that is not valid, or that takes more memory than allowed.
    """
    with reading(path), open_regular(path) as opened:
        heads = _heads(opened)
        settings_size = heads.pop(_SETTINGS).size if _SETTINGS in heads else 0
        need = sum(head.size for head in heads.values()) if memory is None else memory(heads)
        budget.require(path, need + 20 * settings_size)
        opened.seek(0)
        with np.load(opened, allow_pickle=False) as file:
            arrays: Arrays = {name: _array(path, file, name) for name in file.files}
        settings: dict[str, Any] = json.loads(arrays.pop(_SETTINGS, np.array([], dtype=np.uint8)).tobytes() or "{}")
        return settings, arrays | {name: id_array(ids) for name, ids in settings.pop(_MIXED, {}).items()}


def _heads(file: BinaryIO) -> dict[str, Head]:
    """Return the head of every array, by the directory of the archive and the first bytes of each member."""
    heads: dict[str, Head] = {}
    with zipfile.ZipFile(file) as archive:
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if name in heads:
                raise ValueError(f"it has two arrays `{name[:40]}`")
            with archive.open(info) as member:
                version = np.lib.format.read_magic(member)
                read_head = np.lib.format.read_array_header_1_0 if version == (1, 0) else None
                read_head = np.lib.format.read_array_header_2_0 if version == (2, 0) else read_head
                if read_head is None:
                    raise ValueError(f"`{name[:40]}` has the format {version} of arrays")
                shape, _, dtype = read_head(member)
            # A small file can declare any number of elements of size 0, and a list of them can fill the memory.
            if max(math.prod(shape) * dtype.itemsize, *shape, 0) > info.file_size:
                raise ValueError(f"`{name[:40]}` has the shape {shape} in {info.file_size} bytes")
            heads[name] = Head(shape, dtype, info.file_size)
    return heads


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
    if not isinstance(array, np.ndarray):
        raise ValueError(f"`{name[:40]}` is no array")
    return array


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise UserError for any error that a damaged file causes inside the block."""
    try:
        yield
    except (HedgerowError, FileRefusedError):
        raise
    # A damaged file can cause almost any error in NumPy and zipfile, AttributeError and tokenize.TokenError among them.
    except Exception as error:
        said = str(error) or type(error).__name__
        raise UserError(
            f"{path}: cannot be read as a .npz file: {said}; write it with numpy.savez", code=Code.FILE_FORMAT
        ) from None
