"""The worst disturbance of a network under its law: a lower bound on the gain, beside the upper bounds.

`worst` searches under a budget and writes three files: worst.yaml, a network that repeats the gain; worst.json,
the result; and worst.npz, from which the same search continues.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hedgerow.orchestrator.experiments.worst.hunt import Attack, Hunt
from hedgerow.orchestrator.metrics.gain_bound import Bound, Method, Premise
from hedgerow.orchestrator.metrics.gain_learning import Learning, learning
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.guarantee import (
    Guarantee,
    fingerprint,
    guarantee,
    plant_of,
    rounded_down,
    rounded_up,
)
from hedgerow.topologies.describe import describe
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.json_file import read_json
from hedgerow.topologies.resolve import save
from hedgerow.topologies.schema import Topology

NAME = "worst.yaml"
UNREPEATED = 1e-4
"""The part by which a gain that the search saw may exceed the repeated one, before the difference is reported."""


@dataclass(frozen=True)
class Found:
    """The result of a search."""

    topology: Topology
    """a network that has this gain in its run"""
    attack: Attack
    """the disturbance and the faults with the largest gain"""
    guarantee: Guarantee
    """the upper bounds on the gain"""
    law: str
    """the law that was attacked, as a file names it"""
    faults: dict[str, float]
    """by single fault: the best gain with it in the search; empty unless faults were searched"""
    faults_of: int
    """number of single faults that there are; the search may have tried fewer"""
    seconds: float
    """of search, those before an interruption included"""
    without_faults: float | None = None
    """the best gain without faults in the search, to compare `faults` with; None unless faults were searched"""
    repeat_seconds: float = 0.0
    """of the runs after the search, which repeat its attacks"""

    def __repr__(self) -> str:
        above = "" if self.ceiling is None else f", at most {self.ceiling:.4g}"
        return f"<Found {self.topology.name}: gain {self.gain:.4g}{above}, law {self.law}, {self.seconds:.1f} s>"

    @property
    def gain(self) -> float:
        """Return the gain of a run of `topology`, sqrt(sum cost / sum |w|^2)."""
        return self.attack.gain

    @property
    def limit(self) -> float:
        """Return the gain that longer runs come near, if the disturbance holds its last value; else `gain`."""
        return self.attack.limit

    @property
    def premise(self) -> Premise:
        """Return the premise of the upper bound that the run obeys."""
        return Premise.EDGES if self.attack.breaks.cuts else Premise.ESTIMATES

    @property
    def attack_faults(self) -> list[str]:
        """Return the faults of the run of `topology`, each in words."""
        return [describe(fault) for fault in self.topology.faults]

    @property
    def ceiling(self) -> float | None:
        """Return the least upper bound on the gain of the law under the faults of the attack; None without one."""
        above = self.guarantee.bounds.get(self.premise)
        learning = self.guarantee.learning if self.law == "minimax" and not len(self.attack.breaks) else None
        bounds = [one.gain for one in (above, learning) if isinstance(one, Bound | Learning)]
        return min(bounds, default=None) if self.attack.within else None

    @property
    def harmful(self) -> list[tuple[str, float]]:
        """Return the single faults with a larger gain than without faults, and the gain, the largest first."""
        least = (self.without_faults or 0.0) * (1 + UNREPEATED)
        return sorted((one for one in self.faults.items() if one[1] > least), key=lambda one: -one[1])

    def sandwich(self) -> str:
        """Return the bounds on both sides in one line."""
        above = self.ceiling
        most = f"at most {rounded_up(above)}" if above is not None else "no upper bound is known"
        if not self.attack.within:
            most = "no upper bound holds, because it acts outside the lists"
        return f"oracle {self.guarantee.gamma_star:.4g} <= {self.law}: at least {rounded_down(self.limit)}, {most}"

    def text(self) -> str:
        """Return the result in words."""
        held = f"; {rounded_down(self.limit)} is the limit of longer runs" if self.attack.holds else ""
        lines = [
            self.sandwich(),
            f"a run of {self.attack.steps} steps from x(0) = 0 reaches {self.gain:.10g}{held}",
        ]
        if self.limit < self.guarantee.gamma_star:
            lines.append(
                f"no attack found reaches {self.guarantee.gamma_star:.4g}, and the gain of every law is at least that"
            )
        if self.topology.faults:
            lines.append(f"the faults of this run: {', '.join(self.attack_faults)}")
        if self.faults:
            worst = self.harmful[:5]
            tried = f"{len(self.faults)} tried and {self.faults_of} in all"
            lines += [
                f"single faults that raise the gain most, of {tried}:"
                if worst
                else f"no single fault raises the gain, of {tried}",
                *([] if self.without_faults is None else [f"  {self.without_faults:.4f}  without faults"]),
                *(f"  {gain:.4f}  {what}" for what, gain in worst),
            ]
        lines.append(
            f"{self.seconds:.1f} s of search, then {self.repeat_seconds:.1f} s of runs that repeat its attacks"
        )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as worst.json holds it."""
        return {
            "network": fingerprint(plant_of(self.topology.network)),
            "law": self.law,
            "at_most": self.ceiling,
            "within_lists": self.attack.within,
            "gain": self.gain,
            "limit": self.limit,
            "steps": self.attack.steps,
            "faulty": bool(len(self.attack.breaks)),
            "attack_faults": self.attack_faults,
            "faults": self.faults,
            "faults_in_all": self.faults_of,
            "without_faults": self.without_faults,
            "seconds": self.seconds,
            "repeat_seconds": self.repeat_seconds,
            "guarantee": self.guarantee.to_dict(),
        }


def worst(
    topology: Topology,
    budget_s: float = 60.0,
    faults: bool = False,
    seed: int = 0,
    steps: int | None = None,
    out: Path | None = None,
    say: Callable[[str], None] = lambda _: None,
    quit_now: Callable[[], bool] = lambda: False,
) -> Found:
    """Search the worst disturbance of a network for `budget_s` seconds, and write it if `out` names a file.

    The runs that repeat the best attacks come after this time; `Found.repeat_seconds` is what they took.
    `faults` searches cuts and drops too. `steps` is the length of the run of a disturbance that holds its last value.
    A stopped search continues from the files of `out`. Raises UserError for a network that is too large.
    """
    hunt = Hunt(topology, seed, faults, steps)
    state_file = None if out is None else _state_beside(out)
    with contextlib.nullcontext(True) if state_file is None else _held(state_file) as is_new:
        if state_file is not None and not is_new:
            if hunt.resume(state_file):
                say(f"continues after {hunt.state.seconds:.0f} s, with gain {hunt.best_score() ** 0.5:.4f}")
            else:
                say(f"replaces the attack of {out}, which has another --seed, --faults or --steps")
        hunt.run(budget_s, say, quit_now)
        found = _written(hunt, topology, out, state_file, say, quit_now)
        if (seen := hunt.best_score() ** 0.5) > found.limit * (1 + UNREPEATED):
            say(
                f"{found.limit:.4f} counts: the {seen:.4f} of the search has no longer run that repeats it;"
                " another --seed, or other --steps, may help"
            )
        return found


def _state_beside(out: Path) -> Path:
    """Return the file of a search's state beside `out`. Raises UserError if a file of the user would be replaced."""
    if not out.name or out.suffix in (".npz", ".json"):
        raise UserError(f"--out {out}: is no name of a network. Name a file such as {NAME}.", code=Code.OPTION)
    state_file, result = out.with_suffix(".npz"), out.with_suffix(".json")
    try:
        if not os.access(out.parent, os.W_OK | os.X_OK) or not out.parent.is_dir():
            raise UserError(f"--out {out}: {out.parent} is no folder to write in. Choose another.", code=Code.OUTPUT)
        # A folder such as /proc refuses files that its mode allows: find that out before the search.
        with tempfile.TemporaryFile(dir=out.parent):
            pass
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


@contextlib.contextmanager
def _held(state_file: Path) -> Iterator[bool]:
    """Let no other search write the same files while the block runs; yield True if they are new; raises UserError."""
    is_new = not state_file.exists()
    if not is_new and not state_file.is_file():
        raise UserError(f"{state_file}: is no regular file. Choose another --out.", code=Code.OUTPUT)
    try:
        file = state_file.open("ab")
    except OSError as error:
        raise UserError(
            f"{state_file}: cannot be written: {error.strerror}. Choose another --out.", code=Code.OUTPUT
        ) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(
                f"{state_file}: another search writes it. Wait for it, or choose another --out.", code=Code.OUTPUT
            ) from None
        try:
            yield is_new
        finally:
            if is_new and not state_file.stat().st_size:  # nothing was found
                state_file.unlink()


def _written(
    hunt: Hunt,
    topology: Topology,
    out: Path | None,
    state_file: Path | None,
    say: Callable[[str], None],
    quit_now: Callable[[], bool],
) -> Found:
    """Return the result of a search, and write it if `out` names a file."""
    began = time.monotonic()
    attack, network = hunt.repeated(say, quit_now)
    took = time.monotonic() - began
    found = Found(
        network,
        attack,
        guarantee_of(topology),
        topology.law,
        {hunt.named(breaks): gain for breaks, gain in hunt.fault_gains.items()},
        hunt.faults_of,
        hunt.state.seconds,
        hunt.unbroken if hunt.faults else None,
        took,
    )
    if out is not None and state_file is not None:
        try:
            hunt.save(state_file)
            save(network, out)
            out.with_suffix(".json").write_text(json.dumps(found.to_dict(), indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise UserError(
                f"{out}: cannot be written: {error.strerror}. Choose another --out.", code=Code.OUTPUT
            ) from None
    return found


def guarantee_of(topology: Topology, method: Method | None = None) -> Guarantee:
    """Return gamma* of a network and every upper bound on the gain of its law."""
    network = topology.network
    plant = plant_of(network)
    counted: Learning | str
    try:
        counted = learning(plant, network.candidates)
    except HedgerowError as error:
        counted = str(error)
    found = guarantee(plant, network.gamma_star, method)
    missing = {"learning": counted} if isinstance(counted, str) else {}
    return replace(found, learning=counted, not_computed={**found.not_computed, **missing})


def at_least(plant: PlantModel, folder: Path) -> tuple[float, float, str] | None:
    """Return the largest gain that `worst` found for minimax on a network without faults; None if there is none.

    It looks at the results in `folder`. The first number is the gain that longer runs come near, the second is the gain
    of the finished run, and the text is the name of the file.
    """
    found: list[tuple[float, float, str]] = []
    for state_file in sorted(folder.glob("*.npz")):  # every result is beside the state of its search
        file = state_file.with_suffix(".json")
        with contextlib.suppress(UserError, OSError, ValueError, KeyError, TypeError):
            result = read_json(file)
            if result["network"] == fingerprint(plant) and result["law"] == "minimax" and not result["faulty"]:
                found.append((float(result["limit"]), float(result["gain"]), file.name))
    return max(found, default=None)
