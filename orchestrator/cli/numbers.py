"""Options and arguments that are numbers or one of some words, with messages in our words.

The library of the command line would refuse `1e3` as a whole number, and report it in the words of a validator.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Sequence
from decimal import Decimal
from typing import Any

import typer

from hedgerow.topologies.cures import cure_of_number
from hedgerow.topologies.escape import shorten

_SPELLING = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_MOST_DIGITS = 400
"""Longer texts are refused before they are converted: the time of a conversion grows with the square of the length."""
_MOST_POWER = 300
_SHOWN = 60


def whole(help: str, *names: str, metavar: str = "N", low: int | None = None, high: int | None = None) -> Any:
    """Return an option that is a whole number from `low` to `high`, such as 1000 or 1e3."""
    return typer.Option(*names, metavar=metavar, help=_with_range(help, low, high), parser=_parser(True, low, high))


def real(help: str, *names: str, metavar: str = "R", low: float | None = None, high: float | None = None) -> Any:
    """Return an option that is a finite number from `low` to `high`."""
    return typer.Option(*names, metavar=metavar, help=_with_range(help, low, high), parser=_parser(False, low, high))


def whole_argument(help: str, *, metavar: str, low: int | None = None) -> Any:
    """Return an argument that is a whole number from `low`."""
    return typer.Argument(metavar=metavar, help=_with_range(help, low, None), parser=_parser(True, low, None))


def real_argument(help: str, *, metavar: str, low: float | None = None) -> Any:
    """Return an argument that is a finite number from `low`."""
    return typer.Argument(metavar=metavar, help=_with_range(help, low, None), parser=_parser(False, low, None))


def whole_of(text: str, low: int | None = None, high: int | None = None) -> int:
    """Return the whole number in a text; raise typer.BadParameter with what was written, and the fix."""
    shown = shorten(text, _SHOWN) or "an empty text"
    value = _value(text)
    if value is None or value != int(value):
        raise typer.BadParameter(f"{shown} is not a whole number. {_cure(text, value, True)}")
    return int(_in_range(int(value), shown, low, high))


def real_of(text: str, low: float | None = None, high: float | None = None) -> float:
    """Return the finite number in a text; raise typer.BadParameter with what was written, and the fix."""
    shown = shorten(text, _SHOWN) or "an empty text"
    value = _value(text)
    if value is None:
        raise typer.BadParameter(f"{shown} is not a finite number. {_cure(text, None, False)}")
    return float(_in_range(value, shown, low, high))


def _value(text: str) -> int | float | None:
    """Return the number that a text spells, as an integer if it is one; None for other texts."""
    spelled = text.strip()
    if len(spelled) > _MOST_DIGITS or not _SPELLING.fullmatch(spelled):
        return None
    exact = Decimal(spelled)
    if not exact:
        return 0
    # The power of ten bounds the digits of the integer that is made here.
    if abs(exact.adjusted()) > _MOST_POWER:
        return None
    return int(exact) if exact == exact.to_integral_value() else float(exact)


def _cure(text: str, value: float | None, is_whole: bool) -> str:
    if value is not None:
        return f"Write {math.floor(value)} or {math.ceil(value)}."
    if _SPELLING.fullmatch(text.strip()):
        return "Choose a number with fewer digits."
    cure = cure_of_number(text.strip(), whole=is_whole)
    return f"{cure[:1].upper()}{cure[1:]}."


def _in_range(value: float, shown: str, low: float | None, high: float | None) -> float:
    if low is not None and value < low:
        raise typer.BadParameter(f"{shown} is below {low:g}. Choose a larger number.")
    if high is not None and value > high:
        raise typer.BadParameter(f"{shown} is above {high:g}. Choose a smaller number.")
    return value


def choice(help: str, *names: str, metavar: str, words: Sequence[str]) -> Any:
    """Return an option that is one of some words."""

    def parse(given: str) -> str:
        if given in words:
            return given
        near = difflib.get_close_matches(given.lower(), words, 1)
        hint = f"Did you mean {near[0]}?" if near else f"Write {' or '.join(words)}."
        raise typer.BadParameter(f"{shorten(given, _SHOWN)} is none of {', '.join(words)}. {hint}")

    return typer.Option(*names, metavar=metavar, help=help, parser=parse)


def _parser(is_whole: bool, low: float | None, high: float | None) -> Callable[[Any], Any]:
    def parse(given: Any) -> Any:
        if not isinstance(given, str):  # the default value, which some releases of typer pass through here
            return given
        return whole_of(given, low, high) if is_whole else real_of(given, low, high)  # type: ignore[arg-type]

    return parse


def _with_range(help: str, low: float | None, high: float | None) -> str:
    if high is None and not low:
        return help
    return f"{help}, {f'from {low:g}' if high is None else f'{low:g} to {high:g}'}"
