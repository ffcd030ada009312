"""The source of a run's law: loaded again after an edit, and compared with the copy in the run folder."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from hedgerow.agents.law_source import LawSource, source_of, user_files
from hedgerow.agents.loading import law_class
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.law_choice import LawChoice

__all__ = ["FOLDER", "LawSource", "differs", "kept_law", "kept_path", "need_same", "refresh", "source_of", "use_kept"]

FOLDER = "law"
"""the name of the copy in the folder of a run or a sweep"""
_STARTED = time.time()
_SEEN: dict[str, tuple[int, int]] = {}
"""by file: the time of change in ns, and the size, of a module when it was loaded"""


def refresh(law: str) -> None:
    """Load the modules of a law again if their files changed since they were loaded; UserError if that fails."""
    name = LawChoice.parse(law).name
    if ":" not in name:
        return
    module = sys.modules.get(name.partition(":")[0])
    if module is None:
        law_class(name)
        module = sys.modules.get(name.partition(":")[0])
    known = [one for one in user_files(module) if one.module in sys.modules] if module is not None else []
    stale = {one.module for one in known if _changed(one.file)}
    while more := {one.module for one in known if one.module not in stale and stale.intersection(one.uses)}:
        stale |= more  # a module holds its imports until it is loaded again
    with _compiled_anew():
        for one in [one for one in reversed(known) if one.module in stale]:  # a module after those that it uses
            try:
                importlib.reload(sys.modules[one.module])
            except Exception as error:
                cause = f"{type(error).__name__}: {error}"
                raise UserError(f"law {name}: cannot be loaded again: {cause}. Correct it.", code=Code.LAW) from error
    for one in known:
        _SEEN[str(one.file)] = _stamp(one.file)


@contextlib.contextmanager
def _compiled_anew() -> Iterator[None]:
    """Load modules from their source, never from a .pyc file, for as long as the context lasts.

    A .pyc file counts as fresh if the second and the size of its source are the same: it would hide a fast edit.
    """
    before = sys.pycache_prefix, sys.dont_write_bytecode
    sys.pycache_prefix, sys.dont_write_bytecode = os.devnull, True
    try:
        yield
    finally:
        sys.pycache_prefix, sys.dont_write_bytecode = before


def differs(law: str, kept: Path) -> str:
    """Return in one line that a law differs from the copy in the folder of a run; empty if they are equal, or without a
    copy.
    """
    there = LawSource.read(kept)
    if not there.files:
        return ""
    name = LawChoice.parse(law).name
    try:
        now = source_of(law)
    except UserError as error:
        raise UserError(f"{error} The run kept its source. {_CURE}", code=Code.LAW) from error
    if now.digest == there.digest:
        return ""
    return f"law {name}: its source is not the one that this run kept in {kept}. {_CURE}"


_CURE = "To run the kept one, give --kept-law (in Python kept_law=True)."
_KEPT_PATHS: list[Path] = []
"""the folders of the context `kept_law`"""


@contextlib.contextmanager
def kept_law(folder: Path) -> Iterator[None]:
    """Load laws from the copy in the folder of a run while the context lasts; see `use_kept`."""
    before, modules = os.environ.get("PYTHONPATH"), dict(sys.modules)
    names = use_kept(folder)
    try:
        yield
    finally:
        sys.path.remove(str(_KEPT_PATHS.pop()))
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
        for name in names:
            sys.modules.pop(name, None)
            if name in modules:
                sys.modules[name] = modules[name]


def use_kept(folder: Path) -> Sequence[str]:
    """Load laws from the copy in the folder of a run from now on, here and in processes that begin.

    Return the names of the modules of the copy. Raise UserError if the folder has no law that can be imported.
    """
    there = LawSource.read(folder)
    if not there.files or "__main__.py" in there.files:
        found = "the class of a notebook, which no other process can import" if there.files else "no source of a law"
        cure = "Leave out --kept-law (in Python kept_law=True)."
        raise UserError(f"--kept-law: {folder.parent} keeps {found}. {cure}", code=Code.LAW)
    names = [file.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for file in there.files]
    for name in names:
        sys.modules.pop(name, None)
    path = folder.resolve()
    sys.path.insert(0, str(path))
    _KEPT_PATHS.append(path)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(path), os.environ.get("PYTHONPATH")]))
    importlib.invalidate_caches()
    return names


def kept_path() -> Path | None:
    """Return the folder that laws are loaded from, None outside of the context `kept_law`."""
    return _KEPT_PATHS[-1] if _KEPT_PATHS else None


def need_same(law: str, digest: str) -> None:
    """Raise UserError if the source of a law is not the one with this digest."""
    if digest and source_of(law).digest != digest:
        raise UserError(f"law {law}: its source changed during the sweep. Begin a new sweep.", code=Code.LAW)


def _stamp(file: Path) -> tuple[int, int]:
    try:
        status = file.stat()
    except OSError:
        return (0, 0)
    return status.st_mtime_ns, status.st_size


def _changed(file: Path) -> bool:
    before, now = _SEEN.get(str(file)), _stamp(file)
    if before is None:  # some other code imported it; a file older than this process is the one that it imported
        return now[0] / 1e9 > _STARTED
    return before != now
