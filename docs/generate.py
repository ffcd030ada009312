"""Write docs/topology.md from docs/topology.md.in, the schema, the bundled files, and the output of commands.

    python docs/generate.py           write it
    python docs/generate.py --check   exit with 1 when it is stale

The result of the function NAME replaces a line `<!-- generate: NAME ARGUMENT -->` of the template.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import types
import typing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

import annotated_types as limits
import yaml
from pydantic import AfterValidator
from pydantic.fields import FieldInfo

from hedgerow.topologies import disturbances as disturbance_models
from hedgerow.topologies import faults, generators, schema, settings
from hedgerow.topologies.base import Model, Uniform
from hedgerow.topologies.load import bundled, find, load, parse
from hedgerow.topologies.record import Record
from hedgerow.topologies.resolve import resolve

DOCS = Path(__file__).parent
TEMPLATE, RESULT = DOCS / "topology.md.in", DOCS / "topology.md"
COMMAND = (sys.executable, "-P", "-m", "hedgerow.orchestrator")
"""The command `orchestrator` of this Python."""

WRITTEN = {
    "nodes": "list of node ids, or mapping from node ids to [what they override](#a-node)",
    "defaults": "mapping, [as of a node](#a-node)",
    "edges": "list of pairs of node ids, or of [`{ends: …, weight: …}`](#input-gains-and-weights)",
    "lots": "mapping of a `seed` and, under `nodes`, of [lots by field](#random-numbers)",
    "graph": "[a rule](#graphs-by-a-rule)",
    "table": "[a file](#tables)",
    "processes": "whole number (at least 1), `auto` or `per-node`",
    "law": "[a name](zoo.md) or `package.module:Class`, alone or in a mapping",
    "disturbance": "[`worst_case`](#worst_case)",
    "faults": "list of [faults](#faults)",
    "record": "[mapping](#recorded-rows)",
}
"""Plain words for types of the whole file."""
OF_RECORD = {"nodes": "list of node ids, whole number (at least 0) or `all`"}
OF_FAULTS = {
    **dict.fromkeys(("link", "edge"), "pair of node ids"),
    **dict.fromkeys(("from", "to", "node"), "node id"),
    "groups": "list of lists of node ids",
    "steps": "pair of whole numbers",
}
"""Plain words for types of a fault."""
TYPED: dict[type[Model], dict[str, str]] = {schema.Topology: WRITTEN, Record: OF_RECORD}
VALIDATED = {"_one_line_name": "name"}
"""Types that a validator narrows, by the validator's name."""
PLAIN = {float: "number", int: "whole number", bool: "`true` or `false`", str: "text", Any: "anything"}
LIMITS = {
    limits.Gt: ("gt", "above"),
    limits.Ge: ("ge", "at least"),
    limits.Lt: ("lt", "below"),
    limits.Le: ("le", "at most"),
    limits.MinLen: ("min_length", "at least"),
    limits.MaxLen: ("max_length", "at most"),
}
EXAMPLES: dict[str, Any] = {
    "sinusoid": {"kind": "sinusoid", "amplitude": 0.5, "omega": 0.3, "phase": 1.57},
    "constant": {"kind": "constant", "value": -0.05},
    "white": {"kind": "white", "std": {"random": [0.1, 0.5]}},
    "ar1": {"kind": "ar1", "phi": 0.9, "std": 0.1},
    "confuse": {"kind": "confuse", "candidate": 0.9},
    "impulse": {"kind": "impulse", "at": 20, "value": 10},
    "samples": {"kind": "samples", "values": [0.1, 0.0, -0.1]},
    "none": "none",
    "worst_case": {"kind": "worst_case", "energy": 1},
}
"""One disturbance of each kind; the generator fails when a kind has none, or when one is refused."""
FAULT_EXAMPLES: dict[str, list[dict[str, Any]]] = {
    "drop": [
        {"kind": "drop", "link": [2, 4], "steps": [10, 20]},
        {"kind": "drop", "from": 2, "to": 4, "probability": 0.3},
        {"kind": "drop", "at": {10: [[2, 4], [3, 5]], 12: [[2, 4]]}},
    ],
    "delay": [{"kind": "delay", "from": 2, "to": 4, "by": 3, "steps": [10, 20]}],
    "cut": [
        {"kind": "cut", "edge": [2, 4], "steps": [10, 20]},
        {"kind": "cut", "at": {10: [[2, 4], [3, 5]], 12: [[2, 4]]}},
    ],
    "partition": [{"kind": "partition", "groups": [[1, 2, 3, 5], [4, 6, 7]], "steps": [10, 20], "cut": True}],
    "sensor": [{"kind": "sensor", "node": 3, "steps": [5, 9]}],
    "actuator": [{"kind": "actuator", "node": 3, "steps": [5, 9], "probability": 0.5}],
    "crash": [
        {"kind": "crash", "node": 4, "at": 12, "restart_after": 5},
        {"kind": "crash", "process": 2, "at": 12},
    ],
    "jump": [
        {"kind": "jump", "node": 4, "at": 15, "a": 0.3},
        {"kind": "jump", "node": 5, "at": 15, "a": "random"},
    ],
}
"""Faults of each kind, in the tree of `paper7`; the generator fails when a kind has none, or when one is refused."""


GRAPH_EXAMPLES: dict[str, dict[str, Any]] = {
    "grid": {"columns": 4},
    "tree": {"branches": 3},
    "random_tree": {"max_degree": 3},
    "small_world": {"rewire": 0.2},
    "scale_free": {"attach": 1},
    "geometric": {"mean_degree": 4},
}


def words(hint: Any, where: Sequence[Any] = ()) -> str:
    """Return a type in plain words; `where` are the limits around it."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return words(inside[0], [*where, *_flat(inside[1:])])
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(words(one, where) for one in inside if one is not type(None)))
    if origin is dict:
        return "mapping from steps to lists of pairs"
    if origin is tuple:
        member = words(inside[0])
        text = f"list of {member}" + ("" if member.startswith("[") else "s")
    elif isinstance(hint, type) and issubclass(hint, Model):
        text = "[`{random: …}`](#random-numbers)" if "random" in hint.model_fields else "[disturbance](#disturbances)"
    else:
        names = [getattr(one.func, "__name__", "") for one in where if isinstance(one, AfterValidator)]
        text = next((VALIDATED[name] for name in names if name in VALIDATED), "")
        text = text or " or ".join(f"`{value}`" for value in inside) or PLAIN[hint]
    around = [
        f"{LIMITS[type(one)][1]} {_power(getattr(one, LIMITS[type(one)][0]))}" for one in where if type(one) in LIMITS
    ]
    return text + (f" ({', '.join(around)})" if around else "")


def _flat(metadata: Sequence[Any]) -> Iterator[Any]:
    for one in metadata:
        if isinstance(one, FieldInfo):
            yield from one.metadata
        else:
            yield one


def _power(value: float) -> str:
    if isinstance(value, int) and value >= 2**20 and value.bit_count() == 1:
        return f"2^{value.bit_length() - 1}"
    return str(value) if isinstance(value, int) else f"{value:g}"


def flow(value: Any) -> str:
    """Return a value as in a file, on one line."""
    if isinstance(value, Model):
        value = value.model_dump()
        value = value["kind"] if list(value) == ["kind"] else value
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1000).removesuffix("\n...\n").strip()


def keys(model: type[Model], hide: Sequence[str] = (), default: Callable[[str], str] | None = None) -> str:
    """Return the table of a model's keys."""
    hints = typing.get_type_hints(model, include_extras=True)
    rows = ["| key | type | default | description |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        if name in hide:
            continue
        if not field.description:
            raise SystemExit(f"{model.__name__}.{name} has no description: give it one in {model.__module__}")
        key = field.serialization_alias or field.alias or name
        written = OF_FAULTS if issubclass(model, faults.FaultModel) else TYPED.get(model, {})
        kind = written.get(key) or words(hints[name])
        if default is not None:
            otherwise = default(name)
        elif field.is_required():
            otherwise = "required"
        else:
            otherwise = "—" if field.default in (None, ()) else f"`{flow(field.default)}`"
        described = field.description.replace("|", "\\|")
        rows.append(f"| `{key}` | {kind} | {otherwise} | {described} |")
    return "\n".join(rows)


def topology() -> str:
    """Return the keys of a whole file."""
    return keys(schema.Topology, default=lambda name: _default_of_file(schema.Topology.model_fields[name]))


def _default_of_file(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    return (
        "—"
        if isinstance(field.default, settings.Settings | Record) or field.default in (None, (), {})
        else f"`{flow(field.default)}`"
    )


def node() -> str:
    """Return the keys of a node, with the built-in defaults."""
    return keys(settings.Node, default=_default_of_node)


def _default_of_node(name: str) -> str:
    otherwise = getattr(settings.Defaults.FALLBACK, name, None)
    return "—" if otherwise is None else f"`{flow(otherwise)}`"


def _kinds() -> list[type[Model]]:
    """Return every model that has a `kind`, in the order of the schema."""
    models = [one for one in vars(disturbance_models).values() if isinstance(one, type) and issubclass(one, Model)]
    kinds = [one for one in models if "kind" in one.model_fields]
    if missing := {one.model_fields["kind"].default for one in kinds} - EXAMPLES.keys():
        raise SystemExit(f"no example of {', '.join(missing)}: add one to EXAMPLES in docs/generate.py")
    return kinds


def disturbances() -> str:
    """Return each kind of disturbance: its formula, an example that was read, its keys."""
    parts = []
    for model in _kinds():
        kind = model.model_fields["kind"].default
        example = EXAMPLES[kind]
        network: dict[str, Any] = {"name": "one", "b": 0.1, "steps": 3, "nodes": [1, 2], "edges": [[1, 2]]}
        if model is disturbance_models.WorstCase:
            network["disturbance"] = example
        else:
            network["defaults"] = {"disturbance": example}
        resolve(parse(yaml.safe_dump(network).encode(), kind, DOCS))
        formula = (model.__doc__ or "").strip().splitlines()[0]
        parts.append(f"### {kind}\n\n{formula}\n\n```yaml\ndisturbance: {flow(example)}\n```")
        if len(model.model_fields) > 1:
            parts.append(keys(model, hide=["kind"]))
    return "\n\n".join(parts)


def graphs() -> str:
    """Return each kind of graph: its edges, an example that was read, its keys."""
    common = [*generators.Generator.model_fields]
    rows = [keys(generators.Generator)]
    for kind, model in generators.GENERATORS.items():
        example = {"kind": kind, "nodes": 8} | GRAPH_EXAMPLES.get(kind, {})
        network = {"name": "one", "b": 0.1, "steps": 3, "graph": example}
        made = resolve(parse(yaml.safe_dump(network).encode(), kind, DOCS))
        listed = ", ".join(f"{i}–{j}" for i, j in made.pairs)
        rows.append(
            f"### {kind}\n\n{(model.__doc__ or '').strip()}\n\n```yaml\ngraph: {flow(example)}\n```\n\nmakes {listed}."
        )
        if len(model.model_fields) > len(common) + 1:
            rows.append(keys(model, hide=["kind", *common]))
    return "\n\n".join(rows)


def of_faults() -> str:
    """Return each kind of fault: its effect, examples that were read, its keys."""
    if missing := faults.KINDS.keys() - FAULT_EXAMPLES.keys():
        raise SystemExit(f"no example of {', '.join(missing)}: add one to FAULT_EXAMPLES in docs/generate.py")
    tree = load("paper7")
    network: dict[str, Any] = {"name": "tree", "b": tree.b, "steps": tree.steps, "nodes": [*tree.ids]}
    network |= {"edges": [list(edge) for edge in tree.pairs], "defaults": {"candidates": [0.3, 0.6]}}
    parts = []
    for kind, model in faults.KINDS.items():
        resolve(parse(yaml.safe_dump(network | {"faults": FAULT_EXAMPLES[kind]}).encode(), kind, DOCS))
        lines = "\n".join(f"- {flow(example)}" for example in FAULT_EXAMPLES[kind])
        parts.append(f"### {kind}\n\n{(model.__doc__ or '').strip()}\n\n```yaml\nfaults:\n{lines}\n```")
        if alternatives := model.forms():
            forms = ", or ".join(" and ".join(f"`{key}`" for key in form) for form in alternatives)
            parts.append(f"Exactly one of these is given: {forms}.")
        parts.append(keys(model, hide=["kind"]))
    return "\n\n".join(parts)


def random() -> str:
    """Return the models of random values, and the keys that accept them."""
    rows = ["| written | valid at | drawn value |", "|---|---|---|"]
    owners: list[type[Model]] = [settings.Node, *_kinds()]
    for model in (settings.Drawn, Uniform, disturbance_models.NonNegativeUniform):
        inside = "M" if model is settings.Drawn else "[low, high]"
        places = []
        for owner in owners:
            hints = typing.get_type_hints(owner, include_extras=True)
            places += [_place(owner, name) for name in owner.model_fields if model in _members(hints[name])]
        rows.append(f"| `{{random: {inside}}}` | {', '.join(places)} | {(model.__doc__ or '').strip()} |")
    rows.insert(2, "| `random` | `a` | The truth: one of the node's candidates, each as likely. |")
    rows.insert(3, "| `random` | `confuse.candidate` | A candidate that is not the truth, if there is one. |")
    rows.insert(4, "| `random` | `jump.a` | The new truth: a candidate that is not the old truth, if there is one. |")
    return "\n".join(rows)


def _place(owner: type[Model], name: str) -> str:
    return f"`{name}`" if owner is settings.Node else f"`{owner.model_fields['kind'].default}.{name}`"


def _members(hint: Any) -> Iterator[Any]:
    """Yield the members of a union, not those inside lists or models."""
    if get_origin(hint) is Annotated:
        yield from _members(get_args(hint)[0])
    elif get_origin(hint) in (Union, types.UnionType):
        for one in get_args(hint):
            yield from _members(one)
    else:
        yield hint


def bundled_files() -> str:
    """Return the topologies in the package, each with the start of its file."""
    rows = ["| name | nodes | edges | steps | what it is |", "|---|---|---|---|---|"]
    for name in bundled():
        network, comment = load(name), []
        for line in find(name).read_text(encoding="utf-8").splitlines():
            if not line.startswith("#"):
                break
            comment.append(line.removeprefix("#").strip())
        first = re.split(r"(?<=\.) ", " ".join(comment))[0]
        rows.append(f"| `{name}` | {len(network.ids)} | {len(network.edges)} | {network.steps} | {first} |")
    return "\n".join(rows)


class Scratch:
    """A folder for the commands of the document, which run one after another."""

    def __init__(self, folder: Path, command: Sequence[str]) -> None:
        self.folder, self.command = folder, command

    def file(self, name: str) -> str:
        """Return a file of docs/examples, and put it into the folder for later commands."""
        text = (DOCS / "examples" / name).read_text(encoding="utf-8")
        (self.folder / name).write_text(text, encoding="utf-8")
        return f"```{Path(name).suffix.removeprefix('.')} {name}\n{text}```"

    def console(self, command: str) -> str:
        """Return the output of `orchestrator`, and its exit code."""
        ran = subprocess.run(
            [*self.command, *command.split()[1:]],
            cwd=self.folder,
            env=os.environ | {"COLUMNS": "160"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        claim = f"  # exit {ran.returncode}" if ran.returncode else ""
        printed = "\n".join(line.rstrip() for line in ran.stdout.strip().splitlines())
        return f"```console\n$ {command}{claim}\n{printed}\n```"

    def resolved(self, file: str) -> str:
        """Return the resolved form of a file, as in a run folder."""
        arguments = ["simulate", file, "--no-record", "--run-dir", "drawn"]
        subprocess.run(
            [*self.command, *arguments],
            cwd=self.folder,
            capture_output=True,
            check=True,
        )
        return f"```yaml\n{(self.folder / 'drawn' / 'topology.yaml').read_text(encoding='utf-8')}```"


def generate(command: Sequence[str] = COMMAND) -> str:
    """Return the whole document; `command` starts `orchestrator`."""
    with tempfile.TemporaryDirectory() as folder:
        scratch = Scratch(Path(folder), command)
        makers: dict[str, Callable[..., str]] = {
            "topology": topology,
            "node": node,
            "disturbances": disturbances,
            "faults": of_faults,
            "graphs": graphs,
            "record": lambda: keys(Record),
            "random": random,
            "bundled": bundled_files,
            "file": scratch.file,
            "console": scratch.console,
            "resolved": scratch.resolved,
        }

        def made(match: re.Match[str]) -> str:
            argument = match[2]
            return makers[match[1]](*([argument] if argument else []))

        template = TEMPLATE.read_text(encoding="utf-8")
        return re.sub(r"<!-- generate: (\w+)(?: (.*?))? -->", made, template)


def main() -> None:
    """Write the document, or check it."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 when the file is stale")
    fresh = generate()
    if not parser.parse_args().check:
        RESULT.write_text(fresh, encoding="utf-8")
    elif not RESULT.exists() or RESULT.read_text(encoding="utf-8") != fresh:
        sys.exit(f"{RESULT.name} is stale: run `python docs/generate.py`")


if __name__ == "__main__":
    main()
