"""Messages in the words of Python: the option `--max-degree 3` is the argument `max_degree=3`."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from dataclasses import replace
from typing import ParamSpec, TypeVar

from hedgerow.topologies.errors import TopologyError, UserError

P = ParamSpec("P")
T = TypeVar("T")
_SETTING = re.compile(r"(?:^|(?<= ))--set (?=\S)", re.MULTILINE)
_FIRST = re.compile(r"^--([a-z][a-z-]*)(?: (?=\S))?", re.MULTILINE)
_LATER = re.compile(r"(?<=[ `(])--([a-z]+(?:-[a-z]+)*)(?![\w-])(?: (\d[\d.e-]*\d|\d))?")
_OTHER_NAMES = {"reservoir_storage": "reservoirs", "deadline": "deadline_s", "format": "formats"}
"""by the option, with underscores: the argument, if it has another name"""


def in_words_of_python(text: str) -> str:
    """Return a message with arguments of Python in place of options.

    A line that quotes a command keeps its options, except for the one at its start.
    """

    def argument(option: str) -> str:
        name = option.replace("-", "_")
        return _OTHER_NAMES.get(name, name)

    def first(found: re.Match[str]) -> str:
        return argument(found[1]) + ("=" if found[0].endswith(" ") else "")

    def later(found: re.Match[str]) -> str:
        return argument(found[1]) + (f"={found[2]}" if found[2] else "")

    lines = _FIRST.sub(first, _SETTING.sub("", text)).split("\n")
    return "\n".join(line if "orchestrator " in line else _LATER.sub(later, line) for line in lines)


def answers_in_python(function: Callable[P, T]) -> Callable[P, T]:
    """Return the function with the words of Python in each UserError that it raises."""

    @functools.wraps(function)
    def answering(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except UserError as error:
            error.args = tuple(in_words_of_python(one) if isinstance(one, str) else one for one in error.args)
            if isinstance(error, TopologyError):
                error.problems = tuple(replace(one, origin=in_words_of_python(one.origin)) for one in error.problems)
            raise

    return answering
