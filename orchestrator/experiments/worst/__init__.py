"""The worst disturbance of a network under its law: a lower bound on the gain, beside the upper bounds.

`worst` searches for a given time and writes three files: worst.yaml, a network that repeats the gain; worst.json, the
result; and worst.npz, the state to continue the search.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hedgerow.orchestrator.experiments.worst.hunt import Attack, Hunt
from hedgerow.orchestrator.metrics.gain_bound import Premise
from hedgerow.orchestrator.metrics.gain_plant import Plant
from hedgerow.orchestrator.metrics.guarantee import (
    Guarantee,
    fingerprint,
    guarantee,
    plant_of,
    rounded_down,
    rounded_up,
)
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.json_file import read_json
from hedgerow.topologies.resolve import to_yaml
from hedgerow.topologies.schema import Topology

NAME = "worst.yaml"


@dataclass(frozen=True)
class Found:
    """The result of a search."""

    topology: Topology
    """a network with this gain in a run"""
    attack: Attack
    """the disturbance and the faults with the largest gain"""
    guarantee: Guarantee
    """the upper bounds on the gain"""
    law: str
    """the law that was attacked, as in a file"""
    faults: dict[str, float]
    """by single fault: the best gain with it; empty unless faults were searched"""
    seconds: float
    """the search time, including that before an interruption [s]"""

    @property
    def gain(self) -> float:
        """Return the gain of a run of `topology`, sqrt(sum cost / sum |w|^2)."""
        return self.attack.gain

    @property
    def limit(self) -> float:
        """Return the gain that longer runs approach if the disturbance holds its last value; otherwise `gain`."""
        return self.attack.limit

    @property
    def premise(self) -> Premise:
        """Return the premise of the upper bound that the run obeys."""
        return Premise.EDGES if self.attack.breaks.cuts else Premise.ESTIMATES

    def sandwich(self) -> str:
        """Return the bounds on both sides in one line."""
        above = self.guarantee.bounds.get(self.premise)
        most = f"at most {rounded_up(above.gain, 4)}" if above else "no upper bound is known"
        return f"oracle {self.guarantee.gamma_star:.4g} <= {self.law}: at least {rounded_down(self.limit)}, {most}"

    def text(self) -> str:
        """Return the result in words."""
        held = f"; {rounded_down(self.limit)} is the limit of longer runs" if self.attack.holds else ""
        lines = [
            self.sandwich(),
            f"a run of {self.attack.steps} steps from x(0) = 0 reaches {self.gain:.10g}{held}",
        ]
        if self.faults:
            worst = sorted(self.faults.items(), key=lambda one: -one[1])[:5]
            lines += [
                "single faults that hurt most:",
                *(f"  {gain:.4f}  {what}" for what, gain in worst),
            ]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as in worst.json."""
        return {
            "network": fingerprint(plant_of(self.topology.network)),
            "law": self.law,
            "gain": self.gain,
            "limit": self.limit,
            "steps": self.attack.steps,
            "faulty": bool(len(self.attack.breaks)),
            "faults": self.faults,
            "seconds": self.seconds,
            "guarantee": self.guarantee.to_dict(),
        }


def worst(
    topology: Topology,
    budget_s: float = 60.0,
    faults: bool = False,
    seed: int = 0,
    steps: int = 4000,
    out: Path | None = None,
    say: Callable[[str], None] = lambda _: None,
    quit_now: Callable[[], bool] = lambda: False,
) -> Found:
    """Search for the worst disturbance of a network for `budget_s` seconds, and write it if `out` names a file.

    `faults` searches cuts and drops too. `steps` is the length of the run of a disturbance that holds its last value. A
    stopped search continues with the files of `out`. Raises UserError for a network that is too large.
    """
    hunt = Hunt(topology, seed, faults, steps)
    state_file = None if out is None else _state_beside(out)
    if state_file is not None and state_file.exists() and hunt.resume(state_file):
        say(f"continues after {hunt.state.seconds:.0f} s, with gain {hunt.best_score() ** 0.5:.4f}")
    hunt.run(budget_s, say, quit_now)
    attack, network = hunt.proved()
    found = Found(
        network,
        attack,
        guarantee(plant_of(topology.network), topology.network.gamma_star),
        topology.law,
        {hunt.named(breaks): gain for breaks, gain in hunt.fault_gains.items()},
        hunt.state.seconds,
    )
    if out is not None and state_file is not None:
        try:
            hunt.save(state_file)
            out.write_text(to_yaml(network), encoding="utf-8")
            out.with_suffix(".json").write_text(json.dumps(found.to_dict(), indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise UserError(
                f"{out}: cannot be written: {error.strerror}. Choose another --out.", code=Code.OUTPUT
            ) from None
    return found


def _state_beside(out: Path) -> Path:
    """Return the file of a search's state beside `out`. Raises UserError if a file of the user would be replaced."""
    if not out.name or out.suffix in (".npz", ".json"):
        raise UserError(f"--out {out}: is no name of a network. Name a file such as {NAME}.", code=Code.OPTION)
    state_file, result = out.with_suffix(".npz"), out.with_suffix(".json")
    try:
        if not os.access(out.parent, os.W_OK | os.X_OK) or not out.parent.is_dir():
            raise UserError(f"--out {out}: {out.parent} is no folder to write in. Choose another.", code=Code.OUTPUT)
        is_ours = state_file.exists()  # else `Hunt.resume` refuses it
        if result.exists():
            content = read_json(result)
            is_ours = isinstance(content, dict) and content.keys() >= {"network", "law", "gain", "guarantee"}
            if not is_ours:
                raise UserError(
                    f"{result}: exists and is no result of `worst`. Choose another --out.", code=Code.OUTPUT
                )
        if out.exists() and not is_ours:
            raise UserError(f"{out}: exists and is no result of `worst`. Choose another --out.", code=Code.OUTPUT)
    except OSError as error:
        raise UserError(f"--out {out}: {error.strerror}. Choose another.", code=Code.OUTPUT) from None
    return state_file


def at_least(plant: Plant, folder: Path) -> float | None:
    """Return the gain in a worst.json, found for minimax on a network without faults; None if there is none."""
    try:
        earlier = read_json((folder / NAME).with_suffix(".json"))
        if earlier["network"] == fingerprint(plant) and earlier["law"] == "minimax" and not earlier["faulty"]:
            return float(earlier["limit"])
    except (UserError, OSError, ValueError, KeyError, TypeError):
        pass
    return None
