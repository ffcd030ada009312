"""The classes in a Python file of the working directory, for a law that is named by the file alone."""

from __future__ import annotations

import ast
import contextlib
import difflib
import os
from collections.abc import Sequence
from pathlib import Path

from hedgerow.topologies.errors import UserError
from hedgerow.topologies.regular_file import check_regular, read_regular

MAX_BYTES, MAX_FILES = 2**20, 1000
"""A larger file, and the files after these, are not looked at: this only helps a message."""


def hint(name: str, exact: bool = False) -> str:
    """Return "; did you mean sticky:Sticky?" for the name `sticky`, `sticky.py` or `sticky:` beside sticky.py, else "".

    The file is parsed and not run. Without `exact`, a file of a similar name counts too.
    """
    wanted, _, attribute = name.removeprefix("./").partition(":")
    module = _module(wanted.removesuffix(".py"), exact=exact or wanted.endswith(".py") or ":" in name)
    if not module:
        return ""
    classes = _classes(Path(f"{module}.py"))
    near = difflib.get_close_matches((attribute or module).lower(), [one.lower() for one in classes], 1)
    chosen = [one for one in classes if [one.lower()] == near] or classes
    if len(classes) > 1 and not near:
        return f"; {module}.py has the classes {', '.join(classes[:8])}: write {module}:{classes[0]}, for example"
    return f"; did you mean {module}:{chosen[0]}?" if chosen else ""


def _module(wanted: str, exact: bool) -> str:
    """Return the name of the module in the working directory that is meant; empty without one."""
    with contextlib.suppress(OSError, ValueError), os.scandir() as entries:
        files = [one.name for one, _ in zip(entries, range(MAX_FILES), strict=False)]
        own = [one[:-3] for one in files if one.endswith(".py") and one[:-3].isidentifier()]
        lower = {one.lower(): one for one in sorted(own, reverse=True)}
        if wanted in own:
            return wanted
        near: Sequence[str] = difflib.get_close_matches(wanted.lower(), lower, 1, 0.99 if exact else 0.8)
        return lower[near[0]] if near else ""
    return ""


def _classes(file: Path) -> list[str]:
    """Return the classes of a file, those with a method act() or a base class first."""
    with contextlib.suppress(UserError, OSError, ValueError, SyntaxError, RecursionError, MemoryError):
        if check_regular(file).st_size > MAX_BYTES:
            return []
        found = [one for one in ast.parse(read_regular(file)).body if isinstance(one, ast.ClassDef)]
        return [one.name for one in sorted(found, key=lambda one: not _may_be_law(one))]
    return []


def _may_be_law(found: ast.ClassDef) -> bool:
    return bool(found.bases) or any(isinstance(one, ast.FunctionDef) and one.name == "act" for one in found.body)
