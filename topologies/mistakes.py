"""The mistakes that the schema finds in a file, each as a problem with its place and its cure."""

from __future__ import annotations

import difflib
import functools
import json
import operator
import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

from pydantic_core import ErrorDetails

from hedgerow.topologies.base import Model, kind_of
from hedgerow.topologies.cures import cure_of_number, cure_of_text
from hedgerow.topologies.disturbances import COMPONENTS
from hedgerow.topologies.edges import Edge
from hedgerow.topologies.errors import Code, Problem, Problems
from hedgerow.topologies.escape import shorten
from hedgerow.topologies.faults import KINDS, known_keys
from hedgerow.topologies.generators import GENERATORS
from hedgerow.topologies.graph import LARGEST
from hedgerow.topologies.piecewise import trace
from hedgerow.topologies.record import Record
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.settings import Defaults, Node
from hedgerow.topologies.source import Path, Source, place_of

_SHOWN = 60
UNSPACED = re.compile(r"[A-Za-z_]\w*:[^\s:/]")
_EACH = 100
"""the maximum number of mistakes of one kind that get a sentence"""


def sampled(source: Source, found: Iterable[ErrorDetails]) -> Problems:
    """Return very many mistakes of the schema: a sentence for the first of each kind, a count for the others."""
    problems, seen = Problems(), Counter[Any]()
    last: dict[Any, Problem] = {}
    for details in found:
        like = _like(details)
        seen[like] += 1
        if seen[like] <= _EACH:
            last[like] = in_words(source, details)
            problems.append(last[like])
        else:
            problems.count_more(last[like])
    return problems


def _like(details: ErrorDetails) -> tuple[Any, ...]:
    """Return the common part of mistakes that differ only in an index, a node or an unknown key."""
    loc: list[Any] = ["" if isinstance(step, int) else step for step in details["loc"]]
    if details["type"] == "extra_forbidden":
        loc[-1] = ""
    if "nodes" in loc[:2]:  # the keys of `nodes:` and `lots: nodes:` are ids
        loc[loc.index("nodes") + 1 : loc.index("nodes") + 2] = [""]
    return details["type"], *loc


def in_words(source: Source, details: ErrorDetails) -> Problem:
    return (_no_fault if details["type"] == "fault" else _problem)(source, details)


def _problem(source: Source, details: ErrorDetails) -> Problem:
    path, at, _ = trace(source.value, details["loc"])
    kind, last = details["type"], details["loc"][-1]
    if kind == "budget":
        return source.problem(path, details["msg"], code=Code.FILE_TOO_LARGE)
    shown = as_written(at, source.written(path))
    if "[key]" in details["loc"][-2:] and path:
        shown = as_written(path[-1], source.mark(path).key)
    if kind in _WITH_OWN_WORDS:
        return _WITH_OWN_WORDS[kind](source, details, path, at, shown)
    if kind == "literal_error" and last == "kind":
        return source.problem(
            path,
            f"{shown} is no disturbance of a whole network",
            "write `worst_case`, or give it to the nodes or under `defaults:`",
        )
    if kind == "extra_forbidden":
        what = f"unknown key `{shorten(str(last))}`"
        return source.problem(path, what, _near(source, path), place=place_of(path[:-1]))
    context = details.get("ctx", {})
    what, cure = {
        "finite_number": ("is not a finite number", "write a finite number"),
        "huge": (f"is beyond {LARGEST:g}, where sums of squares overflow", "choose a smaller one"),
        "greater_than": (f"is not above {context.get('gt', 0):g}", "choose a larger one"),
        "greater_than_equal": (f"is below {context.get('ge', 0):g}", "choose a larger one"),
        "less_than": (f"is not below {context.get('lt', 0):g}", "choose a smaller one"),
        "less_than_equal": (f"is above {context.get('le', 0):g}", "choose a smaller one"),
        "int_type": ("is no node id", "write one id, a name or a whole number")
        if _is_id(path)
        else ("is not a whole number", cure_of_number(at, whole=True)),
        "bool_type": ("is neither true nor false", _cure_of_bool(at)),
        "window": ("holds no step", "write [from, to): the first step, and the one after the last"),
        "empty": ("is empty", "put the lower bound first"),
        "number": ("is not a number", _cure_of_gain(shown) if path == ("b",) and _random(at) else cure_of_number(at)),
        "literal_error": ("is neither a number nor `random`", "write one of the two"),
        "string_type": ("is not text", cure_of_text(at, source.written(path))),
        "too_short": ("has too few members", f"at least {_needed(context.get('min_length', 1))} needed"),
        "too_long": ("has too many members", f"at most {context.get('max_length')} are allowed"),
        "tuple_type": ("is not a list", _cure_of_list(path, at)),
        "dict_type": ("is not a mapping", "write key: value"),
        "model_type": ("is not a mapping", "write {key: value}"),
    }.get(kind, (details["msg"][0].lower() + details["msg"][1:], ""))
    return source.problem(path, f"{shown} {what}" if kind in _ABOUT_VALUE else f"{what} (found {shown})", cure)


def _missing(source: Source, details: ErrorDetails, path: Path, at: Any, shown: str) -> Problem:
    last = details["loc"][-1]
    if isinstance(last, int):
        return source.problem(path, f"{shown} has too few members", "a pair has two")
    if isinstance(at, str):  # the kind alone, without braces
        return source.problem(path, f"`{at}` needs `{last}:`", f"write {{kind: {at}, {last}: …}}")
    return source.problem(path, f"`{last}:` is missing", f"add `{last}: …`")


def _invalid_key(source: Source, details: ErrorDetails, path: Path, at: Any, shown: str) -> Problem:
    last = details["loc"][-1]
    path, at, _ = trace(source.value, details["loc"][:-1])
    key = next((key for key in at if str(key) == str(last)), last)
    names = ", ".join(_known_keys(source, path))
    cure = f"known keys are {names}" if names else "remove it"
    key_path = (*path, key)
    shown = as_written(key, source.mark(key_path).key)
    return source.problem(key_path, f"{shown} is no key", cure, place=place_of(path))


_ABOUT_VALUE = frozenset(
    (
        *("finite_number", "huge", "greater_than", "greater_than_equal", "less_than", "less_than_equal"),
        *("int_type", "number", "empty", "literal_error", "string_type", "too_short", "too_long"),
        *("tuple_type", "dict_type", "model_type", "bool_type", "window"),
    )
)


def _needed(count: int) -> str:
    return f"{count} {'is' if count == 1 else 'are'}"


def _is_id(path: Path) -> bool:
    """Return True if the value at `path` is the id of a node: a name or a whole number."""
    return path[:1] == ("faults",) and (path[-1:] == ("node",) or path[-2:-1] in (("link",), ("edge",), ("from",)))


_TRUE, _FALSE = frozenset(("yes", "y", "on", "1", "true")), frozenset(("no", "n", "off", "0", "false"))


def _cure_of_bool(value: Any) -> str:
    word = str(value).lower()
    return "write true" if word in _TRUE else "write false" if word in _FALSE else "write one of the two"


def _cure_of_list(path: Path, value: Any) -> str:
    """Return the fix for a value that should be a list."""
    match path:
        case (*_, "link" | "edge"):
            return "write the two ends, such as [1, 2]"
        case ("edges",):
            return "write pairs of node ids: [[1, 2], [2, 3]]"
        case ("edges", _):
            return "write a pair of node ids, such as [1, 2]"
        case (*_, "steps"):
            return "write [from, to): the first step, and the one after the last"
    shown = as_written(value)
    if isinstance(value, int | float | str | dict) and len(shown) < _SHOWN:
        return f"put it in brackets: [{shown}]"
    return "write [ … ]"


def _random(value: Any) -> bool:
    return isinstance(value, dict) and "random" in value


def _cure_of_gain(shown: str) -> str:
    return f"write a number here, and `defaults: {{b: {shown}}}` for gains that are drawn per node"


def _no_fault(source: Source, details: ErrorDetails) -> Problem:
    """Return the problem of an entry in `faults:` without a valid `kind`."""
    path, written, _ = trace(source.value, details["loc"])
    kinds = f"kinds are {', '.join(KINDS)}"
    if not isinstance(written, dict):
        shown = as_written(written, source.written(path))
        unspaced = isinstance(written, str) and UNSPACED.match(written)
        cure = "write a space after the colon: {kind: …}" if unspaced else "write {kind: …}"
        return source.problem(path, f"{shown} is not a mapping", cure)
    if "kind" not in written:
        return source.problem(path, "`kind:` is missing", kinds)
    near = difflib.get_close_matches(str(written["kind"]), KINDS, 1, 0.5)
    cure = f"did you mean `{near[0]}`? {kinds}" if near else kinds
    path = (*path, "kind")
    return source.problem(path, f"{as_written(written['kind'], source.written(path))} is no kind of fault", cure)


def _no_kind(source: Source, details: ErrorDetails, path: Path, value: Any, shown: str) -> Problem:
    """Return the problem of a disturbance or a graph with a missing or unknown kind."""
    expected = details["msg"]
    written = value.get("kind") if isinstance(value, dict) else value
    inside = (*path, "kind") if isinstance(value, dict) and "kind" in value else path
    if isinstance(value, dict) and "kind" not in value:
        return source.problem(path, "`kind:` is missing", expected)
    known = [*(GENERATORS if path == ("graph",) else COMPONENTS)]
    near = difflib.get_close_matches(str(written).lower(), known, 1, 0.5)
    hint = f"did you mean `{near[0]}`? " if near else ""
    if near and near[0] == written:
        hint = f"write {{kind: {written}, …}}; "
    return source.problem(
        inside,
        f"{shown if inside == path else as_written(written, source.written(inside))} is no kind",
        f"{hint}{expected}",
    )


_WITH_OWN_WORDS = {"missing": _missing, "invalid_key": _invalid_key, "kind": _no_kind}
"""by the kind of a mistake of the schema: the function that reports it"""


def _near(source: Source, path: Path) -> str:
    """Return the likely correction of the unknown key at the end of `path`."""
    known = _known_keys(source, path[:-1])
    listed = f"known keys are {', '.join(known)}" if known else "remove it"
    present = functools.reduce(operator.getitem, path[:-1], source.value)
    for other in _OTHER_WORDS.get(str(path[-1]).lower(), ()):
        misspelled = difflib.get_close_matches(str(path[-1]), known, 1, 0.8)
        if other in known and other not in present and not misspelled:
            return f"{listed}; write `{other}:`"
    if path[0] != "faults":
        near = difflib.get_close_matches(str(path[-1]), known, 1, 0.5)
        return f"did you mean `{near[0]}`?" if near else listed
    # The keys of a fault are few and alike: a key that is already there is not the intended one.
    others = [key for key in known if key not in source.value["faults"][path[1]]]
    near = difflib.get_close_matches(str(path[-1]), others, 1, 0.5)
    return f"did you mean `{near[0]}`? {listed}" if near else listed


_OTHER_WORDS: dict[str, tuple[str, ...]] = {
    "to": ("a",),
    "value": ("a", "x0"),
    "edge": ("link",),
    "link": ("edge",),
    "edges": ("link", "edge", "nodes"),
    "links": ("link", "edge", "edges"),
    "vertices": ("nodes",),
    "agents": ("nodes",),
    **dict.fromkeys(("n", "count"), ("nodes",)),
    "size": ("nodes", "amplitude"),
    "w": ("omega", "disturbance"),
    **dict.fromkeys(("p", "prob", "rate", "chance"), ("probability",)),
    **dict.fromkeys(("delay", "lag"), ("by",)),
    **dict.fromkeys(("start", "stop", "end", "window", "during", "duration", "time", "times"), ("steps", "at")),
    **dict.fromkeys(("step", "when"), ("at", "steps")),
    **dict.fromkeys(("t", "horizon", "length", "iterations"), ("steps",)),
    **dict.fromkeys(("restart", "back", "recover", "recover_after"), ("restart_after",)),
    **dict.fromkeys(("frequency", "freq", "angular_frequency"), ("omega",)),
    **dict.fromkeys(("sigma", "stddev", "std_dev", "sd", "scale"), ("std",)),
    **dict.fromkeys(("offset", "bias", "level", "mean"), ("value",)),
    **dict.fromkeys(("amp", "magnitude"), ("amplitude",)),
    **dict.fromkeys(("models", "model", "list"), ("candidates",)),
    **dict.fromkeys(("x", "initial", "x_0", "initial_state"), ("x0",)),
    **dict.fromkeys(("noise", "input"), ("disturbance",)),
    **dict.fromkeys(("gain", "coupling"), ("b",)),
    **dict.fromkeys(("k", "conductance", "capacity"), ("weight",)),
    **dict.fromkeys(("controller", "policy", "algorithm"), ("law",)),
    **dict.fromkeys(("random_seed", "rng"), ("seed",)),
    **dict.fromkeys(("title", "id"), ("name",)),
    "type": ("kind",),
}
"""by another word for a key: the keys that it may mean, those of the file's own kind of entry first"""


def _known_keys(source: Source, path: Path) -> list[str]:
    kind = kind_of(functools.reduce(operator.getitem, path, source.value)) or ""
    model: type[Model] | None = None
    match path:
        case ():
            model = Topology
        case ("graph",):
            model = GENERATORS.get(kind)
        case ("record",):
            model = Record
        case ("edges", _):
            model = Edge
        case ("faults", _):
            model = KINDS.get(kind)
        case ("defaults",):
            model = Defaults
        case ("nodes", _):
            model = Node
        case (*_, "disturbance") | (*_, "disturbance", _):
            model = COMPONENTS.get(kind)
    return known_keys(model) if model is not None else []


def as_written(value: Any, text: str | None = None) -> str:
    """Return a value as the user wrote it: `text` if that is known, otherwise as JSON, which YAML reads."""
    if text is not None:
        return (text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…") or "an empty value"
    if isinstance(value, dict | list) and len(value) > 8:
        kind = "mapping" if isinstance(value, dict) else "list"
        return f"a {kind} of {len(value)}"
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except ValueError:  # a whole number with more digits than Python prints
        return "a huge number"
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"
