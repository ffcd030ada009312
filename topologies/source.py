"""YAML text as plain Python values, with the line, the column and the written text of every one of them.

PyYAML parses (libyaml's events, so that depth costs no stack); the values follow the YAML 1.2 core schema, where `no`
is a name and `1e-05` a number. Files may come from strangers. So size, depth and the expansion of aliases are bounded
before any value is built.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import yaml

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, Problem, Problems, TopologyError
from hedgerow.topologies.foreign import foreign_kind, not_text
from hedgerow.topologies.pages import page

MAX_BYTES = 32 * 2**20
MAX_DEPTH = 32
BYTES_PER_VALUE, BYTES_PER_FAULT = 400, 10_000
"""the memory of a value with its mark and path, and of a fault with its values and effects [bytes]"""

Path = tuple[Any, ...]

_INT = re.compile(r"[-+]?[0-9]+\Z")
_WHOLE_POWER = re.compile(r"[-+]?[0-9]{1,18}[eE]\+?(?:[0-9]|1[0-8])\Z")
"""a whole number with an exponent, such as 1e3"""
_DEEPER = re.compile(r"nest|depth|recursion", re.IGNORECASE)
"""words in the error of a parser that bounds the depth itself"""
OTHER_WHOLE = re.compile(r"[-+]?(0[xX][0-9a-fA-F_]+|0o[0-7_]+|0b[01_]+|[0-9][0-9_]*_[0-9_]*)\Z")
"""whole numbers for some readers of YAML, and text for others"""
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


class Mark(NamedTuple):
    """The place of a value, and its text if Python would show it differently."""

    line: int
    """from 1; 0 for a value of the command line"""
    column: int = 0
    """from 1; 0 if unknown"""
    text: str | None = None
    """a plain scalar as the file has it, such as 12e4"""
    key: str | None = None
    """the same for the key of the value"""
    key_column: int = 0
    origin: str = ""
    """the option of the command line that gave the value"""


_NOWHERE = Mark(0)


@dataclass
class Source:
    """The `value` of a YAML text, the mark of every path in it, and the mistakes found while it was read."""

    name: str
    value: Any = None
    marks: dict[Path, Mark] = field(default_factory=dict)
    problems: Problems = field(default_factory=Problems)
    odd: dict[Path, str] = field(default_factory=dict)
    """whole numbers, values or keys, that are not in their shortest form, such as 007 and 1e3"""
    named: set[str] = field(default_factory=set)
    """paths of files that an option or Python names: they may be outside the topology's folder"""

    def mark(self, path: Path) -> Mark:
        """Return the mark of `path`, or of its nearest ancestor that has one."""
        while path and path not in self.marks:
            path = path[:-1]
        return self.marks.get(path, _NOWHERE)

    def line(self, path: Path) -> int:
        """Return the line of `path`, or of its nearest ancestor that has one; 0 if none has."""
        return self.mark(path).line

    def written(self, path: Path) -> str | None:
        """Return the text of the value at `path` if it is a plain scalar that Python shows differently."""
        mark = self.marks.get(path)
        return None if mark is None else mark.text

    def problem(
        self, path: Path, what: str, cure: str = "", code: Code = Code.TOPOLOGY, place: str | None = None
    ) -> Problem:
        """Return a mistake at `path`; `place` names it in words, if `place_of` does not."""
        mark = self.mark(path)
        place = place_of(path) if place is None else place
        # A mistake placed above its path is a mistake of the key, not of the value.
        of_key = mark.key_column and path and place == place_of(path[:-1])
        return Problem(mark.line, place, what, cure, code, mark.key_column if of_key else mark.column, mark.origin)


def read_source(name: str, text: bytes) -> Source:
    """Parse YAML; raise TopologyError if it is not YAML; collect smaller mistakes in `problems`."""
    source = Source(name)
    try:
        builder = _Builder(source)
        for event in yaml.parse(text.decode("utf-8-sig"), Loader=yaml.CSafeLoader):
            builder.take(event)
    except UnicodeDecodeError as error:
        line = text[: error.start].count(b"\n") + 1
        kind = foreign_kind(text)
        cure = "save the file as UTF-8" if not kind or "UTF-16" in kind else "name a topology file"
        _refuse(source, line, not_text(text, error), cure)
    except yaml.reader.ReaderError as error:
        line = text[: error.position].count(b"\n") + 1
        if foreign_kind(text):
            _refuse(source, 1, not_text(text), "name a topology file")
        _refuse(source, line, f"not YAML: {error.reason}", "remove the character")
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        column = error.problem_mark.column + 1 if error.problem_mark else 0
        if (begins := error.context_mark) is not None and "simple key" in (error.context or ""):
            line, column = begins.line + 1, begins.column + 1  # the problem is found on a later line
        what = " ".join(part for part in (error.context, error.problem) if part)
        if begins is not None and (opened := _OPENED.get(error.context or "")) and _at_end(text, error.problem_mark):
            _refuse(source, begins.line + 1, f"not YAML: {opened[0]}", opened[1], begins.column + 1)
        # A parser may have another limit of the depth, a little earlier or later than ours: the mistake is the same.
        if _DEEPER.search(error.problem or "") or _DEEPER.search(error.context or ""):
            _refuse(source, line, *_TOO_DEEP, column)
        _refuse(source, line, f"not YAML: {what}", _layout(text, line), column)
    except (RecursionError, yaml.YAMLError) as error:
        if isinstance(error, RecursionError) or _DEEPER.search(str(error)):
            _refuse(source, 0, *_TOO_DEEP)
        _refuse(source, 0, f"not YAML: {error}", f"the form of a topology is in {page('topology')}")
    return source


_OPENED = {
    "while scanning a quoted scalar": ("a quote opens here, and nothing closes it", "write the closing quote"),
    "while parsing a flow sequence": ("a [ opens here, and nothing closes it", "write the closing ]"),
    "while parsing a flow mapping": ("a { opens here, and nothing closes it", "write the closing }"),
}
"""by what the parser was reading as the text ended: the mistake at its beginning, and the fix"""


def _at_end(text: bytes, mark: Any) -> bool:
    """Return True if nothing of the text follows the line of a mark."""
    return mark is not None and not any(line.strip() for line in text.splitlines()[mark.line :])


_TOO_DEEP = f"nested more than {MAX_DEPTH} deep", "no topology needs that"
_COLON = re.compile(rb"\s*(?:- )?[{]?\s*\w+:[^\s:/]")


def _layout(text: bytes, line: int) -> str:
    """Return the likely fix for a text that the parser could not read."""
    near = text.splitlines()[max(line - 2, 0) : line]
    if near and b"\t" in near[-1][: len(near[-1]) - len(near[-1].lstrip())]:
        return "indent with spaces, not tabs"
    if any(map(_COLON.match, near)):
        return "write a space after the colon"
    return "see the line above it too"


def _refuse(source: Source, line: int, what: str, cure: str, column: int = 0, code: Code = Code.FILE_FORMAT) -> None:
    # The code shows a caller that memory was the reason, even if the file has other mistakes.
    others: Iterable[Problem] = [] if code == Code.FILE_TOO_LARGE else source.problems
    raise TopologyError(source.name, [*others, Problem(line, "", what, cure, code, column)]) from None


@dataclass
class _Open:
    """A collection that is being read: its place, its content, and the key that waits for its value."""

    path: Path
    items: dict[Any, Any] | list[Any]
    anchor: str | None
    key: Any = None
    has_key: bool = False
    size: int = 1
    bare: bool = False
    """True if the key is plain text with a colon in it, such as {kind:drop}"""

    @property
    def next_path(self) -> Path:
        return (*self.path, self.key if isinstance(self.items, dict) else len(self.items))

    @property
    def awaits_key(self) -> bool:
        return isinstance(self.items, dict) and not self.has_key


class _Builder:
    """The builder of a source's values from YAML events; its depth is in `stack`, not on Python's stack."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.stack: list[_Open] = []
        self.anchors: dict[str, tuple[Any, int]] = {}
        self.total = 0
        """the number of values so far, with those of aliases counted each time"""
        self.most = budget.cap() // BYTES_PER_VALUE
        self.most_faults = budget.cap() // BYTES_PER_FAULT
        self.documents = 0

    def take(self, event: Any) -> None:
        start = event.start_mark
        line, column = start.line + 1, start.column + 1
        if getattr(event, "tag", None) not in (None, "!"):
            _refuse(self.source, line, f"tag {event.tag} is not allowed", _plainly(event.tag), column)
        match event:
            case yaml.DocumentStartEvent():
                self.documents += 1
                if self.documents > 1:
                    _refuse(self.source, line, "a second document starts here", "keep one network a file", column)
            case yaml.AliasEvent():
                name = str(event.anchor)
                if name not in self.anchors:
                    what, cure = f"alias *{name} has no value yet", "define the anchor before it is used"
                    _refuse(self.source, line, what, cure, column)
                self._place(*self.anchors[name], Mark(line, column))
            case yaml.ScalarEvent():
                text = event.value
                if not event.implicit[0]:
                    self._place(text, 1, Mark(line, column), event.anchor)
                    return
                value = _scalar(text)
                # The texts of a large file take memory: store only those that Python would show differently.
                differs = repr(value) != text if not isinstance(value, str) else OTHER_WHOLE.match(text)
                self._place(value, 1, Mark(line, column, text if differs else None), event.anchor, plain=True)
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                self._open({} if isinstance(event, yaml.MappingStartEvent) else [], event.anchor, Mark(line, column))
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                done = self.stack.pop()
                self.total -= done.size - 1  # its members are counted again with the collection, once
                self._place(done.items, done.size, Mark(line, column), done.anchor)

    def _open(self, items: dict[Any, Any] | list[Any], anchor: str | None, mark: Mark) -> None:
        if len(self.stack) >= MAX_DEPTH:
            _refuse(self.source, mark.line, *_TOO_DEEP, mark.column)
        if self.stack and self.stack[-1].awaits_key:
            what, cure = "a collection cannot be a key", "use a name or a whole number"
            _refuse(self.source, mark.line, what, cure, mark.column)
        path: Path = ()
        if self.stack:
            path = self.stack[-1].next_path
            known = self.source.marks.setdefault(path, mark)
            if known.line == mark.line:
                self.source.marks[path] = known._replace(column=mark.column)
        self.stack.append(_Open(path, items, anchor))

    def _place(self, value: Any, size: int, mark: Mark, anchor: str | None = None, plain: bool = False) -> None:
        """Put a finished value in its place: into the open collection, as its key, or at the top."""
        self.total += size
        if self.total > self.most:
            what = f"the file expands to more than {self.most:,} values"
            cure = "remove aliases that multiply, put long samples in a CSV file, or allow more with "
            cure += f"{budget.VARIABLE}={2 * budget.cap() // 10**6}"
            _refuse(self.source, mark.line, what, cure, mark.column, Code.FILE_TOO_LARGE)
        if anchor:
            self.anchors[anchor] = (value, size)
        if not self.stack:
            self.source.value = value
            if not isinstance(value, dict | list):  # a setting of the command line
                self.source.marks[()] = mark
                self._note_odd((), value, mark)
            return
        top = self.stack[-1]
        top.size += size
        if isinstance(top.items, list):
            path = top.next_path
            self.source.marks.setdefault(path, mark)
            self._note_odd(path, value, mark)
            top.items.append(value)
            if len(top.items) > self.most_faults and top.path == ("faults",):
                what, cure = f"more than {self.most_faults:,} faults", budget.cure(2 * budget.cap())
                _refuse(self.source, mark.line, what, cure, mark.column, Code.FILE_TOO_LARGE)
        elif top.has_key:
            if top.bare and value is None and mark.text == "":
                self._split_key(top)
                return
            path = top.next_path
            known = self.source.marks[path]
            if not isinstance(value, dict | list):
                column = mark.column if mark.line == known.line and mark.text != "" else known.column
                self.source.marks[path] = known._replace(text=mark.text, column=column)
                self._note_odd(path, value, mark)
            top.items[top.key] = value
            top.has_key = False
        else:
            self._take_key(top, value, mark, plain)

    def _note_odd(self, path: Path, value: Any, mark: Mark) -> None:
        if mark.text is not None and (type(value) is int or (type(value) is str and OTHER_WHOLE.match(value))):
            self.source.odd[path] = mark.text

    def _take_key(self, top: _Open, key: Any, mark: Mark, plain: bool) -> None:
        if isinstance(key, dict | list) or _is_nan(key):
            what = f"{key!r} cannot be a key"
            _refuse(self.source, mark.line, what, "use a name or a whole number", mark.column)
        path = (*top.path, key)
        if key in top.items:
            what = f"{key!r} occurs twice (first on line {self.source.marks[path].line})"
            place, cure = place_of(top.path), "keep one of the two"
            self.source.problems.append(Problem(mark.line, place, what, cure, column=mark.column))
        self.source.marks[path] = Mark(mark.line, mark.column, None, mark.text, mark.column)
        self._note_odd(path, key, mark)
        top.key, top.has_key = key, True
        top.bare = plain and isinstance(key, str) and bool(_NO_SPACE.match(key))

    def _split_key(self, top: _Open) -> None:
        """Report a key without a space after its colon, and read it as if it had one, so that only this mistake is
        reported.
        """
        key, _, rest = top.key.partition(":")
        mark = self.source.marks.pop((*top.path, top.key))
        what, cure = f"`{top.key}` has no space after the colon", f"write `{key}: {rest}`"
        self.source.problems.append(Problem(mark.line, place_of(top.path), what, cure, column=mark.column))
        top.items.setdefault(key, _scalar(rest))  # type: ignore[union-attr]
        self.source.marks.setdefault((*top.path, key), mark)
        top.has_key = False


_NO_SPACE = re.compile(r"[A-Za-z_]\w*:[^:/]")


def _plainly(tag: str) -> str:
    """Return the fix for a tag."""
    if "numpy" in tag:
        return "write plain numbers and lists (float(x), array.tolist()), with yaml.safe_dump"
    return "write the file with yaml.safe_dump, not yaml.dump" if "python" in tag else "write the plain value"


def _scalar(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    if len(text) <= _MAX_DIGITS and _INT.match(text):
        return int(text)
    if _WHOLE_POWER.match(text):
        digits, power = re.split("[eE]", text)
        return int(digits) * 10 ** int(power)
    return float(text) if FLOAT.match(text) else text


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def place_of(path: Path) -> str:
    """Return a path in words: `node 3: disturbance: amplitude`, `edge 2`, `fault 1: steps`."""
    words = [str(step) for step in path]
    if len(path) >= 2 and path[0] == "nodes":
        words[:2] = [f"node {path[1]}"]
    elif len(path) >= 2 and path[0] in ("edges", "faults") and isinstance(path[1], int):
        words[:2] = [f"{path[0].removesuffix('s')} {path[1] + 1}"]
    return ": ".join(words)
