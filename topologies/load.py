"""The way from a file, or the name of a bundled one, to a checked topology; all mistakes are reported together."""

from __future__ import annotations

import contextlib
import copy
import difflib
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from importlib import resources
from itertools import chain, islice
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from hedgerow.topologies import budget, table
from hedgerow.topologies.base import node_id
from hedgerow.topologies.errors import Code, FileRefusedError, Problem, Problems, TopologyError, UserError
from hedgerow.topologies.escape import shorten
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.mistaken import cure_of_law, mistaken
from hedgerow.topologies.mistakes import UNSPACED, as_written, in_words, sampled
from hedgerow.topologies.nodes import Edges, Nodes
from hedgerow.topologies.odd import no_id, odd_numbers
from hedgerow.topologies.override import next_key, origin_of, split_setting, steps_of
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.piecewise import LENGTHS, errors, is_length, trace
from hedgerow.topologies.regular_file import check_regular, read_regular
from hedgerow.topologies.rules import broken_rules
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.source import BYTES_PER_FAULT, MAX_BYTES, Mark, Path, Source, read_source


def bundled() -> list[str]:
    """Return the names of the topologies in the package."""
    files = resources.files("hedgerow.topologies").iterdir()
    return sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml"))


def find(name: str) -> FilePath:
    """Return the file that `name` means: a path, the folder of a finished run, or a bundled name."""
    path = user_path(name)
    try:
        is_run = (path / "topology.yaml").is_file()
        if name in bundled() and (is_run or path.is_file()):
            what = "the run in" if is_run else "the file"
            raise UserError(
                f"{name}: can be the bundled network or {what} ./{name}. Write ./{name}, or {_bundled_file(name)}.",
                code=Code.FILE_AMBIGUOUS,
            )
        if is_run:
            return path / "topology.yaml"
        if path.is_dir() and name not in bundled():
            raise UserError(
                f"{name}: is a directory, and no run's folder; name a topology file in it", code=Code.FILE_MISSING
            )
        if path.is_file() or (path.exists() and not path.is_dir()):
            return path
    except OSError as error:
        raise UserError(
            f"{name}: {error.strerror}; check the path and its permissions", code=Code.FILE_UNREADABLE
        ) from None
    if name in bundled():
        return _bundled_file(name)
    if cure := cure_of_law(name):
        raise UserError(f"{name}: is a law by its name, and a topology is expected; {cure}", code=Code.FILE_MISSING)
    near = _beside(path) or difflib.get_close_matches(name, bundled(), 1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise UserError(f"{name}: no such file; {hint}bundled names are {', '.join(bundled())}", code=Code.FILE_MISSING)


_MOST_NAMES = 1000
"""files of a folder that are compared with a name"""


def _beside(path: FilePath) -> list[str]:
    """Return the topology file with a name like that of a missing one in the same folder, if there is one."""
    found = []
    with contextlib.suppress(OSError):
        for one in islice(path.parent.iterdir(), _MOST_NAMES):
            if one.suffix in (".yaml", ".yml", ".json", ".toml") and not one.name.startswith("."):
                found.append(one)
    same = sorted(str(one) for one in found if one.stem in (path.name, path.stem))
    return same[:1] or difflib.get_close_matches(str(path), sorted(map(str, found)), 1)


def _bundled_file(name: str) -> FilePath:
    return FilePath(str(resources.files("hedgerow.topologies") / f"{name}.yaml"))


def load(name: str, overrides: Sequence[str] = ()) -> Topology:
    """Read, validate and check a topology; `overrides` are `path=value` strings that replace values of the file.

    Raise TopologyError with every mistake found, or UserError if there is no such file.
    """
    path = find(name)
    return parse(content(path), str(path), path.parent, overrides)


def content(path: FilePath) -> bytes:
    """Return the bytes of a topology file; raise UserError if it is too large, not regular, or unreadable."""
    try:
        if (size := check_regular(path).st_size) > MAX_BYTES:
            raise UserError(
                f"{path}: {size / 2**20:.0f} MB, and at most {MAX_BYTES / 2**20:.0f} are read; "
                "put long samples in a CSV file",
                code=Code.FILE_TOO_LARGE,
            )
        return read_regular(path)
    except OSError as error:
        raise UserError(
            f"{path}: cannot be read: {error.strerror}; check its permissions", code=Code.FILE_UNREADABLE
        ) from None


def parse(
    text: bytes,
    name: str,
    folder: FilePath,
    overrides: Sequence[str] = (),
    named: Collection[str] = (),
    columns: table.Table | None = None,
) -> Topology:
    """Return the topology in YAML text; messages use `name`, and `folder` holds its CSV files.

    named: files of samples that may be elsewhere, because the user named them and not the text. columns: the table of
    the text, in place of its file.
    """
    try:
        source = read_source(name, text)
    except TopologyError:
        if (meant := mistaken(name, text)) is None:
            raise
        raise TopologyError(name, [Problem(0, "", *meant, Code.FILE_FORMAT)]) from None
    source.named.update(named)
    if not _has_keys(source.value) and (meant := mistaken(name, text)) is not None:
        raise TopologyError(name, [Problem(0, "", *meant, Code.FILE_FORMAT)])
    found = _read(source, name, folder, overrides, columns)
    if isinstance(found, Topology):
        return found
    if overrides and not all(problem.origin for problem in found) and _is_good(name, text, folder, columns):
        # The file is valid without the options, so the options cause the mistake, even if it shows elsewhere.
        blamed = " ".join(map(origin_of, overrides))
        found = Problems(problem if problem.origin else replace(problem, origin=blamed) for problem in found)
    raise TopologyError(name, found)


def _has_keys(value: Any) -> bool:
    """Return True for a mapping with a key of topologies, and for an empty file."""
    return value is None or (isinstance(value, dict) and not Topology.model_fields.keys().isdisjoint(value))


def _is_good(name: str, text: bytes, folder: FilePath, columns: table.Table | None) -> bool:
    try:
        parse(text, name, folder, columns=columns)
    except TopologyError:
        return False
    return True


def _read(
    source: Source, name: str, folder: FilePath, overrides: Sequence[str], columns: table.Table | None
) -> Topology | Problems:
    """Return the topology of a source, or all of its mistakes."""
    if source.value is None:
        cure = "start from a bundled one, such as topologies/paper7.yaml"
        raise TopologyError(name, [Problem(0, "", "the file is empty", cure, Code.FILE_FORMAT)])
    if not isinstance(source.value, dict):
        found = f"a topology is a mapping, this is {as_written(source.value)}"
        text = source.value if isinstance(source.value, str) else ""
        cure = "write a space after each colon" if UNSPACED.match(text) else "start with `name: …`"
        raise TopologyError(name, [Problem(1, "", found, cure, Code.FILE_FORMAT)])
    _nodes_as_mapping(source)
    for override in overrides:
        _override(source, override)
    _nodes_as_mapping(source)
    _refuse_many_faults(source)
    source.problems.extend(odd_numbers(source))
    topology, problems = _validate(source)
    source.problems.extend(problems)
    if topology is not None and source.named:
        topology = topology.naming(source.named)
    if topology is not None and topology.table is not None:
        try:
            columns = table.read(topology.table, folder, topology.table_nodes) if columns is None else columns
            topology = topology.with_table(columns)
        except ValueError as error:
            refused = FileRefusedError.of(error)
            source.problems.append(source.problem(("table",), refused.what, refused.cure, refused.code))
            topology = None
    if topology is not None:
        source.problems.extend(broken_rules(topology, source, folder))
        topology = _in_columns(topology) if not len(source.problems) else topology
        topology.with_origin_of_law(_origin_of_law(source))
    return source.problems if topology is None or len(source.problems) else topology


def _refuse_many_faults(source: Source) -> None:
    """Raise TopologyError if the faults would exceed the memory limit: their models are made after this."""
    faults = source.value.get("faults")
    if isinstance(faults, list) and (why := budget.excess(len(faults) * BYTES_PER_FAULT)):
        problem = source.problem(("faults",), f"{len(faults):,} faults: {why}", code=Code.FILE_TOO_LARGE)
        raise TopologyError(source.name, [problem])


def _in_columns(topology: Topology) -> Topology:
    """Return a valid topology resolved to its table, if that is complete and nothing in the file changes it."""
    b = topology.b if topology.defaults.b is None else topology.defaults.b
    if topology.given is None or topology.nodes or topology.disturbance is not None or not isinstance(b, float):
        return topology
    whole = topology.given.network(b)
    if whole is None:
        return topology
    return topology.model_copy(update={"nodes": Nodes(whole), "edges": Edges(whole)}).of_network(whole)


def _origin_of_law(source: Source) -> str:
    """Return the place of `law:` as the start of a message."""
    mark = source.mark(("law",))
    if mark.origin:
        return f"{mark.origin}: "
    return f"{source.name}:{mark.line}: " if mark.line else ""


def _law_as_mapping(source: Source) -> None:
    """Give `law:` the form with a place for each parameter, for an override of one of them."""
    text = source.value.get("law", "minimax")
    if isinstance(text, str):
        with contextlib.suppress(ValueError):  # the schema reports the mistake
            choice = LawChoice.parse(text)
            source.value["law"] = {"class" if ":" in choice.name else "name": choice.name, **choice.parameters}


def _override(source: Source, override: str) -> None:
    where, text = split_setting(override)
    if not where:
        raise UserError(f"--set {override}: is not path=value; for example --set defaults.x0=5")
    try:
        override.encode()
    except UnicodeEncodeError:
        raise UserError(f"--set {override!a}: is not UTF-8 text; write it in UTF-8") from None
    origin = origin_of(override)
    try:
        given = read_source(origin, text.encode())
    except TopologyError as error:
        found = [replace(problem, line=0, column=0, origin=origin) for problem in error.problems]
        raise TopologyError(source.name, found) from None
    source.problems.extend(replace(problem, line=0, column=0, origin=origin) for problem in given.problems)
    # A path in an option is relative to the user's folder, not to the topology's.
    value = _with_named(given.value, source.named)
    if isinstance(value, str) and steps_of(where)[-1].text == "file":
        value = _named(value, source.named)
    rest = steps_of(where)
    by_rule = any(source.value.get(key) is not None for key in ("graph", "generator", "table"))
    if len(rest) > 1 and rest[0].text == "law":
        _law_as_mapping(source)
    keys: list[Any] = []
    at = source.value
    while rest:
        key, rest = next_key(at, rest)
        depth, last = len(keys), not rest
        keys.append(key)
        if isinstance(at, list) and isinstance(key, int) and -len(at) <= key < len(at):
            keys[depth] = key % len(at)
            at[key] = value if last else copy.deepcopy(at[key])
        # A rule or a table has nodes that the file does not list; a later check refuses an id that they do not have.
        elif isinstance(at, dict) and (last or key in at or keys[:depth] != ["nodes"] or by_rule):
            at[key] = value if last else copy.deepcopy(at.get(key) or {})
        else:
            place = ".".join(map(str, keys[: depth + 1]))
            raise UserError(f"--set {override}: there is no {place} in {source.name}. {_members(at, keys[:depth])}")
        at = at[key]
    # A value from the command line has no line in the file.
    path = tuple(keys)
    for known in (source.marks, source.odd):
        for inside in [inside for inside in known if inside[: len(path)] == path]:
            del known[inside]
    source.marks[path] = Mark(0, origin=origin)
    for inside, mark in given.marks.items():
        source.marks[*path, *inside] = mark._replace(line=0, column=0, origin=origin)
    source.odd |= {(*path, *inside): text for inside, text in given.odd.items()}


def _members(at: Any, path: Sequence[Any]) -> str:
    """Return the fix for a setting of a member that does not exist: the existing ones."""
    place = ".".join(map(str, path))
    if isinstance(at, dict):
        listed = ", ".join(shorten(str(key), 40) for key in islice(at, 8)) + (", …" if len(at) > 8 else "")
        return f"Choose one of {listed}." if at else f"Give {place} members first."
    if isinstance(at, list):
        return f"Choose one from 0 to {len(at) - 1}." if at else f"Give {place} members first."
    return f"{place} holds one value: write {place}=…."


def _with_named(value: Any, named: set[str]) -> Any:
    """Return a value with whole paths for its files of samples, and add these to `named`."""
    if isinstance(value, list):
        return [_with_named(one, named) for one in value]
    if not isinstance(value, dict):
        return value
    own = {key: _with_named(one, named) for key, one in value.items()}
    if own.get("kind") == "samples" and isinstance(own.get("file"), str):
        own["file"] = _named(own["file"], named)
    return own


def _named(file: str, named: set[str]) -> str:
    path = user_path(file)
    whole = str(FilePath.cwd() / path)
    if not path.is_absolute() and not FilePath(whole).exists():
        return file  # it may be beside the topology
    named.add(whole)
    return whole


def _nodes_as_mapping(source: Source) -> None:
    """Give `nodes:` its one form, keyed by ids, and move the lines along; report and remove invalid ids."""
    nodes = source.value.get("nodes")
    if not isinstance(nodes, dict | list):
        return
    mapping: dict[Any, Any] = {}
    marks: dict[Path, Mark] = {}
    inside: dict[Any, list[Path]] = defaultdict(list)
    for path in source.marks:
        if path[:1] == ("nodes",) and len(path) > 2:
            inside[path[1]].append(path)
    listed = isinstance(nodes, list)
    for k, written in enumerate(nodes):
        at = ("nodes", k if listed else written)
        mark = source.mark(at)
        node = node_id(written)
        if not (isinstance(node, str) or type(node) is int):
            text = mark.text if listed else mark.key
            what, cure, code = no_id(node, text, as_written(node))
            source.problems.append(source.problem(at, what, cure, code, "nodes"))
        elif node in mapping:
            what = f"{node!r} occurs twice (first on line {marks['nodes', node].line})"
            source.problems.append(source.problem(at, what, "keep one of the two", place="nodes"))
        else:
            mapping[node] = {} if listed else nodes[written]
            marks["nodes", node] = mark._replace(text=None, key=mark.text) if listed else mark
            if node != written:
                marks.update({("nodes", node, *path[2:]): source.marks[path] for path in inside[written]})
    if listed:
        source.marks = {path: mark for path, mark in source.marks.items() if path[:1] != ("nodes",) or len(path) == 1}
        moved = {path: text for path, text in source.odd.items() if path[:1] == ("nodes",)}
        source.odd = {path: text for path, text in source.odd.items() if path not in moved}
        source.odd |= {("nodes", nodes[path[1]], *path[2:]): text for path, text in moved.items()}
    source.marks.update(marks)
    source.value["nodes"] = mapping


_MANY = 2000
"""the maximum number of mistakes of a schema; above it, equal ones are only counted, and the rules are skipped"""


def _validate(source: Source) -> tuple[Topology | None, Iterable[Problem]]:
    """Return the topology and the mistakes that the schema finds; wrong values are left out, and the rules check the
    rest.
    """
    in_pieces = errors(Topology, source.value)
    if len(first := [*islice(in_pieces, _MANY + 1)]) > _MANY:
        return None, sampled(source, chain(first, in_pieces))
    try:
        return Topology.model_validate(source.value), []
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False)
    found = [
        one for one in found if one["type"] not in LENGTHS or not is_length(one, trace(source.value, one["loc"])[1])
    ]
    if len(found) > _MANY:
        return None, sampled(source, found)
    if any(problem.place == "nodes" for problem in source.problems):  # the nodes that were left out are not missing
        found = [one for one in found if (one["loc"], one["type"]) != (("nodes",), "too_short")]
    problems = _without_echoes(found, [in_words(source, details) for details in found])
    if not isinstance(source.value.get("nodes", {}), dict) or any(
        details["loc"][:1] == ("graph",) for details in found
    ):
        return None, problems
    try:
        return Topology.model_validate(_without(source.value, found)), problems
    except ValidationError:
        return None, problems


def _without_echoes(found: Sequence[ErrorDetails], problems: Sequence[Problem]) -> list[Problem]:
    """Return the mistakes without those that follow from another.

    `step: 3` for `steps:` is one mistake, and not an unknown key and a missing one. If the kind is wrong, the keys of
    that kind are not unknown as well.
    """
    kinds = {one["loc"][:-1] for one in found if one["type"] == "literal_error" and one["loc"][-1] == "kind"}
    meant = {
        (*details["loc"][:-1], word[1])
        for details, problem in zip(found, problems, strict=True)
        if details["type"] == "extra_forbidden" and (word := _MEANT.search(problem.cure))
    }
    return [
        problem
        for details, problem in zip(found, problems, strict=True)
        if not (details["type"] == "missing" and details["loc"] in meant)
        and not (details["type"] == "extra_forbidden" and details["loc"][:-1] in kinds)
    ]


_MEANT = re.compile(r"(?:did you mean|write) `(\w+):?`")
_STAND_INS = {"name": "unnamed", "b": 1e-9, "steps": 1}
"""Replacements for required keys with wrong values; they break no rule that right values would obey."""

_NO_FAULT = {"kind": "crash", "process": 0, "at": 0}
"""A replacement for a wrong fault, to preserve the numbers of the others; it breaks no rule."""


def _without(value: dict[str, Any], found: Iterable[ErrorDetails]) -> dict[str, Any]:
    valid = dict(value)
    if "nodes" in value:
        valid["nodes"] = {node: dict(own) if isinstance(own, dict) else {} for node, own in value["nodes"].items()}
    if isinstance(value.get("defaults"), dict):
        valid["defaults"] = dict(value["defaults"])
    wrong: dict[str, set[int]] = {"edges": set(), "faults": set()}
    for details in found:
        match details["loc"]:
            case ("nodes", node, field, *_) if isinstance(valid["nodes"].get(node), dict) and field != "[key]":
                valid["nodes"][node].pop(field, None)
            case ("nodes", node, *_):
                valid["nodes"].pop(node, None)
            case ("defaults", field, *_) if isinstance(valid.get("defaults"), dict):
                valid["defaults"].pop(field, None)
            case ("edges" | "faults" as key, int(k), *_):
                wrong[key].add(k)
            case (key, *_):
                valid.pop(str(key), None)
    if wrong["edges"] and "edges" in valid:
        valid["edges"] = [edge for k, edge in enumerate(value["edges"]) if k not in wrong["edges"]]
    if wrong["faults"] and "faults" in valid:
        valid["faults"] = [_NO_FAULT if k in wrong["faults"] else fault for k, fault in enumerate(value["faults"])]
    for key, stand_in in _STAND_INS.items():
        valid.setdefault(key, stand_in)
    return valid
