"""The runs of a comparison: every law under every disturbance and every seed, on one network."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hedgerow.orchestrator.experiments.sweep.plan import Plan, Setting, split
from hedgerow.orchestrator.ground import laws as law_checks
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.law_choice import NAMES
from hedgerow.topologies.load import parse
from hedgerow.topologies.named import Named, text_of
from hedgerow.topologies.nodes import Nodes
from hedgerow.topologies.override import Override
from hedgerow.topologies.schema import Topology

BESIDE = ("hinf", "nominal")
"""laws that every comparison has: the oracle, and the nominal controller"""
AS_FILE = "file"
PRESETS: dict[str, Any] = {
    "sinusoid": {
        "kind": "sinusoid",
        "amplitude": {"random": [0.1, 1]},
        "omega": {"random": [0, 3.14159]},
        "phase": {"random": [0, 6.28318]},
    },
    "white": {"kind": "white", "std": 0.1},
    "ar1": {"kind": "ar1", "phi": 0.9, "std": 0.1},
    "constant": {"kind": "constant", "value": {"random": [-1, 1]}},
    "confuse": {"kind": "confuse", "candidate": "random"},
    "none": {"kind": "none"},
}
"""By name: a disturbance of every node, its numbers drawn by the seed; names joined by + are added."""


@dataclass(frozen=True)
class Comparison(Plan):
    """The plan of a sweep with the keys `disturbance` and `law`."""

    @property
    def laws(self) -> list[str]:
        """Return the laws, in the order of the rows."""
        return list(dict.fromkeys(one.values[1] for one in self.settings))

    @property
    def disturbances(self) -> list[str]:
        """Return the disturbances, in the order of the tables."""
        return list(dict.fromkeys(one.values[0] for one in self.settings))

    @property
    def default_out(self) -> Path:
        """Return the folder of this comparison: the same command finds it again."""
        digest = hashlib.sha256(json.dumps(self.identity).encode()).hexdigest()
        return Path("comparisons") / f"{self.name}-{digest[:8]}"


def comparison(
    network: Named, laws: Sequence[str], disturbances: Sequence[Any], seeds: range, sets: Sequence[str] = ()
) -> Comparison:
    """Return the plan; raise UserError for a mistake in it, TopologyError for one in the file.

    `laws` are texts of LawChoice; `all` means every law of the project. A disturbance is the name of a preset, names
    joined by +, `file`, or a node's `disturbance:` in a file.
    """
    if not seeds:
        raise UserError("seeds: there is none. Give a range such as 0:50.", code=Code.OPTION)
    text, name, folder = text_of(network)
    chosen = [name for law in laws for name in (NAMES if law == "all" else (law,))]
    chosen = list(dict.fromkeys([*(law for law in chosen if law not in BESIDE), *BESIDE]))
    settings = []
    for given in disturbances:
        for law in chosen:
            own = parse(text, name, folder, [*sets, Override.of_option("law", law), *_override(given)])
            topology = law_checks.checked(_of_every_node(own) if given != AS_FILE else own)
            settings.append(Setting((_name(given), law), topology))
    if len({one.values for one in settings}) < len(settings):
        raise UserError("disturbances: one is given twice. Give each once.", code=Code.OPTION)
    return Comparison(("disturbance", "law"), tuple(settings), seeds, "in-process", folder)


def disturbances_of(text: str) -> list[str]:
    """Return the disturbances of a command line, split at the commas outside brackets."""
    return split(text)


def _name(given: Any) -> str:
    return given if isinstance(given, str) else json.dumps(given)


def _override(given: Any) -> list[str]:
    """Return the setting that makes a disturbance the default one."""
    if given == AS_FILE:
        return []
    if isinstance(given, str) and not given.lstrip().startswith(("{", "[")):
        names = given.split("+")
        if strange := [name for name in names if name not in PRESETS]:
            raise UserError(
                f"--disturbances {given}: {strange[0]} is no disturbance. Choose of {', '.join((*PRESETS, AS_FILE))},"
                " join some by +, or write one as in a file.",
                code=Code.OPTION,
            )
        parts = [PRESETS[name] for name in names]
        return [f"defaults.disturbance={json.dumps(parts if len(parts) > 1 else parts[0])}"]
    return [f"defaults.disturbance={given if isinstance(given, str) else json.dumps(given)}"]


def _of_every_node(topology: Topology) -> Topology:
    """Return a topology with no disturbance except the default one."""
    table = topology.given
    if isinstance(topology.nodes, Nodes) or (table is not None and table.disturbance is not None):
        raise UserError(
            f"--disturbances: the table of {topology.name} gives the disturbances. Take them out of it, or compare"
            f" under `{AS_FILE}` only.",
            code=Code.OPTION,
        )
    nodes = {node: own.model_copy(update={"disturbance": None}) for node, own in topology.nodes.items()}
    return topology.model_copy(update={"nodes": nodes, "disturbance": None})
