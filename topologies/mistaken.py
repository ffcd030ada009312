"""Files that a user gives in place of a topology: the kind of each, and the command that takes it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from hedgerow.topologies.escape import command

TABLES = frozenset({".csv", ".tsv", ".txt", ".edges", ".edgelist", ".edge", ".dat", ".adj"})
"""endings of tables of edges, which `orchestrator import` reads"""
GRAPHS = frozenset({".graphml", ".gml", ".gexf", ".net", ".paj", ".mtx", ".npz", ".m", ".mat", ".inp", ".xml"})
"""endings of other files that `orchestrator import` reads"""
PROGRAMS = frozenset({".py", ".pyi"})
TEXTS = frozenset({".log", ".md", ".ipynb", ".html"})
_OF_RUN = re.compile(r"(telemetry|edges|summary)\.parquet|run(-\d+)?\.rrd|events\.jsonl")
_LAW = re.compile(r"([\w./-]+):([A-Za-z_]\w*(?:\(.*\))?)")
_CLASS = re.compile(rb"^class\s+([A-Za-z_]\w*)", re.MULTILINE)


class Mistaken(NamedTuple):
    """A file of another kind: its kind by its name, and the fix."""

    what: str
    cure: str


def mistaken(name: str, text: bytes = b"") -> Mistaken | None:
    """Return what a file is that could not be read as a topology; None if its name does not show it.

    `text` is the content of the file, from which a law's class is named.
    """
    ending = Path(name).suffix.lower()
    if ending in PROGRAMS:
        return Mistaken("is a Python file by its name, and a topology is expected", _law(name, text))
    if ending in TABLES or ending in GRAPHS:
        kind = "table" if ending in TABLES else "file of another tool"
        made = command(["orchestrator", "import", name])
        of = "a table of edges" if ending in TABLES else "a network"
        return Mistaken(f"is a {kind} by its name", f"`{made}` makes a topology of {of}")
    if _OF_RUN.fullmatch(Path(name).name):
        folder = command(["orchestrator", "open", str(Path(name).parent)])
        return Mistaken("is a file of a run by its name", f"name the folder of the run; `{folder}` shows the run")
    if ending in TEXTS:
        return Mistaken("is no topology by its name", "name a .yaml file, or a bundled one such as paper7")
    return None


def cure_of_law(name: str) -> str:
    """Return what to write for a law that is given as a topology, such as `capped:Capped`; empty for another name."""
    found = _LAW.fullmatch(name)
    if found is None:
        return ""
    # A path is no module: the law is loaded from the working directory.
    module = found[1].removesuffix(".py")
    law = f"{module}:{found[2]}" if "/" not in module else f"{Path(module).name}:{found[2]}"
    return _cure(law)


def _law(name: str, text: bytes) -> str:
    """Return what to write for the law of a Python file."""
    found = _CLASS.search(text)
    return _cure(f"{Path(name).stem}:{found[1].decode() if found else 'CLASS'}")


def _cure(law: str) -> str:
    run = command(["orchestrator", "simulate", "paper7", "--law", law])
    return f"for a law, write `{run}`, with your topology in place of paper7"
