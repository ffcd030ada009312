"""Documents of settings, arrays and tables: one declaration of the entries serves JSON, TOML and .npz files.

A document is a dictionary. Its form has one kind per entry. An entry with the value None is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies import archive

Document = Mapping[str, Any]
_BETWEEN = "."
"""the separator in the names of arrays in a .npz file, e.g. nodes.candidates.values"""


class Ragged(NamedTuple):
    """Lists of different lengths: their values one after another, and the length of each list."""

    values: NDArray[Any]
    sizes: NDArray[np.int64]

    def lists(self) -> list[NDArray[Any]]:
        """Return the lists as views of `values`."""
        stops = self.sizes.cumsum().tolist()
        return [self.values[start:stop] for start, stop in zip([0, *stops], stops, strict=False)]


def ragged(lists: Sequence[NDArray[Any]]) -> Ragged:
    """Return integer lists as one value."""
    values = np.concatenate(lists) if lists else np.empty(0, dtype=np.int64)
    return Ragged(values, np.array([len(one) for one in lists], dtype=np.int64))


class Kind(Protocol):
    """The kind of an entry."""

    def plain(self, value: Any) -> Any:
        """Return the value as JSON holds it."""

    def packed(self, value: Any) -> Any:
        """Return the value with arrays in it, as a .npz file holds it."""

    def read(self, value: Any) -> Any:
        """Return the value from `plain` or `packed`; KeyError, TypeError or ValueError if it is malformed."""


class Setting:
    """A number, a text, or any other value that JSON holds."""

    def plain(self, value: Any) -> Any:
        return value

    packed = read = plain


class Numbers(Setting):
    """An array of numbers; a single number stays a setting. Without a type, the array keeps that of its values."""

    def __init__(self, dtype: Any = None, *shape: int) -> None:
        self._dtype, self._shape = dtype, shape

    def plain(self, value: Any) -> Any:
        return value.tolist() if isinstance(value, np.ndarray) else value

    def read(self, value: Any) -> Any:
        if not isinstance(value, list | np.ndarray):
            return value
        array = np.asarray(value, self._dtype)
        return array.reshape(self._shape) if self._shape else array


class NodeIds(Numbers):
    """An array of node ids."""

    def read(self, value: Any) -> Any:
        return value if isinstance(value, np.ndarray) else archive.id_array(value)


class Lists:
    """Lists of different lengths, as a Ragged."""

    def __init__(self, of: Numbers) -> None:
        self._of = of

    def plain(self, value: Ragged) -> list[Any]:
        return [self._of.plain(one) for one in value.lists()]

    def packed(self, value: Ragged) -> dict[str, Any]:
        return value._asdict()

    def read(self, value: Any) -> Ragged:
        if isinstance(value, Mapping):
            return Ragged(**value)
        sizes = np.array([len(one) for one in value], dtype=np.int64)
        return Ragged(self._of.read([each for one in value for each in one]), sizes)


class Rows:
    """A table: a dictionary of columns of one length. JSON has one object per row, and .npz one array per column."""

    def __init__(self, **columns: Kind) -> None:
        self._columns = columns

    def plain(self, value: Document) -> list[dict[str, Any]]:
        columns = _each("plain", self._columns, value)
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def packed(self, value: Document) -> dict[str, Any]:
        return _each("packed", self._columns, value)

    def read(self, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            names = [name for name in self._columns if not value or any(name in row for row in value)]
            value = {name: [row[name] for row in value] for name in names}
        return _each("read", self._columns, value)


class Named:
    """A dictionary of arrays with any names."""

    def plain(self, value: Document) -> dict[str, Any]:
        return {name: one.tolist() for name, one in value.items()}

    def packed(self, value: Document) -> dict[str, Any]:
        return dict(value)

    def read(self, value: Document) -> dict[str, Any]:
        return {name: np.asarray(one) for name, one in value.items()}


class Form:
    """The declaration of a document: the kind of each entry."""

    def __init__(self, **entries: Kind) -> None:
        self._entries = entries

    def plain(self, document: Document) -> dict[str, Any]:
        """Return the document as JSON and TOML hold it."""
        return _each("plain", self._entries, document)

    def packed(self, document: Document) -> dict[str, Any]:
        """Return the document with arrays in it."""
        return _each("packed", self._entries, document)

    def read(self, written: Document) -> dict[str, Any]:
        """Return the document from `plain` or `packed`; KeyError, TypeError or ValueError if it is malformed."""
        return _each("read", self._entries, written)

    def save(self, path: Path, document: Document) -> None:
        """Write a document as a .npz file."""
        arrays: dict[str, NDArray[Any]] = {}
        archive.write(path, _lifted(self.packed(document), "", arrays), arrays)

    def load(self, path: Path) -> dict[str, Any]:
        """Return the document in a .npz file; UserError if the file is not one of this form."""
        settings, arrays = archive.read(path)
        with archive.reading(path):
            for name, array in arrays.items():
                *way, last = name.split(_BETWEEN)
                place: Any = settings
                for part in way:
                    place = place[int(part) if isinstance(place, list) else part]
                place[last] = array
            return self.read(settings)


class Parts:
    """A list of documents of one form."""

    def __init__(self, form: Form) -> None:
        self._form = form

    def plain(self, value: Sequence[Document]) -> list[Any]:
        return [self._form.plain(one) for one in value]

    def packed(self, value: Sequence[Document]) -> list[Any]:
        return [self._form.packed(one) for one in value]

    def read(self, value: Sequence[Document]) -> list[Any]:
        return [self._form.read(one) for one in value]


def _each(what: str, entries: Mapping[str, Kind], document: Document) -> dict[str, Any]:
    given = {name: document[name] for name in entries if document.get(name) is not None}
    return {name: getattr(entries[name], what)(value) for name, value in given.items()}


def _lifted(value: Any, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    """Return a nested value without its arrays, which go into `arrays` under their paths."""
    if isinstance(value, dict):
        within = {key: (f"{name}{_BETWEEN}{key}" if name else key, one) for key, one in value.items()}
        arrays |= {path: one for path, one in within.values() if isinstance(one, np.ndarray)}
        return {k: _lifted(one, path, arrays) for k, (path, one) in within.items() if not isinstance(one, np.ndarray)}
    if isinstance(value, list):
        return [_lifted(one, f"{name}{_BETWEEN}{k}", arrays) for k, one in enumerate(value)]
    return value
