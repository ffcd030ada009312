"""Values of Python as a topology file has them: numbers of numpy, ranges, classes of laws, models."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from hedgerow.topologies.errors import Code, UserError

DEEPEST = 32
"""A value that contains itself has no end."""
_NAMES_OF_LAWS = {"hedgerow.agents.law:Minimax": "minimax"}


def plain(value: Any, place: str = "", depth: int = DEEPEST) -> Any:
    """Return a value with the types of a file; `place` is the path of keys to it.

    A class becomes `module:Class`, a `functools.partial` of a class a law with its parameters, and a range of `steps`
    a window. Raises UserError for a value that a file cannot have.
    """
    if not depth:
        raise _refused(place, "is too deep, or contains itself", "Give a mapping without cycles")
    value = _of_library(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {_key(key, place): plain(own, f"{place}{key}: ", depth - 1) for key, own in value.items()}
    if isinstance(value, range) and place.endswith("steps: ") and value.step == 1:
        return [value.start, value.stop]
    if isinstance(value, list | tuple | range):
        return [plain(own, place, depth - 1) for own in value]
    if isinstance(value, set | frozenset):
        return sorted((plain(own, place, depth - 1) for own in value), key=repr)  # a set has no order that repeats
    return _law(value, place)


def _of_library(value: Any) -> Any:
    """Return numbers of numpy, models and paths as values of Python, and other values as they are."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, BaseModel):
        return value.written() if hasattr(value, "written") else value.model_dump(mode="json", exclude_none=True)
    return str(value) if isinstance(value, Path) else value


def _law(value: Any, place: str) -> Any:
    """Return a class, or one with parameters, as a file names it."""
    if inspect.isclass(value):
        return law_of_class(value)
    if isinstance(value, functools.partial) and inspect.isclass(value.func) and not value.args:
        law = law_of_class(value.func)
        return {"class" if ":" in law else "name": law, **plain(value.keywords, place)}
    kind = type(value).__name__
    if place == "law: ":
        what = "is a function" if inspect.isroutine(value) else f"is an object of {kind}"
        raise _refused(place, what, "Give a class, or a functools.partial of a class")
    raise _refused(place, f"is of the type {kind}", "Give a number, a text, a list or a mapping")


def law_of_class(law: type) -> str:
    """Return the text of a law in a file: `module:Class`, or the name of a law of the project."""
    text = f"{law.__module__}:{law.__qualname__}"
    return _NAMES_OF_LAWS.get(text, text)


def is_in_script(law: str) -> bool:
    """Return True if a law is defined in the script or notebook that runs, so that only this process has it."""
    return law.startswith("__main__:")


def _key(key: Any, place: str) -> Any:
    if isinstance(key, np.generic):
        return key.item()
    if isinstance(key, str | int | float):
        return key
    raise _refused(place, f"has the key {key!r}", "Give a text or a whole number as the key")


def _refused(place: str, what: str, cure: str) -> UserError:
    return UserError(f"{place or 'the network: '}{what}. {cure}.", code=Code.TOPOLOGY)
