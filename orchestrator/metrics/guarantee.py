"""The guarantee of a network: gamma* of the oracle, and upper bounds on the gain of the adaptive law."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hedgerow.orchestrator.metrics.gain_bound import Bound, Method, Premise, bound, method_for
from hedgerow.orchestrator.metrics.gain_learning import Learning
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.network import Network

SAYS = {
    Premise.ESTIMATES: "any estimates from the lists, every edge open (also if link messages are lost or late), no a"
    " jumps",
    Premise.EDGES: "any estimates, and any edges closed at any steps (cut, partition, sensor, actuator, crash)",
    Premise.JUMPS: "any estimates, any closed edges, and any a within its list at any step (jump)",
}
LEARNING = "the law (7) itself with what it learns, every edge open, every message on time, no a jumps"
TIME_LIMIT_S = 600.0
RUN_LIMIT_S = 30.0
"""the time limit of the bounds that certify a run, all together [s]: the end of the run waits for them"""
SOLVED = 300
"""Number of nodes of a run up to which the solver is used."""
REMEMBERED = 64


@dataclass(frozen=True)
class Guarantee:
    """Bounds by premise, and the reason for each missing one."""

    gamma_star: float
    """the optimal gain if every a is known and every edge is open; NaN if it is not known"""
    bounds: Mapping[Premise, Bound] = field(default_factory=dict)
    """the upper bound on the gain under each premise"""
    not_computed: Mapping[str, str] = field(default_factory=dict)
    """the reason for each missing bound, by premise or, for the bound that counts what the law learns, `learning`"""
    at_least: float | None = None
    """the gain of the worst disturbance that `orchestrator worst` found"""
    reached: float | None = None
    """the gain of a finished run of that disturbance; smaller than `at_least` if longer runs come nearer to it"""
    attack: str = ""
    """the file of that result"""
    learning: Learning | str | None = None
    """the bound that counts what the law (7) learns, or why there is none; None if it was not asked for"""

    def __repr__(self) -> str:
        bounds = ", ".join(f"{premise} {found.gain:.4g}" for premise, found in self.bounds.items())
        return f"<Guarantee: gamma* {self.gamma_star:.4g}, bounds: {bounds or 'none'}>"

    def to_dict(self) -> dict[str, Any]:
        """Return the guarantee as JSON holds it; the storage p_i of each bound with it."""
        listed: dict[str, Any] = {}
        for premise in Premise:
            if (found := self.bounds.get(premise)) is not None:
                listed[premise] = {
                    "gain": found.gain,
                    "g": found.g,
                    "method": str(found.method),
                    "margin": found.margin,
                    "p": found.p.tolist(),
                }
            elif premise in self.not_computed:
                listed[premise] = {"not_computed": self.not_computed[premise]}
        if isinstance(self.learning, Learning):
            counted = self.learning
            listed["learning"] = {
                "gain": counted.gain,
                "g": counted.g,
                "theta": counted.theta,
                "models": counted.models,
            }
        elif self.learning is not None:
            listed["learning"] = {"not_computed": self.learning}
        gamma_star = self.gamma_star if math.isfinite(self.gamma_star) else None
        return {"gamma_star": gamma_star, "at_least": self.at_least, "reached": self.reached, "bounds": listed}

    def text(self) -> str:
        """Return the guarantee in words, one line per number."""
        lines = [
            "for the truth of this network only, every a as in its file or as its seed drew it:",
            f"oracle      {_figure(self.gamma_star):>8}  optimal if every a is known and every edge is open; no promise"
            " of the adaptive law",
        ]
        if self.at_least is not None:
            shown = rounded_down(self.at_least)
            is_reached = self.reached is not None and self.reached >= float(shown)
            how = "reached by a run" if is_reached else "approached by longer runs"
            lines.append(f"at least    {shown:>8}  {how} of the attack in {self.attack}")
        if isinstance(self.learning, Learning):
            lines.append(f"at most     {rounded_up(self.learning.gain):>8}  under {LEARNING}")
        elif self.learning is not None:
            lines.append(f"not computed          under {LEARNING}: {self.learning}")
        for premise in Premise:
            if not premise.needs_truth and (premise in self.bounds or premise in self.not_computed):
                lines.append("for any truth, every a(t) within its list at every step:")
            if (found := self.bounds.get(premise)) is not None:
                how = {Method.FULL: ", full P", Method.UNIFORM: ", one multiplier"}.get(found.method, "")
                lines.append(f"at most     {rounded_up(found.gain):>8}  under {SAYS[premise]}{how}")
            elif premise in self.not_computed:
                lines.append(f"not computed          under {SAYS[premise]}: {self.not_computed[premise]}")
        lines.append(
            "The gain squared is sum |x|^2 + sum k_e (u_i - u_j)^2 over sum |w|^2, from x(0) = 0. An upper bound holds"
            " for every disturbance and every number of steps, if each u acts within the lists. Except in the bound of"
            " (7) it ignores learning, so the true gain may be smaller."
        )
        return "\n".join(lines)


def plant_of(network: Network) -> PlantModel:
    """Return the numbers of a network that affect its bounds; the lists are those of the file, under any law."""
    return PlantModel.of(
        network.a,
        network.b,
        network.graph.edges,
        network.graph.weights,
        np.nanmin(network.candidates, axis=0),
        np.nanmax(network.candidates, axis=0),
    )


def fingerprint(plant: PlantModel) -> str:
    """Return a hash of all that the gain of a network depends on."""
    digest = hashlib.sha256()
    for each in (plant.a, plant.b, plant.edges, plant.root_weights, plant.lowest, plant.highest):
        digest.update(np.ascontiguousarray(each).tobytes())
    return digest.hexdigest()[:16]


def guarantee(
    plant: PlantModel,
    gamma_star: float = math.nan,
    method: Method | None = None,
    premises: Iterable[Premise] = Premise,
    time_limit_s: float = TIME_LIMIT_S,
) -> Guarantee:
    """Return the bounds of a plant under some premises; by `method_for` if `method` is None."""
    bounds: dict[Premise, Bound] = {}
    reasons: dict[str, str] = {}
    until = time.monotonic() + time_limit_s
    wanted = tuple(premises)
    for premise in sorted(wanted, key=[Premise.EDGES, Premise.ESTIMATES, Premise.JUMPS].index):
        edges = bounds.get(Premise.EDGES)
        how = method or method_for(plant, premise)
        if premise == Premise.ESTIMATES and how == Method.UNIFORM and edges and edges.method == Method.UNIFORM:
            bounds[premise] = replace(edges, premise=premise)
            continue
        try:
            bounds[premise] = bound(plant, premise, method, until - time.monotonic())
        except HedgerowError as error:
            reasons[premise] = str(error)
    return Guarantee(gamma_star, bounds, reasons)


_CERTIFIED: dict[str, Guarantee] = {}
"""the guarantees of the last networks that ran in this process, by fingerprint"""


def certified(plant: PlantModel, gamma_star: float) -> Guarantee:
    """Return the guarantee that certifies a run; the second run of a network in a process does not solve again."""
    key = fingerprint(plant)
    if key not in _CERTIFIED:
        if len(_CERTIFIED) >= REMEMBERED:
            _CERTIFIED.clear()
        # The end of a run waits for the bounds: closed forms take a second at most.
        method = Method.UNIFORM if plant.n > SOLVED else None
        _CERTIFIED[key] = guarantee(plant, gamma_star, method, time_limit_s=RUN_LIMIT_S)
    return _CERTIFIED[key]


def _figure(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "unknown"


def rounded_up(value: float, digits: int = 4) -> str:
    """Return an upper bound in some digits, rounded up."""
    places = digits - 1 - math.floor(math.log10(value)) if value > 0 else 0
    return f"{math.ceil(value * 10**places) / 10**places:.{max(0, places)}f}"


def rounded_down(value: float, digits: int = 4) -> str:
    """Return a lower bound in some digits, rounded down."""
    places = digits - 1 - math.floor(math.log10(value)) if value > 0 else 0
    return f"{math.floor(value * 10**places) / 10**places:.{max(0, places)}f}"
