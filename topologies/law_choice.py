"""The choice of a law: its name, or the path of its class, with its parameters.

    minimax                          a law of the project
    mylaws:RLS                       a class, as package.module:Class
    forgetting(decay=0.98)           with parameters, written as in a call

A choice is a text in the file, in a view and in the verdict. Equal choices are equal text.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hedgerow.topologies import law_files

_NAME = re.compile(r"[A-Za-z][\w-]*|[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
_KEY = re.compile(r"[A-Za-z_]\w*", re.ASCII)
NAMES = (
    *("minimax", "hinf", "nominal", "forgetting", "hysteresis", "rls", "bayes", "thompson"),
    *("set-membership", "centred", "notch", "either", "robust"),
)
"""the laws of the project, each a module of agents.laws"""
LISTED: tuple[str, ...] = (
    "minimax",
    "hinf",
    "nominal",
    "forgetting",
    "hysteresis",
    "thompson",
    "set-membership",
    "centred",
)
LISTED += ("notch", "either")
"""the laws that act by equation (6) on an estimate from the node's list, at every step"""
MOST_PARAMETERS = 64
LONGEST = 4096
"""characters of a choice"""


@dataclass(frozen=True)
class LawChoice:
    """A law and its parameters: numbers, texts, booleans, None, and lists of these."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> LawChoice:
        """Return the choice in a text; raise ValueError with the problem."""
        if len(text) > LONGEST:
            raise ValueError(f"is longer than {LONGEST} characters")
        name, bracket, rest = text.strip().partition("(")
        parameters: dict[str, Any] = {}
        if bracket:
            try:
                call = ast.parse(f"f({rest}", mode="eval").body
                if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.args:
                    raise ValueError
                if not all(word.arg for word in call.keywords):
                    raise ValueError
                for word in call.keywords:
                    parameters[str(word.arg)] = _literal(word.value)
            except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError):
                raise ValueError("has parameters that are not written as name(key=value, key=value)") from None
        return cls.of(name.strip(), parameters)

    @classmethod
    def of(cls, name: str, parameters: Mapping[str, Any]) -> LawChoice:
        """Return a checked choice; raise ValueError with the problem."""
        if not _NAME.fullmatch(name):
            raise ValueError(
                f"is neither the name of a law nor package.module:Class{_module_of(name) or law_files.hint(name)}"
            )
        if len(parameters) > MOST_PARAMETERS:
            raise ValueError(f"has more than {MOST_PARAMETERS} parameters")
        for key, value in parameters.items():
            if not isinstance(key, str) or not _KEY.fullmatch(key) or keyword.iskeyword(key):
                raise ValueError(f"has a parameter {key!r}, which is not a name")
            if not _is_plain(value):
                raise ValueError(f"has a parameter {key} that is not a finite number, a text, true, false or a list")
        return cls(name, {key: _listed(value) for key, value in parameters.items()})

    def __str__(self) -> str:
        if not self.parameters:
            return self.name
        return f"{self.name}({', '.join(f'{key}={value!r}' for key, value in sorted(self.parameters.items()))})"


def _module_of(name: str) -> str:
    """Return the fix for a class after a dot, such as `mylaw.Huber`, or after its file, such as `/tmp/mylaw.py:Huber`.

    Empty for another name.
    """
    module, _, own = name.rpartition(".")
    if own[:1].isupper() and _NAME.fullmatch(choice := f"{module}:{own}"):
        return f": write {choice}"
    file, _, own = name.rpartition(":")
    folder, _, module = file.removesuffix(".py").rpartition("/")
    if not folder or not _NAME.fullmatch(choice := f"{module}:{own}"):
        return ""
    return f": write {choice}, and set PYTHONPATH={folder}"


_WORDS = {"true": True, "false": False, "null": None}


def _literal(value: ast.expr) -> Any:
    """Return the value of a literal, of Python or as YAML writes it; raise ValueError for another expression."""
    if isinstance(value, ast.Name) and value.id in _WORDS:
        return _WORDS[value.id]
    return ast.literal_eval(value)


def is_listed(text: str) -> bool:
    """Return True if a law acts by equation (6) on an estimate from the node's list."""
    return text.partition("(")[0].strip() in LISTED


def _is_plain(value: object, depth: int = 0) -> bool:
    if isinstance(value, list | tuple):
        return depth < 3 and len(value) <= 10_000 and all(_is_plain(one, depth + 1) for one in value)
    if isinstance(value, bool | str) or value is None:
        return True
    return isinstance(value, int | float) and math.isfinite(value)


def _listed(value: Any) -> Any:
    return [_listed(one) for one in value] if isinstance(value, list | tuple) else value
