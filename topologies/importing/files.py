"""The choice of a file's reader, by its ending and, if that is ambiguous, by its first characters."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.importing.found import Found, refuse
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.json_file import read_json
from hedgerow.topologies.mistaken import TABLES
from hedgerow.topologies.regular_file import open_regular

_BY_ENDING: dict[str, tuple[str, str, str | None]] = {
    ".graphml": ("graphs", "read", "graphml"),
    ".xml": ("graphs", "read", "graphml"),
    ".gml": ("graphs", "read", "gml"),
    ".gexf": ("graphs", "read", "gexf"),
    ".net": ("graphs", "read", "pajek"),
    ".paj": ("graphs", "read", "pajek"),
    ".mtx": ("matrices", "read_market", None),
    ".npz": ("matrices", "read_sparse", None),
    ".m": ("power", "read_m", None),
    ".mat": ("power", "read_mat", None),
    ".inp": ("water", "read", None),
    **dict.fromkeys(sorted(TABLES), ("tables", "read", None)),
}
"""by ending: the module, its function, and the kind of file"""


_CONVERTED = {
    **dict.fromkeys((".dot", ".gv"), "Convert it to GML, with `gv2gml` of Graphviz"),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "Save the sheet as CSV"),
    ".npy": "Save the matrix with numpy.savetxt as .csv, or with scipy.sparse.save_npz",
    **dict.fromkeys((".pkl", ".pickle", ".gpickle"), "Write the graph with networkx.write_graphml: a pickle is code"),
    **dict.fromkeys((".parquet", ".feather", ".arrow"), "Write the table as CSV"),
    **dict.fromkeys((".gz", ".zip", ".bz2", ".xz"), "Unpack the file first"),
    **dict.fromkeys((".py", ".pyi"), "A law needs no import: name its class behind --law"),
    **dict.fromkeys((".yaml", ".yml"), "A topology needs no import: give it to `orchestrator check`"),
}
"""by the ending of a common kind of file without a reader: the way to one with a reader"""


def read(path: Path, options: Options) -> Found:
    """Return the content of a file; raise UserError if no reader knows it, or the reader refuses it."""
    try:
        with open_regular(path) as file:
            head = file.read(512)
        module, function, kind = _reader(path, head)
        reader: Any = getattr(import_module(f"hedgerow.topologies.importing.{module}"), function)
        found: Found = reader(path, options) if kind is None else reader(path, options, kind)
    except OSError as error:
        code = Code.FILE_MISSING if isinstance(error, FileNotFoundError) else Code.FILE_UNREADABLE
        raise UserError(f"{path}: {error.strerror or error}. Check the path and its permissions.", code=code) from None
    return found


def _reader(path: Path, head: bytes) -> tuple[str, str, str | None]:
    ending = path.suffix.lower()
    if ending == ".json":
        return _json(path)
    if ending in _BY_ENDING and not head.startswith(b"%%MatrixMarket"):
        return _BY_ENDING[ending]
    if head.startswith(b"%%MatrixMarket"):
        return _BY_ENDING[".mtx"]
    known = ", ".join(sorted([*_BY_ENDING, ".json"]))
    cure = f"{_CONVERTED[ending]}. " if ending in _CONVERTED else ""
    raise refuse(path, "no reader knows this ending", f"{cure}Known endings are {known}", Code.OPTION)


def _json(path: Path) -> tuple[str, str, str | None]:
    content = read_json(path)
    if isinstance(content, dict) and content.get("_class") == "pandapowerNet":
        return "power", "read_pandapower", None
    return "graphs", "read", "JSON"
