"""The source of a law: the files of its module and of the user's modules that it imports, with their digest.

A run keeps a copy in its folder `law/`, because the name of a law does not say which code ran.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib
import inspect
import os
import sys
import sysconfig
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import ModuleType

from hedgerow.agents.loading import law_class
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.regular_file import read_regular

FOLDER = "law"
"""the name of the copy in the folder of a run or a sweep"""
LARGEST = 2_000_000
"""bytes of a file that is copied"""
_STARTED = time.time()
_SEEN: dict[str, tuple[int, int]] = {}
"""by file: the time of change in ns, and the size, of a module when it was loaded"""


@dataclass(frozen=True)
class LawSource:
    """The files of a law, by their path from the folder that is on the module path."""

    files: Mapping[str, bytes] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """Return 16 hexadecimal digits; empty for a law of the project."""
        if not self.files:
            return ""
        whole = hashlib.sha256()
        for name, text in sorted(self.files.items()):
            whole.update(f"{name}\0{len(text)}\0".encode() + text)
        return whole.hexdigest()[:16]

    def write(self, folder: Path) -> None:
        """Write the files into a folder; raises OSError."""
        for name, text in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text)

    @classmethod
    def read(cls, folder: Path) -> LawSource:
        """Return the files that a run keeps; none if it keeps none."""
        files = {}
        with contextlib.suppress(OSError):
            for path in sorted(folder.rglob("*.py")):
                if path.is_file() and not path.is_symlink() and path.stat().st_size <= LARGEST:
                    files[path.relative_to(folder).as_posix()] = read_regular(path)
        return cls(files)


def source_of(law: str) -> LawSource:
    """Return the source of a law from the text of its choice; it has no files if the law is the project's.

    It loads the module of the law; UserError if that fails.
    """
    name = LawChoice.parse(law).name
    if ":" not in name:
        return LawSource()
    loaded = law_class(name)
    module = sys.modules.get(loaded.__module__)
    files = {path: text for _, path, text in _user_files(module)} if module is not None else {}
    if not files:  # a class of a notebook is in no file
        with contextlib.suppress(OSError, TypeError):
            files = {f"{loaded.__module__.rpartition('.')[2]}.py": inspect.getsource(loaded).encode()}
    return LawSource(files)


def refresh(law: str) -> None:
    """Load the modules of a law again if their files changed since they were loaded; UserError if that fails."""
    name = LawChoice.parse(law).name
    if ":" not in name:
        return
    module = sys.modules.get(name.partition(":")[0])
    if module is None:
        law_class(name)
        module = sys.modules.get(name.partition(":")[0])
    known = [one for one, _, _ in _user_files(module)] if module is not None else []
    changed = [one for one in known if _changed(one)]
    with _compiled_anew():
        for one in dict.fromkeys([*reversed(changed), *known[:1]] if changed else ()):  # a module after those it uses
            try:
                importlib.reload(one)
            except Exception as error:
                said = f"{type(error).__name__}: {error}"
                raise UserError(f"law {name}: cannot be loaded again: {said}. Correct it.", code=Code.LAW) from error
    for one in known:
        _SEEN[str(one.__file__)] = _stamp(one)


@contextlib.contextmanager
def _compiled_anew() -> Iterator[None]:
    """Load modules from their source, never from a .pyc file, for as long as the context lasts.

    A .pyc file counts as fresh if the second and the size of its source are the same: it would hide a quick edit.
    """
    before = sys.pycache_prefix, sys.dont_write_bytecode
    sys.pycache_prefix, sys.dont_write_bytecode = os.devnull, True
    try:
        yield
    finally:
        sys.pycache_prefix, sys.dont_write_bytecode = before


def differs(law: str, kept: Path) -> str:
    """Return in one line that a law is not the one that a run kept in a folder; empty if it is, or none is kept."""
    there = LawSource.read(kept)
    if not there.files:
        return ""
    name = LawChoice.parse(law).name
    cure = f"To run the kept one, set PYTHONPATH={kept.resolve()}."
    try:
        now = source_of(law)
    except UserError as error:
        raise UserError(f"{error} The run kept its source. {cure}", code=Code.LAW) from error
    if now.digest == there.digest:
        return ""
    return f"law {name}: its source is not the one that this run kept in {kept}. {cure}"


def need_same(law: str, digest: str) -> None:
    """Raise UserError if the source of a law is not the one with this digest."""
    if digest and source_of(law).digest != digest:
        raise UserError(f"law {law}: its source changed during the sweep. Begin a new sweep.", code=Code.LAW)


def _stamp(module: ModuleType) -> tuple[int, int]:
    try:
        status = Path(str(module.__file__)).stat()
    except OSError:
        return (0, 0)
    return status.st_mtime_ns, status.st_size


def _changed(module: ModuleType) -> bool:
    before, now = _SEEN.get(str(module.__file__)), _stamp(module)
    if before is None:  # some other code imported it; a file older than this process is the one that it imported
        return now[0] / 1e9 > _STARTED
    return before != now


def _user_files(first: ModuleType) -> Iterator[tuple[ModuleType, str, bytes]]:
    """Yield a module and the user's modules that it uses: each with its path below its root, and its source."""
    waiting, seen = [first], {first.__name__}
    while waiting:
        module = waiting.pop(0)
        file = getattr(module, "__file__", None)
        if file is None or module.__name__ == "__main__" or not _is_users(Path(file)):
            continue
        path = Path(file)
        depth = module.__name__.count(".") + (path.name == "__init__.py")
        root = path.parents[min(depth, len(path.parents) - 1)]
        with contextlib.suppress(OSError):
            if path.stat().st_size <= LARGEST:
                text = read_regular(path)
                yield module, path.relative_to(root).as_posix(), text
                for name in _imported(module, text):
                    if name not in seen and (used := sys.modules.get(name)) is not None:
                        seen.add(name)
                        waiting.append(used)


def _imported(module: ModuleType, text: bytes) -> Iterator[str]:
    """Yield the names of the modules that a module may import, by its source, and of the packages that it is in."""
    name = module.__name__
    yield from (name[:k] for k, sign in enumerate(name) if sign == ".")
    package = name if Path(str(module.__file__)).name == "__init__.py" else name.rpartition(".")[0]
    try:
        nodes = [*ast.walk(ast.parse(text))]
    except (SyntaxError, ValueError, RecursionError):
        return
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            yield base
            yield from (f"{base}.{one.name}" for one in node.names)


def _is_users(path: Path) -> bool:
    """Return True for a file that is neither Python's, nor an installed package's, nor ours."""
    whole = path.resolve()
    installed = {"site-packages", "dist-packages"} & set(whole.parts)
    return path.suffix == ".py" and not installed and not any(whole.is_relative_to(folder) for folder in _NOT_USERS)


_NOT_USERS = [
    *(Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib")),
    *(
        Path(__file__).resolve().parents[2] / name
        for name in ("hedgerow", "topologies", "wire", "agents", "plant", "orchestrator")
    ),
]
