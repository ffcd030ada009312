"""The one exception root, the code of every kind of failure, and the exit codes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import ClassVar


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
    """One kind of failure; docs/errors.md lists the cause and the cure of each."""

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
    LAW_CONTRACT = "law-contract"
    RUN_MISSING = "run-missing"
    NETWORK_MISSING = "network-missing"
    NETWORK_AMBIGUOUS = "network-ambiguous"
    PACKAGE_MISSING = "package-missing"
    VERSION = "version"
    CREDENTIALS = "credentials"
    # Circumstances: exit code 3.
    UNKNOWN = "unknown"
    DEADLINE = "deadline"
    WIRE = "wire"
    REFUSED = "refused"
    MESSAGE = "message"
    LIMIT = "limit"
    DISK_FULL = "disk-full"
    # A defect of this project: exit code 70.
    CRASH = "crash"


class HedgerowError(Exception):
    """The root of all errors that this project raises on purpose; the text names place, problem and cure.

    `code` names the kind of failure. A class has a default, and a raise can give a more exact one.
    """

    code: Code
    default_code: ClassVar[Code] = Code.UNKNOWN

    def __init__(self, *args: object, code: Code | None = None) -> None:
        super().__init__(*args)
        self.code = code or self.default_code


class UserError(HedgerowError):
    """A mistake that the user can correct; the command line exits with code 2 and prints no traceback."""

    default_code = Code.USER


MOST = 1e9
"""of what an option counts in seconds, or in steps a second: what is to wait for longer is refused by the system"""


def check_options(**given: float | None) -> None:
    """Raise UserError for seconds that are not above 0, or a `rate` below 0, if they are given; NaN is neither."""
    for name, value in given.items():
        least = "from 0" if name == "rate" else "above 0"
        if value is not None and (not 0 <= value <= MOST or (value == 0 and name != "rate")):
            raise UserError(f"--{name} {value:g}: give a number {least}, and at most {MOST:g}", code=Code.OPTION)


class DeadlineError(HedgerowError):
    """A wait that ran past its deadline; the text names the process that it waited for."""

    default_code = Code.DEADLINE


@dataclass(frozen=True, order=True)
class Problem:
    """One mistake in a topology file: the line (from 1; 0 if unknown), the place, the problem, the cure, its code."""

    line: int
    place: str
    what: str
    cure: str = ""
    code: Code = Code.TOPOLOGY

    def __str__(self) -> str:
        place = f"{self.place}: " if self.place else ""
        return f"{place}{self.what}" + (f"; {self.cure}" if self.cure else "")


class TopologyError(UserError):
    """All mistakes of one topology file, in the order of their lines."""

    default_code = Code.TOPOLOGY

    def __init__(self, source: str, problems: Sequence[Problem]) -> None:
        self.source = source
        self.problems = tuple(sorted(set(problems)))
        super().__init__("\n".join(f"{source}:{p.line}: {p}" if p.line else f"{source}: {p}" for p in self.problems))
        codes = {problem.code for problem in self.problems}
        self.code = codes.pop() if len(codes) == 1 else self.default_code
