"""The law of a topology, checked before a run: its class, and its parameters with their defaults."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import json
import sys
import threading
import time
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, PydanticUserError, TypeAdapter, ValidationError, create_model

from hedgerow.agents.contract import Trial, check_law
from hedgerow.agents.law import Law
from hedgerow.agents.law_lines import running
from hedgerow.agents.loading import LawError, declared, law_class
from hedgerow.orchestrator.ground.assignment import law_of
from hedgerow.orchestrator.ground.law_source import refresh
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import LAWS, Topology
from hedgerow.topologies.wording import in_our_words


def checked(topology: Topology, folder: Path = Path()) -> Topology:
    """Return a topology with a law that names all of its parameters, defaults included.

    `folder` has the files of samples of a topology that is not drawn yet.

    If the file of the law changed since it was loaded, it is loaded again. Raises UserError if the class cannot be
    loaded, or a parameter is unknown, missing or of the wrong type. The message names the file and line. Raises
    LawError if the law breaks its contract (agents/contract.py).
    """
    choice = LawChoice.parse(law_of(topology))
    refresh(str(choice))
    law = law_class(choice.name)
    if topology.law in LAWS:
        return topology
    where = f"{topology.origin_of_law}law {choice.name}"
    given = with_defaults(law, choice.parameters, where)
    try:
        full = LawChoice.of(choice.name, given)
    except ValueError as error:
        raise UserError(f"{where}: {error}. Declare parameters of these types only.", code=Code.LAW) from None
    whole = completed(topology.model_copy(update={"law": str(full)}))
    _keeps_contract(law, LawChoice.parse(whole.law), whole, folder)
    return whole


def with_defaults(law: type[Any], parameters: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the parameters of a law and the defaults of the others.

    Raises UserError, with `where` first, if a parameter is unknown, missing or of the wrong type.
    """
    known = declared(law)
    for key in parameters:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            cure = f"Did you mean {near[0]}?" if near else f"Its parameters are {', '.join(known) or 'none'}."
            if _is_positional(law, key):
                cure = f"Its constructor takes {key} by position. Write a * before it: (self, b, candidates, *, {key})."
            raise UserError(f"{where}: has no parameter {key}. {cure}", code=Code.LAW)
    for key, default in known.items():
        if default is dataclasses.MISSING and key not in parameters:
            raise UserError(f"{where}: needs the parameter {key}. Write `law: {{…, {key}: …}}`.", code=Code.LAW)
    defaults = {key: value for key, value in known.items() if value is not dataclasses.MISSING}
    given = {**defaults, **parameters}
    _check_types(law, given, where)
    return given


def _is_positional(law: type[Any], key: str) -> bool:
    """Return True if the constructor of a law has an argument that would be a parameter after a *."""
    try:
        one = inspect.signature(law.__init__).parameters.get(key)
    except (TypeError, ValueError):
        return False
    return one is not None and one.kind is one.POSITIONAL_OR_KEYWORD and key not in ("self", "b", "candidates", "local")


_KEPT: dict[tuple[type[Law], str, bytes], None] = {}
"""laws that passed the contract test, on these candidates; a sweep checks one law in many settings"""


def _keeps_contract(law: type[Law], choice: LawChoice, topology: Topology, folder: Path) -> None:
    """Raise LawError if a law breaks its contract on nodes of this network, drawn with its own seed."""
    if _lacks_theta(choice):  # some numbers are still random, and the test needs theta
        return
    network = (topology if topology.is_drawn else resolve(topology, folder)).network
    trial = Trial.of(network.ids, network.b, network.candidates, network.graph.weight is not None)
    key = law, str(choice), trial.candidates.tobytes() + np.asarray(trial.b).tobytes() + bytes([trial.weighted])
    if key not in _KEPT:
        name = str(choice)
        _within_deadline(law, name, lambda called: check_law(law, trial, choice.parameters, name, on_call=called))
        _KEPT[key] = None


def _lacks_theta(choice: LawChoice) -> bool:
    return choice.name == "robust" and choice.parameters.get("theta") is None


def completed(topology: Topology) -> Topology:
    """Return a topology with the parameters of its law that the operator computes, once all numbers are drawn.

    This is theta of the law `robust`, unless the file gives it.
    """
    choice = LawChoice.parse(topology.law)
    if not _lacks_theta(choice) or not topology.is_drawn:
        return topology
    from hedgerow.orchestrator.ground.robust import theta_of  # noqa: PLC0415 (scipy takes a while to load)

    full = LawChoice.of(choice.name, {**choice.parameters, "theta": theta_of(topology.network)})
    return topology.model_copy(update={"law": str(full)})


CALL_DEADLINE_S = 10.0
"""the maximum time of one call of a law in the contract test"""


def _within_deadline(law: type[Law], name: str, test: Callable[[Callable[[], None]], None]) -> None:
    """Run a test of a law on another thread; raise LawError with its line if one call exceeds the deadline."""
    began, failure = [time.monotonic()], list[BaseException]()

    def called() -> None:
        began[0] = time.monotonic()

    def body() -> None:
        try:
            test(called)
        except BaseException as error:
            failure.append(error)

    thread = threading.Thread(target=body, name="contract", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(1.0)
        if thread.is_alive() and time.monotonic() - began[0] > CALL_DEADLINE_S:
            where = running(thread.ident or 0, law)
            problem = f"one call in the contract test takes longer than {CALL_DEADLINE_S:g} s. Make the law end."
            raise LawError(f"{where}{': ' if where else ''}law {name}: {problem}")
    if failure:
        raise failure[0]


def _check_types(law: type[Any], given: Mapping[str, Any], where: str) -> None:
    """Raise UserError for a value that the declaration of the class does not allow.

    The law receives a value as it was written, so the check is strict: the text "0.5" is no number. In
    JSON, a tuple is a list, and a member of an Enum is its value.
    """
    group = getattr(law, "Parameters", None)
    try:
        written = json.dumps(given)
    except (TypeError, ValueError):  # a default of another type, which the caller refuses
        return
    try:
        if group is not None:
            TypeAdapter(group).validate_json(written, strict=True)
            return
        fields: dict[str, Any] = {key: (hint, ...) for key, hint in _hints(law, given).items()}
        model = create_model("Parameters", __config__=ConfigDict(arbitrary_types_allowed=True), **fields)
        model.model_validate_json(written, strict=True)
    except PydanticUserError as error:
        problem = f"its parameters cannot be checked: {error.message.splitlines()[0]}. Correct their types."
        raise UserError(f"{where}: {problem}", code=Code.LAW) from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"])) or "parameters"
        raise UserError(f"{where}: the parameter {key}: {in_our_words(first)}. Correct it.", code=Code.LAW) from None


def _hints(law: type[Any], keys: Iterable[str]) -> dict[str, Any]:
    """Return the type of every parameter, `Any` where its annotation has none or cannot be evaluated.

    With `from __future__ import annotations`, an annotation is a text. Its names may exist under TYPE_CHECKING alone.
    """
    init = law.__init__
    listed = inspect.signature(init).parameters if inspect.isfunction(init) else {}
    names = {**vars(sys.modules.get(law.__module__, typing)), **getattr(init, "__globals__", {})}
    found = {}
    for key in keys:
        hint = listed[key].annotation if key in listed else Any
        if isinstance(hint, str):
            try:
                hint = typing.get_type_hints(types.SimpleNamespace(__annotations__={key: hint}), names)[key]
            except Exception:
                hint = Any
        found[key] = Any if hint is inspect.Parameter.empty else hint
    return found
