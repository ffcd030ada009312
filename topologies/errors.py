"""The root of all exceptions, the code of every kind of failure, and the exit codes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from functools import cached_property
from typing import ClassVar

from hedgerow.topologies.escape import escape, shorten


class Exit(IntEnum):
    """The exit codes of every command."""

    VALID = 0
    INVALID = 1
    """A check of the run failed."""
    USER_MISTAKE = 2
    UNKNOWN = 3
    """The run ended before it could be judged."""
    CRASH = 70
    """A defect of this project."""


class Code(StrEnum):
    """One kind of failure; docs/errors.md lists the cause and the fix of each."""

    # The user's mistakes: exit code 2.
    USER = "user"
    OPTION = "option"
    FILE_MISSING = "file-missing"
    FILE_UNREADABLE = "file-unreadable"
    FILE_FORMAT = "file-format"
    FILE_AMBIGUOUS = "file-ambiguous"
    FILE_TOO_LARGE = "file-too-large"
    FILE_NOT_REGULAR = "file-not-regular"
    OUTPUT = "output"
    TOPOLOGY = "topology"
    FAULT = "fault"
    LAW = "law"
    DEPENDENCY = "dependency"
    RUN_MISSING = "run-missing"
    NOT_RECORDED = "not-recorded"
    NETWORK_MISSING = "network-missing"
    NETWORK_AMBIGUOUS = "network-ambiguous"
    # Circumstances: exit code 3.
    UNKNOWN = "unknown"
    VERDICT = "verdict"
    DEADLINE = "deadline"
    WIRE = "wire"
    REFUSED = "refused"
    MESSAGE = "message"
    LIMIT = "limit"
    VIEWER = "viewer"
    # A defect of this project: exit code 70.
    CRASH = "crash"


class HedgerowError(Exception):
    """The root of all errors that this project raises on purpose; the text gives place, problem and fix.

    `code` names the kind of failure. A class has a default, and a raise can give a more exact one.
    """

    code: Code
    default_code: ClassVar[Code] = Code.UNKNOWN

    def __init__(self, *args: object, code: Code | None = None) -> None:
        super().__init__(*(bounded(one) if isinstance(one, str) else one for one in args))
        self.code = code or self.default_code

    def __str__(self) -> str:
        """Return the text, escaped: Python and pytest print it to a terminal as it is."""
        return escape(super().__str__())


MOST_CHARACTERS = 12_000
"""of a message: 20 lines, of which each may quote a long name"""


def bounded(text: str) -> str:
    """Return a text of at most `MOST_CHARACTERS`: of a longer one the beginning and, with the fix, the end."""
    if len(text) <= MOST_CHARACTERS:
        return text
    return f"{text[: MOST_CHARACTERS - 2000]} … {text[3 - 2000 :]}"


class UserError(HedgerowError):
    """A mistake that the user can correct. The command line prints the message without a traceback, and exits with 2.

    `code` is the kind of mistake. Without one, a message that begins with an option has the code OPTION.
    """

    default_code = Code.USER

    def __init__(self, *args: object, code: Code | None = None) -> None:
        is_of_option = args and str(args[0]).startswith("--")
        super().__init__(*args, code=code or (Code.OPTION if is_of_option else None))


MOST = 1e9
"""The maximum of an option in seconds, or in steps per second; the system refuses longer waits."""


def check_options(**given: object) -> None:
    """Raise UserError for seconds that are not above 0, for a `rate` below 0, or for `jobs` below 1.

    None passes, as an option that is not given; NaN and what is no number do not.
    """
    for name, value in given.items():
        if name == "jobs":
            right, cure = isinstance(value, int) and value >= 1, "give a whole number from 1, or none for all cores"
        else:
            least = "from 0" if name == "rate" else "above 0"
            right = isinstance(value, int | float) and 0 <= value <= MOST and (value > 0 or name == "rate")
            cure = f"give a number {least}, and at most {MOST:g}"
        if value is not None and (not right or isinstance(value, bool)):
            shown = f"{value:g}" if isinstance(value, float) else value
            raise UserError(f"--{name} {shown}: {cure}", code=Code.OPTION)


def check_switches(**given: object) -> None:
    """Raise UserError for a value that is neither True nor False: any text would be true."""
    for name, value in given.items():
        if not isinstance(value, bool):
            raise UserError(f"{name}={shorten(repr(value))}: is neither True nor False. Give one.", code=Code.OPTION)


class DeadlineError(HedgerowError):
    """A wait that exceeded its deadline; the text names the missing process."""

    default_code = Code.DEADLINE


class FileRefusedError(ValueError):
    """A file beside the topology that cannot be used: the problem with its place, the fix, the code."""

    def __init__(self, what: str, cure: str = "", code: Code = Code.FILE_FORMAT) -> None:
        super().__init__(f"{what}; {cure}" if cure else what)
        self.what, self.cure, self.code = what, cure, code

    @classmethod
    def of(cls, error: ValueError) -> FileRefusedError:
        """Return the same refusal with the fields of this class."""
        return error if isinstance(error, cls) else cls(str(error))


@dataclass(frozen=True, order=True)
class Problem:
    """One mistake in a topology file: the line (from 1; 0 if unknown), the place, the problem, the fix, its code."""

    line: int
    place: str
    what: str
    cure: str = ""
    code: Code = Code.TOPOLOGY
    column: int = 0
    """the column, from 1; 0 if unknown"""
    origin: str = ""
    """the option that the value comes from, such as `--set b=-1`; empty for a value of the file"""

    def __str__(self) -> str:
        place = f"{self.place}: " if self.place else ""
        return f"{place}{self.what}" + (f"; {self.cure}" if self.cure else "")

    def where(self, source: str) -> str:
        """Return `option` or `file:line:column`, the start of the message."""
        if self.origin:
            return self.origin
        at = [source, *([str(self.line)] if self.line else []), *([str(self.column)] if self.column else [])]
        return ":".join(at)

    @cached_property
    def kind(self) -> tuple[str, str, str, str]:
        """Return the key of equal mistakes: the whole mistake without ids, numbers and quoted values."""
        return _NAMED.sub(r"\1", self.place), _VALUES.sub("…", self.what), self.code, self.origin


_NAMED = re.compile(r"\b(node|edge|fault) [^:\s]+|(?<=: )\d+(?=$|:)")
_VALUES = re.compile(
    r"\[[^\]]*\]|\{[^}]*\}|`[^`]*`|\"(?:[^\"\\]|\\.)*\"|'(?:[^'\\]|\\.)*'|\([^)]*\)"
    r"|(?<!\w)[-+]?\.?\d[\w.+-]*(?: and \d\S*)?|\b(?:true|false|null|NaN|Infinity)\b|(?<=^)\S+(?= and \S+ are not )"
)


class Problems:
    """The mistakes of one file: the first ones as they are, and all of them counted by kind.

    A file can have a mistake in each of 10^6 rows. At most `KEPT` mistakes are held, so that memory stays bounded.
    """

    KEPT = 1000
    ALONE = 3
    """up to this many equal mistakes have a line each"""
    SHOWN = 20
    """lines of a message"""

    def __init__(self, problems: Iterable[Problem] = ()) -> None:
        self._problems: dict[Problem, None] = {}
        self._counts: dict[tuple[str, str, str, str], int] = {}
        self._others = 0
        """the number of mistakes of further kinds; `_counts` is full"""
        self.extend(problems)

    def append(self, problem: Problem) -> None:
        """Add a mistake, once."""
        if problem in self._problems:
            return
        if (kind := problem.kind) in self._counts:
            self._counts[kind] += 1
        elif len(self._counts) < self.KEPT:
            self._counts[kind] = 1
        else:
            self._others += 1
            return
        # Keep room for the first mistake of each later kind: a message names every kind by its first mistake.
        if self._counts[kind] == 1 or len(self._problems) < self.KEPT:
            self._problems[problem] = None

    def count_more(self, like: Problem) -> None:
        """Count one more mistake of the same kind as `like`, which was appended before."""
        kind = like.kind
        if kind in self._counts:
            self._counts[kind] += 1
        else:
            self._others += 1

    def extend(self, problems: Iterable[Problem]) -> None:
        """Add mistakes one by one, as they are found."""
        if isinstance(problems, Problems):
            known = dict(self._counts)
            for problem in problems:
                self.append(problem)
            for kind, count in problems._counts.items():
                self._counts[kind] = known.get(kind, 0) + count
            self._others += problems._others
            return
        for problem in problems:
            self.append(problem)

    def __iter__(self) -> Iterator[Problem]:
        return iter(self._problems)

    def __len__(self) -> int:
        return sum(self._counts.values()) + self._others

    def lines(self, source: str) -> list[str]:
        """Return the message: a line for each kind of mistake, or for each mistake if few are equal; at most 20."""
        grouped: dict[tuple[str, str, str, str], list[Problem]] = {}
        for problem in sorted(self._problems, key=_in_order):
            grouped.setdefault(problem.kind, []).append(problem)
        lines: list[tuple[Problem, str, int]] = []
        for kind, found in grouped.items():
            count = self._counts[kind]
            if count <= self.ALONE:
                lines += [(one, f"{one.where(source)}: {one}", 1) for one in found]
            else:
                lines.append((found[0], f"{found[0].where(source)}: {_grouped(found, count)}", count))
        lines.sort(key=lambda line: _in_order(line[0]))
        shown = lines[: self.SHOWN] if len(lines) <= self.SHOWN else lines[: self.SHOWN - 1]
        if more := len(self) - sum(count for _, _, count in shown):
            return [*(text for _, text, _ in shown), f"{source}: and {more} more mistake{'s' if more > 1 else ''}"]
        return [text for _, text, _ in shown]


def _in_order(problem: Problem) -> tuple[int, int, Problem]:
    return problem.line, problem.column, problem


def _grouped(found: Sequence[Problem], count: int) -> str:
    """Return one line for equal mistakes: their number, the problem of the first one, and its line."""
    first = found[0]
    named, _, inside = first.place.partition(": ")
    noun, _, name = named.partition(" ")
    differ = any(one.place.partition(": ")[0] != named for one in found)
    if name and noun in ("node", "edge", "fault") and differ:
        subject = f"{count} {noun}s: " + (f"{inside}: " if inside else "")
    else:
        subject = f"{count} mistakes: " + (f"{first.place}: " if first.place else "")
    at = f", first at line {first.line}" if first.line else ""
    return f"{subject}{first.what}{at}" + (f"; {first.cure}" if first.cure else "")


class TopologyError(UserError):
    """All mistakes of one topology file, in the order of their lines; of very many, the first 1000."""

    default_code = Code.TOPOLOGY

    def __init__(self, source: str, problems: Iterable[Problem]) -> None:
        found = problems if isinstance(problems, Problems) else Problems(problems)
        self.source = source
        self.problems = tuple(sorted(found, key=_in_order))
        self.count = len(found)
        """the number of all mistakes, including those that are not in `problems`"""
        super().__init__("\n".join(found.lines(source)))
        codes = {problem.code for problem in self.problems}
        self.code = codes.pop() if len(codes) == 1 else self.default_code

    def without_lines(self) -> None:
        """Remove the lines and columns of the mistakes, for a network that no file holds."""
        text = re.sub(rf"^({re.escape(self.source)}):\d+(:\d+)?(?=: )", r"\1", str(self.args[0]), flags=re.MULTILINE)
        self.args = (re.sub(r", first at line \d+", "", text),)
        self.problems = tuple(replace(problem, line=0, column=0) for problem in self.problems)

    @property
    def summary(self) -> str:
        """Return the number of mistakes, and their source: the file or the command line."""
        origins = {problem.origin for problem in self.problems}
        where = f"in {self.source}" if "" in origins else "on the command line"
        return f"{self.count} mistake{'s' if self.count > 1 else ''} {where}"
