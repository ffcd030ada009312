"""YAML text as plain Python values, with the line of every one of them.

PyYAML parses (libyaml's events, so that depth costs no stack); the values follow the YAML 1.2 core schema,
where `no` is a name and `1e-05` a number. Files are data from strangers: size, depth and what aliases
expand to are bounded before anything is built.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import yaml

from topologies.errors import Problem, TopologyError

MAX_BYTES = 32 * 2**20
MAX_DEPTH = 32
MAX_VALUES = 5_000_000

Path = tuple[str | int, ...]

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
        _build(text.decode("utf-8-sig"), source)
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


def _build(text: str, source: Source) -> None:  # noqa: PLR0912, PLR0915 (one switch over the kinds of events)
    anchors: dict[str, tuple[Any, int]] = {}
    stack: list[_Open] = []
    total = documents = 0

    def refuse(mark: Any, what: str, cure: str) -> None:
        _refuse(source, mark.line + 1, what, cure)

    def path_here(line: int) -> Path:
        if not stack:
            return ()
        top = stack[-1]
        step = top.key if isinstance(top.items, dict) and top.has_key else len(top.items)
        path = (*top.path, step)
        source.lines.setdefault(path, line)
        return path

    def place(value: Any, size: int, mark: Any) -> None:
        nonlocal total
        total += size
        if total > MAX_VALUES:
            refuse(
                mark,
                f"the file expands to more than {MAX_VALUES:,} values",
                "remove aliases that multiply",
            )
        if not stack:
            source.value = value
            return
        top = stack[-1]
        top.size += size
        if isinstance(top.items, list):
            source.lines.setdefault((*top.path, len(top.items)), mark.line + 1)
            top.items.append(value)
        elif top.has_key:
            top.items[top.key] = value
            top.has_key = False
        elif isinstance(value, str | int | float | None) and value == value:
            path = (*top.path, value)
            if value in top.items:
                where = f"first on line {source.lines[path]}"
                what = f"{value!r} stands here twice ({where})"
                source.problems.append(Problem(mark.line + 1, place_of(top.path), what, "keep one of the two"))
            source.lines[path] = mark.line + 1
            top.key, top.has_key = value, True
        else:
            refuse(mark, f"{value!r} cannot be a key", "use a name or a whole number")

    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        mark = event.start_mark
        match event:
            case yaml.DocumentStartEvent():
                documents += 1
                if documents > 1:
                    refuse(mark, "a second document starts here", "keep one network a file")
            case yaml.AliasEvent():
                if event.anchor not in anchors:
                    refuse(
                        mark,
                        f"alias *{event.anchor} has no value yet",
                        "define the anchor before it is used",
                    )
                place(*anchors[event.anchor], mark)
            case yaml.ScalarEvent():
                if event.tag not in (None, "!"):
                    refuse(mark, f"tag {event.tag} is not allowed", "write the plain value")
                value = _scalar(event.value) if event.implicit[0] else event.value
                if event.anchor:
                    anchors[event.anchor] = (value, 1)
                place(value, 1, mark)
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                if event.tag not in (None, "!"):
                    refuse(mark, f"tag {event.tag} is not allowed", "write the plain value")
                if len(stack) >= MAX_DEPTH:
                    refuse(mark, f"nested more than {MAX_DEPTH} deep", "no topology needs that")
                if stack and isinstance(stack[-1].items, dict) and not stack[-1].has_key:
                    refuse(mark, "a collection cannot be a key", "use a name or a whole number")
                items: dict[Any, Any] | list[Any] = {} if isinstance(event, yaml.MappingStartEvent) else []
                stack.append(_Open(path_here(mark.line + 1), items, event.anchor))
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                done = stack.pop()
                total -= done.size - 1  # its members are counted again with it, once
                if done.anchor:
                    anchors[done.anchor] = (done.items, done.size)
                place(done.items, done.size, mark)


def _scalar(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    if len(text) <= _MAX_DIGITS and _INT.match(text):
        return int(text)
    return float(text) if FLOAT.match(text) else text


def place_of(path: Path) -> str:
    """A path as a person says it: `node 3: disturbance: amplitude`, `edge 2`."""
    words = [str(step) for step in path]
    if len(path) >= 2 and path[0] == "nodes":
        words[:2] = [f"node {path[1]}"]
    elif len(path) >= 2 and path[0] == "edges" and isinstance(path[1], int):
        words[:2] = [f"edge {path[1] + 1}"]
    return ": ".join(words)
