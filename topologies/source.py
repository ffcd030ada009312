"""YAML text as plain Python values, with the line of every one of them.

PyYAML parses (libyaml's events, so that depth costs no stack); the values follow the YAML 1.2 core schema,
where `no` is a name and `1e-05` a number. Files are data from strangers: size, depth and what aliases
expand to are bounded before anything is built.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

import yaml

from hedgerow.topologies.errors import Problem, TopologyError

MAX_BYTES = 32 * 2**20
MAX_DEPTH = 32
MAX_VALUES = 5_000_000

Path = tuple[Any, ...]

_INT = re.compile(r"[-+]?[0-9]+\Z")
FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_WORDS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
    **{sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in (".inf", ".Inf", ".INF")},
}
# Python's int() refuses more digits than this in one number.
_MAX_DIGITS = 4000


@dataclass
class Source:
    """What a YAML text says: its `value`, the line of every path in it, and the mistakes met while reading."""

    name: str
    value: Any = None
    lines: dict[Path, int] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def line(self, path: Path) -> int:
        """The line of `path`, or of the nearest thing above it that has one; 0 when nothing has."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 0)


def read_source(name: str, text: bytes) -> Source:
    """Parse YAML; raise TopologyError when it is no YAML at all, keep lesser mistakes in `problems`."""
    source = Source(name)
    try:
        builder = _Builder(source)
        for event in yaml.parse(text.decode("utf-8-sig"), Loader=yaml.CSafeLoader):
            builder.take(event)
    except UnicodeDecodeError as error:
        line = text[: error.start].count(b"\n") + 1
        _refuse(source, line, f"byte {error.start} is not UTF-8 text", "save the file as UTF-8")
    except yaml.reader.ReaderError as error:
        line = text[: error.position].count(b"\n") + 1
        _refuse(source, line, f"not YAML: {error.reason}", "remove the character")
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        rest = text.splitlines()[line - 1 : line]
        tabbed = bool(rest) and b"\t" in rest[0][: len(rest[0]) - len(rest[0].lstrip())]
        what = " ".join(part for part in (error.context, error.problem) if part)
        _refuse(
            source,
            line,
            f"not YAML: {what}",
            "indent with spaces, not tabs" if tabbed else "see the line above it too",
        )
    return source


def _refuse(source: Source, line: int, what: str, cure: str) -> None:
    raise TopologyError(source.name, [*source.problems, Problem(line, "", what, cure)]) from None


@dataclass
class _Open:
    """A collection that is being read: where it is, what it holds, the key that waits for its value."""

    path: Path
    items: dict[Any, Any] | list[Any]
    anchor: str | None
    key: Any = None
    has_key: bool = False
    size: int = 1

    @property
    def next_path(self) -> Path:
        return (*self.path, self.key if isinstance(self.items, dict) else len(self.items))

    @property
    def awaits_key(self) -> bool:
        return isinstance(self.items, dict) and not self.has_key


class _Builder:
    """Builds the values of a source from YAML events, one after the other; depth lives in `stack`, not on Python's."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.stack: list[_Open] = []
        self.anchors: dict[str, tuple[Any, int]] = {}
        self.total = 0
        """values so far, those of aliases counted each time"""
        self.documents = 0

    def take(self, event: Any) -> None:
        line = event.start_mark.line + 1
        if getattr(event, "tag", None) not in (None, "!"):
            _refuse(self.source, line, f"tag {event.tag} is not allowed", "write the plain value")
        match event:
            case yaml.DocumentStartEvent():
                self.documents += 1
                if self.documents > 1:
                    _refuse(self.source, line, "a second document starts here", "keep one network a file")
            case yaml.AliasEvent():
                name = str(event.anchor)
                if name not in self.anchors:
                    what, cure = f"alias *{name} has no value yet", "define the anchor before it is used"
                    _refuse(self.source, line, what, cure)
                self._place(*self.anchors[name], line)
            case yaml.ScalarEvent():
                value = _scalar(event.value) if event.implicit[0] else event.value
                self._place(value, 1, line, event.anchor)
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                self._open({} if isinstance(event, yaml.MappingStartEvent) else [], event.anchor, line)
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                done = self.stack.pop()
                self.total -= done.size - 1  # its members are counted again with it, once
                self._place(done.items, done.size, line, done.anchor)

    def _open(self, items: dict[Any, Any] | list[Any], anchor: str | None, line: int) -> None:
        if len(self.stack) >= MAX_DEPTH:
            _refuse(self.source, line, f"nested more than {MAX_DEPTH} deep", "no topology needs that")
        if self.stack and self.stack[-1].awaits_key:
            _refuse(self.source, line, "a collection cannot be a key", "use a name or a whole number")
        path: Path = ()
        if self.stack:
            path = self.stack[-1].next_path
            self.source.lines.setdefault(path, line)
        self.stack.append(_Open(path, items, anchor))

    def _place(self, value: Any, size: int, line: int, anchor: str | None = None) -> None:
        """Put a finished value where it belongs: into the collection that is open, as a key of it, or at the top."""
        self.total += size
        if self.total > MAX_VALUES:
            what = f"the file expands to more than {MAX_VALUES:,} values"
            _refuse(self.source, line, what, "remove aliases that multiply")
        if anchor:
            self.anchors[anchor] = (value, size)
        if not self.stack:
            self.source.value = value
            return
        top = self.stack[-1]
        top.size += size
        if isinstance(top.items, list):
            self.source.lines.setdefault(top.next_path, line)
            top.items.append(value)
        elif top.has_key:
            top.items[top.key] = value
            top.has_key = False
        else:
            self._take_key(top, value, line)

    def _take_key(self, top: _Open, key: Any, line: int) -> None:
        if isinstance(key, dict | list) or _is_nan(key):
            _refuse(self.source, line, f"{key!r} cannot be a key", "use a name or a whole number")
        path = (*top.path, key)
        if key in top.items:
            what = f"{key!r} stands here twice (first on line {self.source.lines[path]})"
            self.source.problems.append(Problem(line, place_of(top.path), what, "keep one of the two"))
        self.source.lines[path] = line
        top.key, top.has_key = key, True


def _scalar(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    if len(text) <= _MAX_DIGITS and _INT.match(text):
        return int(text)
    return float(text) if FLOAT.match(text) else text


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def place_of(path: Path) -> str:
    """A path as a person says it: `node 3: disturbance: amplitude`, `edge 2`, `fault 1: steps`."""
    words = [str(step) for step in path]
    if len(path) >= 2 and path[0] == "nodes":
        words[:2] = [f"node {path[1]}"]
    elif len(path) >= 2 and path[0] in ("edges", "faults") and isinstance(path[1], int):
        words[:2] = [f"{path[0].removesuffix('s')} {path[1] + 1}"]
    return ": ".join(words)
