"""The law of a topology, checked before a run: its class, and its parameters with their defaults."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import typing
from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError, create_model

from hedgerow.agents.law import Law
from hedgerow.agents.loading import declared, law_class
from hedgerow.orchestrator.ground.assignment import law_of
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.schema import LAWS, Topology


def checked(topology: Topology) -> Topology:
    """Return a topology whose law names all of its parameters, the defaults included.

    Raises UserError if the class cannot be loaded, or a parameter is unknown, missing or of the wrong type. The message
    names the file and line.
    """
    choice = LawChoice.parse(law_of(topology))
    law = law_class(choice.name)
    if topology.law in LAWS:
        return topology
    known = declared(law)
    where = f"{topology.origin_of_law}law {choice.name}"
    for key in choice.parameters:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            cure = f"Did you mean {near[0]}?" if near else f"Its parameters are {', '.join(known) or 'none'}."
            raise UserError(f"{where}: has no parameter {key}. {cure}", code=Code.LAW)
    for key, default in known.items():
        if default is dataclasses.MISSING and key not in choice.parameters:
            raise UserError(f"{where}: needs the parameter {key}. Write `law: {{…, {key}: …}}`.", code=Code.LAW)
    defaults = {key: value for key, value in known.items() if value is not dataclasses.MISSING}
    given = {**defaults, **choice.parameters}
    _check_types(law, given, where)
    try:
        full = LawChoice.of(choice.name, given)
    except ValueError as error:
        raise UserError(f"{where}: {error}. Declare parameters of these types only.", code=Code.LAW) from None
    return topology.model_copy(update={"law": str(full)})


def _check_types(law: type[Law], given: Mapping[str, Any], where: str) -> None:
    """Raise UserError for a value that the declaration of the class does not allow."""
    group = getattr(law, "Parameters", None)
    try:
        if group is not None:
            TypeAdapter(group).validate_python(dict(given))
            return
        hints = typing.get_type_hints(law.__init__) if inspect.isfunction(law.__init__) else {}
        fields: dict[str, Any] = {key: (hints.get(key, Any), ...) for key in given}
        create_model("Parameters", __config__=ConfigDict(arbitrary_types_allowed=True), **fields)(**given)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"])) or "parameters"
        said = first["msg"][:1].lower() + first["msg"][1:]
        raise UserError(f"{where}: the parameter {key}: {said}. Correct it.", code=Code.LAW) from None
