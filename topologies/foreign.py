"""The kinds of files that people give by mistake, by their first bytes, and problems of text files in our words."""

from __future__ import annotations

import csv

_MAGIC = (
    (b"PK\x03\x04", "a ZIP archive, such as .xlsx or .npz"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"BZh", "a bzip2 archive"),
    (b"\xfd7zXZ", "an xz archive"),
    (b"\x28\xb5\x2f\xfd", "a zstd archive"),
    (b"\x93NUMPY", "a .npy array of NumPy"),
    (b"PAR1", "a Parquet table"),
    (b"ARROW1", "an Arrow table"),
    (b"RRF2", "a recording of Rerun"),
    (b"RRIO", "a recording of Rerun"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"%PDF", "a PDF document"),
    (b"\x89HDF", "an HDF5 file"),
    (b"SQLite format 3", "an SQLite database"),
    (b"\x7fELF", "a program"),
    (b"\xd0\xcf\x11\xe0", "an old Office document, such as .xls"),
    (b"MATLAB 5.0", "a .mat file of MATLAB"),
    (b"\xff\xfe", "text in UTF-16"),
    (b"\xfe\xff", "text in UTF-16"),
)


def foreign_kind(head: bytes) -> str:
    """Return the kind of a file that is no text in UTF-8, from its first bytes; empty if they are of no known kind."""
    return next((kind for magic, kind in _MAGIC if head.startswith(magic)), "")


def not_text(data: bytes, error: UnicodeDecodeError | None = None) -> str:
    """Return why some bytes are no text in UTF-8; empty if there is no reason."""
    if kind := foreign_kind(data):
        return f"is {kind}, not text in UTF-8"
    return "" if error is None else f"byte {error.start} is not UTF-8 text"


def csv_problem(error: csv.Error) -> str:
    """Return the problem of a table, in our words where those of the library name a part of Python."""
    return "a cell has more than 131072 characters" if "field limit" in str(error) else str(error)
