"""Arrays and a few settings in one .npz file, which any NumPy reads; it contains no code."""

from __future__ import annotations

import contextlib
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, HedgerowError, UserError
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


def read(path: Path, growth: Mapping[str, int] | None = None) -> tuple[dict[str, Any], Arrays]:
    """Return the settings and the arrays that `write` wrote.

    growth: the memory per byte of an array, by name, if its reader needs more than the array. Raise UserError for a
    file that is not valid, or that takes more memory than allowed.
    """
    with reading(path), open_regular(path) as opened:
        sizes = _sizes(opened)
        growth = {_SETTINGS: 20, **(growth or {})}
        budget.require(path, sum(size * growth.get(name, 1) for name, size in sizes.items()))
        opened.seek(0)
        with np.load(opened, allow_pickle=False) as file:
            arrays: Arrays = {name: _array(path, file, name, sizes.get(name, 0)) for name in file.files}
        settings: dict[str, Any] = json.loads(arrays.pop(_SETTINGS, np.array([], dtype=np.uint8)).tobytes() or "{}")
        return settings, arrays | {name: id_array(ids) for name, ids in settings.pop(_MIXED, {}).items()}


def _sizes(file: BinaryIO) -> dict[str, int]:
    """Return the uncompressed size of every array [bytes], by the directory of the archive."""
    sizes: dict[str, int] = {}
    with zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if name in sizes:
                raise ValueError(f"it has two arrays `{name[:40]}`")
            sizes[name] = member.file_size
    return sizes


def _array(path: Path, file: Any, name: str, size: int) -> NDArray[Any]:
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
    # A small file can declare any number of elements of size 0, and a list of them can fill the memory.
    if max(array.shape, default=0) > size:
        raise ValueError(f"`{name[:40]}` has the shape {array.shape} in {size} bytes")
    return array


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise UserError for any error that a damaged file causes inside the block."""
    try:
        yield
    except HedgerowError:
        raise
    # A damaged file can cause almost any error in NumPy and zipfile, AttributeError and tokenize.TokenError among them.
    except Exception as error:
        cause = str(error) or type(error).__name__
        raise UserError(
            f"{path}: cannot be read as a .npz file: {cause}; write it with numpy.savez", code=Code.FILE_FORMAT
        ) from None
