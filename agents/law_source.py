"""The source of a law: the files of its module and of the user's modules that it imports, with their digest.

A run stores a copy in its folder `law/`, because the name of a law does not identify its code.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import inspect
import sys
import sysconfig
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from hedgerow.agents.loading import law_class
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.regular_file import read_regular

LARGEST = 2_000_000
"""the maximum size of a copied file [bytes]"""
MOST_FILES = 200
"""the maximum number of files of a law; the modules that it imports directly come first"""


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
        """Return the files in the folder of a run; none if it has no copy."""
        files = {}
        with contextlib.suppress(OSError):
            for path in sorted(folder.rglob("*.py")):
                if path.is_file() and not path.is_symlink() and path.stat().st_size <= LARGEST:
                    files[path.relative_to(folder).as_posix()] = read_regular(path)
        return cls(files)


def source_of(law: str) -> LawSource:
    """Return the source of a law from the text of its choice; it has no files if the law is the project's.

    This loads the module of the law; raise UserError if that fails.
    """
    name = LawChoice.parse(law).name
    if ":" not in name:
        return LawSource()
    loaded = law_class(name)
    module = sys.modules.get(loaded.__module__)
    files = {one.path: one.source for one in user_files(module)} if module is not None else {}
    if not files:  # a class of a notebook is in no file
        with contextlib.suppress(OSError, TypeError):
            files = {f"{loaded.__module__.rpartition('.')[2]}.py": inspect.getsource(loaded).encode()}
    return LawSource(files)


def source_digest(law: str) -> str:
    """Return the digest of the source of a law; empty for a law of the project, or if it cannot be loaded here."""
    if ":" not in law.partition("(")[0]:
        return ""
    with contextlib.suppress(UserError):
        return source_of(law).digest
    return ""


def need_source(law: str, digest: str) -> None:
    """Raise UserError if the local source of a law differs from that of the operator, which has this digest.

    A law from an installed package has no files here, and is trusted.
    """
    if digest and (here := source_of(law)).files and here.digest != digest:
        raise UserError(
            f"law {law}: its source here ({', '.join(list(here.files)[:3])}) is not the one of the operator. Copy the"
            " files that `orchestrator bundle` wrote to this machine.",
            code=Code.LAW,
        )


class UserFile(NamedTuple):
    """A module of the user."""

    module: str
    file: Path
    path: str
    """the path from the folder that is on the module path"""
    source: bytes
    uses: Sequence[str]
    """the names of modules that it may import"""


def user_files(first: ModuleType) -> Iterator[UserFile]:
    """Yield a module and the user's modules that it may import, loaded or not."""
    waiting, seen, count = deque([first.__name__]), {first.__name__}, 0
    while waiting and count < MOST_FILES:
        name = waiting.popleft()
        file = _file_of(name)
        if file is None or name == "__main__" or not _is_users(file):
            continue
        depth = name.count(".") + (file.name == "__init__.py")
        root = file.parents[min(depth, len(file.parents) - 1)]
        with contextlib.suppress(OSError):
            text = _read(file)
            if text is None:
                continue
            above = [name[:k] for k, sign in enumerate(name) if sign == "."]
            uses = [*_imported(name, file, text.imports)]
            yield UserFile(name, file, file.relative_to(root).as_posix(), text.source, uses)
            count += 1
            for one in (*above, *uses):
                if one not in seen:
                    seen.add(one)
                    waiting.append(one)


def _file_of(name: str) -> Path | None:
    """Return the source file of a module, loaded or not, without importing anything; None if there is none."""
    if (module := sys.modules.get(name)) is not None:
        file = getattr(module, "__file__", None)
        return None if file is None else Path(file)
    above, _, last = name.rpartition(".")
    with contextlib.suppress(ImportError, ValueError, OSError):
        if not above:
            spec = PathFinder.find_spec(name)
            return None if spec is None or not spec.has_location or spec.origin is None else Path(spec.origin)
        package = _file_of(above)
        if package is not None and package.name == "__init__.py" and _is_users(package):
            for file in (package.with_name(last) / "__init__.py", package.with_name(f"{last}.py")):
                if file.is_file():
                    return file
    return None


class _Text(NamedTuple):
    """The last reading of a source file."""

    stamp: tuple[int, int]
    source: bytes
    imports: Sequence[tuple[int, str, Sequence[str]]]
    """level, module and names of every import; the level is -1 for `import a, b`, which has names only"""


_READ: dict[str, _Text] = {}


def _read(path: Path) -> _Text | None:
    """Return a file and its imports, parsed once per change; None if it is too large. Raises OSError."""
    status = path.stat()
    stamp = status.st_mtime_ns, status.st_size
    if status.st_size > LARGEST:
        return None
    known = _READ.get(str(path))
    if known is None or known.stamp != stamp:
        source = read_regular(path)
        known = _READ[str(path)] = _Text(stamp, source, _imports(source))
    return known


def _imports(source: bytes) -> list[tuple[int, str, Sequence[str]]]:
    try:
        nodes = [*ast.walk(ast.parse(source))]
    except (SyntaxError, ValueError, RecursionError):
        return []
    found: list[tuple[int, str, Sequence[str]]] = []
    for node in nodes:
        if isinstance(node, ast.Import):
            found.append((-1, "", [one.name for one in node.names]))
        elif isinstance(node, ast.ImportFrom):
            found.append((node.level, node.module or "", [one.name for one in node.names]))
    return found


def _imported(name: str, file: Path, imports: Sequence[tuple[int, str, Sequence[str]]]) -> Iterator[str]:
    """Yield the names of the modules that a module may import, by its source."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for level, base, names in imports:
        if level < 0:
            yield from names
            continue
        whole = base
        if level:
            above = package.split(".")[: len(package.split(".")) - level + 1]
            whole = ".".join([*above, base] if base else above)
        yield whole
        yield from (f"{whole}.{one}" for one in names)


@functools.cache
def _is_users(path: Path) -> bool:
    """Return True for a file that is neither Python's, nor an installed package's, nor ours."""
    whole = path.resolve()
    installed = {"site-packages", "dist-packages"} & set(whole.parts)
    return path.suffix == ".py" and not installed and not any(whole.is_relative_to(folder) for folder in _NOT_USERS)


_NOT_USERS = [
    *(Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib")),
    *(
        Path(__file__).resolve().parents[1] / name
        for name in ("hedgerow", "topologies", "wire", "agents", "plant", "orchestrator")
    ),
]
