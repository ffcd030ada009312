"""A law from its name: its class, its parameters, and the law of a view."""

from __future__ import annotations

import dataclasses
import difflib
import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hedgerow.agents import hard_exit
from hedgerow.agents.law import Array, Law
from hedgerow.agents.law_lines import line_of, place_in_module, place_of
from hedgerow.agents.laws import LAWS, law_of_name
from hedgerow.agents.local import Local, asks
from hedgerow.agents.view import View
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.pages import page
from hedgerow.wire import crash


class LawError(UserError):
    """A law that failed while it ran, or that breaks the contract of laws; a restart of its agent would not help."""

    default_code = Code.LAW

    def __init__(self, text: str, *, method: str = "", node: int | str | None = None) -> None:
        super().__init__(text)
        self.method, self.node = method, node
        """the method that failed, and the node if it is known"""


def law_class(name: str) -> type[Law]:
    """Return the class of a law of the project, or of `package.module:Class`, also in the working directory."""
    if name in LAWS:
        return law_of_name(name)
    hard_exit.guard()
    module, _, attribute = name.partition(":")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    try:
        # A stale .pyc file would hide an edit within the second of its writing that keeps the size.
        before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
        try:
            law: type[Law] = getattr(importlib.import_module(module), attribute)
        finally:
            sys.dont_write_bytecode = before
    except (Exception, SystemExit) as error:
        where = place_in_module(error)
        cure = "Correct that line." if where else _cure_of_name(module, attribute)
        why = crash.summary(error)
        raise UserError(f"{where}law {name}: cannot be loaded: {why}. {cure}", code=Code.LAW) from error
    if missing := [method for method in ("act", "learn", "report") if not callable(getattr(law, method, None))]:
        raise UserError(
            f"law {name}: has no {', '.join(missing)}(); a law has act, learn and report ({page('laws')})",
            code=Code.LAW,
        )
    if not isinstance(law, type):
        kind = type(law).__name__
        raise UserError(
            f"law {name}: is no class, but of the type {kind}. Give a class ({page('laws')}).", code=Code.LAW
        )
    return law


def _cure_of_name(module: str, attribute: str) -> str:
    """Return the fix of a name that cannot be loaded."""
    if module.endswith(".py"):
        return f"Write {module[:-3]}:{attribute}."
    loaded = sys.modules.get(module)
    if loaded is None:
        own = [file.stem for file in Path().glob("*.py")]
        if near := difflib.get_close_matches(module, own, 1):
            return f"Did you mean {near[0]}:{attribute}?"
        return f"Give package.module:Class, importable here ({page('laws')})."
    file = getattr(loaded, "__file__", None)
    place = f"{module} is {file}" if file else f"{module} is a module of Python"
    classes = [one for one, value in vars(loaded).items() if isinstance(value, type)]
    near = difflib.get_close_matches(attribute, classes, 1)
    return f"{place}. " + (f"Did you mean {near[0]}?" if near else "Name a class of it, or rename your module.")


_OURS = ("self", "b", "candidates", "local", "parameters")
"""arguments of a constructor that are not parameters of the law"""


def declared(law: type[Any]) -> dict[str, Any]:
    """Return the default of every parameter that a class declares; `dataclasses.MISSING` for a required one.

    A class declares its parameters by a nested dataclass or pydantic model `Parameters`, which its constructor receives
    as `parameters`; or by keyword-only arguments of its constructor.
    """
    group = getattr(law, "Parameters", None)
    source = group if group is not None else law.__init__
    try:
        listed = inspect.signature(source).parameters.values()
    except (TypeError, ValueError):
        return {}
    made = _factories(law if group is None else group)
    return {
        one.name: made[one.name]()
        if one.name in made
        else dataclasses.MISSING
        if one.default is one.empty
        else one.default
        for one in listed
        if one.name not in _OURS and (group is not None or one.kind is one.KEYWORD_ONLY)
    }


def _factories(group: Any) -> dict[str, Callable[[], Any]]:
    """Return the factories of the defaults of a dataclass or a pydantic model, by field."""
    listed: dict[str, Any]
    if dataclasses.is_dataclass(group):
        listed = {one.name: one.default_factory for one in dataclasses.fields(group)}
    else:  # no import of pydantic here: an agent loads it only if its law does
        listed = {key: getattr(one, "default_factory", None) for key, one in getattr(group, "model_fields", {}).items()}
    return {key: made for key, made in listed.items() if made not in (None, dataclasses.MISSING)}


def arguments(law: type[Law], parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters as the keyword arguments of a constructor."""
    group = getattr(law, "Parameters", None)
    return dict(parameters) if group is None else {"parameters": group(**parameters)}


def reals(given: object) -> Array:
    """Return a copy of what a law returned as an array of floats; raise TypeError for complex numbers."""
    array = np.array(given)
    if array.dtype.kind == "c":
        raise TypeError("these are complex numbers, and not real ones")
    return array.astype(float, copy=False)


def new_law(view: View) -> Law:
    """Return the law of a view, before any sample; UserError if it cannot be loaded, LawError if it cannot begin."""
    choice = LawChoice.parse(view.law)
    law = law_class(choice.name)
    try:
        more = arguments(law, choice.parameters)
        if asks(law.__init__, "local"):
            more["local"] = local_of(view, choice.parameters)
        begun = law(view.b, view.candidates, **more)
        shape = np.shape(begun.memory)
    except (Exception, SystemExit) as error:
        problem = f"__init__() raised {crash.summary(error)}. Correct that line."
        raise LawError(f"{place_of(error, law)}law {view.law}: {problem}", method="__init__") from error
    if shape[-1:] != (view.k,):
        problem = f"memory has the shape {shape}. Make its last axis the {view.k} nodes."
        raise LawError(f"{line_of(law, 'memory')}law {view.law}: {problem}", method="memory")
    return begun


def local_of(view: View, parameters: Mapping[str, Any]) -> Local:
    """Return the local knowledge of a view."""
    known = np.concatenate([view.ids.astype(object), view.outside.astype(object)])
    return Local(
        ids=view.ids,
        b=view.b,
        candidates=view.candidates,
        node=view.row,
        neighbour=known[view.column],
        weight=np.ones(len(view.row)) if view.weights is None else view.weights,
        parameters=parameters,
        seeds=view.seed,
    )
