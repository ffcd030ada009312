"""The runs of a comparison: every law under every disturbance and every seed, on one network."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hedgerow.orchestrator.experiments.sweep.plan import Plan, Setting, split
from hedgerow.orchestrator.ground import laws as law_checks
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.law_choice import NAMES
from hedgerow.topologies.named import Given, Named, given
from hedgerow.topologies.nodes import Nodes
from hedgerow.topologies.override import Override
from hedgerow.topologies.plain import plain
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.settings import Defaults

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
_ONE_NODE = b"{name: disturbance, b: 0.1, steps: 1, nodes: [0]}"


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
    undrawn = given(network)
    chosen = [name for law in laws for name in (NAMES if law == "all" else (law,))]
    chosen = list(dict.fromkeys([*(law for law in chosen if law not in BESIDE), *BESIDE]))
    settings = []
    for disturbance in disturbances:
        for law in chosen:
            own = undrawn.with_overrides(*sets, Override.of_option("law", law)).parse()
            if disturbance != AS_FILE:
                own = _under(own, _defaults(disturbance, undrawn.folder))
            settings.append(Setting((_name(disturbance), law), law_checks.checked(own, undrawn.folder)))
    if len({one.values for one in settings}) < len(settings):
        raise UserError("disturbances: one is given twice. Give each once.", code=Code.OPTION)
    return Comparison(("disturbance", "law"), tuple(settings), seeds, "in-process", undrawn.folder)


def disturbances_of(text: str) -> list[str]:
    """Return the disturbances of a command line, split at the commas outside brackets."""
    return split(text)


def _name(given: Any) -> str:
    return given if isinstance(given, str) else json.dumps(given)


def _defaults(disturbance: Any, folder: Path) -> Defaults:
    """Return `defaults:` with a disturbance and nothing else. Raises UserError for one that a file cannot have."""
    value = disturbance if isinstance(disturbance, str) else json.dumps(plain(disturbance, "disturbance: "))
    parts = split(value, "+")
    if strange := [part for part in parts if part not in PRESETS and not part.startswith(("{", "["))]:
        raise UserError(
            f"--disturbances {value}: {strange[0] or 'nothing'} is no disturbance. Choose one of"
            f" {', '.join((*PRESETS, AS_FILE))}, write one as in a file, such as {{kind: constant, value: 1}}, or join"
            " some by +.",
            code=Code.OPTION,
        )
    parts = [json.dumps(PRESETS[part]) if part in PRESETS else part for part in parts]
    joined = f"[{', '.join(parts)}]" if len(parts) > 1 else parts[0]
    # A network of one node: its own disturbances would hide the default one.
    try:
        return Given(_ONE_NODE, "disturbance", folder, (f"defaults.disturbance={joined}",)).parse().defaults
    except TopologyError as error:
        origin, inside = f"--disturbances {value}", "defaults: disturbance"
        problems = [
            replace(one, origin=origin, place=one.place.removeprefix(inside).removeprefix(": "))
            for one in error.problems
        ]
        raise TopologyError("disturbance", problems) from None


def _under(topology: Topology, defaults: Defaults) -> Topology:
    """Return a topology with the default disturbance of `defaults` and no other."""
    table = topology.given
    if isinstance(topology.nodes, Nodes) or (table is not None and table.disturbance is not None):
        raise UserError(
            f"--disturbances: the table of {topology.name} gives the disturbances. Take them out of it, or compare"
            f" under `{AS_FILE}` only.",
            code=Code.OPTION,
        )
    nodes = {node: own.model_copy(update={"disturbance": None}) for node, own in topology.nodes.items()}
    own = topology.defaults.model_copy(update={"disturbance": defaults.disturbance})
    return topology.model_copy(update={"nodes": nodes, "disturbance": None, "defaults": own})
