"""The one exception root, and a user's mistake as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class HedgerowError(Exception):
    """Anything that this project raises on purpose; its text says what, where, and what to do."""


class UserError(HedgerowError):
    """A mistake that the user can mend; the command line ends with exit code 2 and no traceback."""


MOST = 1e9
"""of what an option counts in seconds, or in steps a second: what is to wait for longer is refused by the system"""


def check_options(**given: float | None) -> None:
    """Raise UserError for seconds that are not above 0, or a `rate` below 0, if they are given; NaN is neither."""
    for name, value in given.items():
        least = "from 0" if name == "rate" else "above 0"
        if value is not None and (not 0 <= value <= MOST or (value == 0 and name != "rate")):
            raise UserError(f"--{name} {value:g}: give a number {least}, and at most {MOST:g}")


class DeadlineError(HedgerowError):
    """A wait that ran past its deadline; the text names who was waited for."""


@dataclass(frozen=True, order=True)
class Problem:
    """One mistake in a topology file: the line (from 1, 0 if it has none), the place, what is wrong, the cure."""

    line: int
    place: str
    what: str
    cure: str = ""

    def __str__(self) -> str:
        place = f"{self.place}: " if self.place else ""
        return f"{place}{self.what}" + (f"; {self.cure}" if self.cure else "")


class TopologyError(UserError):
    """Every mistake of one topology file, in the order of its lines."""

    def __init__(self, source: str, problems: Sequence[Problem]) -> None:
        self.source = source
        self.problems = tuple(sorted(set(problems)))
        super().__init__("\n".join(f"{source}:{p.line}: {p}" if p.line else f"{source}: {p}" for p in self.problems))
