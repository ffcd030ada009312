"""The search for the worst disturbance of a network under a budget of time, and the run that repeats it."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hedgerow.orchestrator.experiments.sweep.runs import run_here
from hedgerow.orchestrator.experiments.worst.loop import NONE, Breaks, Played, Scene, play
from hedgerow.orchestrator.experiments.worst.search import Island, Kind
from hedgerow.orchestrator.metrics.guarantee import fingerprint, plant_of
from hedgerow.topologies import archive
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.faults import Cut, Drop, FaultModel
from hedgerow.topologies.graph import Array
from hedgerow.topologies.load import parse
from hedgerow.topologies.paths import beside
from hedgerow.topologies.resolve import resolve, text_beside_table
from hedgerow.topologies.schema import Topology

KINDS = (Kind(1, True), Kind(4, True), Kind(6, False), Kind(8, False), Kind(12, False), Kind(20, False))
"""The disturbances that are tried, in this order."""
SIZE, SMALLEST, ROWS = 48, 8, 20_000
"""The number of members of a population; its minimum; and the nodes of all members together in large networks."""
MOST, FEW_ROWS = 128, 400
"""The number of members in the smallest networks, and the nodes of all members together: there, a step takes as long
for 128 as for 48, and more of them find the best order of switches."""
SLICE_S, SLICE = 0.25, 5
"""The processor time of one turn of an island, and its least number of generations: one of each kind of trial."""
STALE = 120
"""The number of generations without a better gain after which a new island replaces an old one."""
STEPS, LEAST_STEPS, FEW = 10_000, 4_000, 100
"""Steps of the run of a disturbance that holds its last value: for up to FEW nodes, and for more."""
SILENT_S = 10.0
"""The time without a larger gain after which the search reports it; then after twice the time, and so on [s]."""
LARGEST = 2_000
"""Number of nodes up to which a disturbance is sought."""
SAME = 1e-9
"""Relative difference of two gains that are the same."""
BROKEN_SHARE = 0.5
"""Share of the budget for faults, where they are asked for."""
MOST_FAULTS = 3
LEAST_GENERATIONS = 3
NUDGE, NUDGED, STEADY = 1e-8, 2, 1e-5
"""Relative size of small changes of a disturbance, their number, and how much the gain may change, relative to it."""
SCALES = np.array([1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0])
"""Factors of the impulses before a value that stays."""
TRIED = 600
"""Steps of the runs that choose the size of the impulses."""
RANKS = (1, 2, 4, 8, 16, 32, 64)
"""Places of the members of a population that are tried beside its best, in the order of their gains."""
SETTLED = 1e-6
"""Change of 1/(1 - ahat) in the second half of a run that has settled."""

Say = Callable[[str], None]
Quit = Callable[[], bool]


@dataclass(frozen=True)
class Attack:
    """A disturbance, the faults with it, and the gain that it reaches."""

    w: Array
    """(T, n)"""
    holds: bool
    """True if the last value stays"""
    breaks: Breaks
    gain: float
    """of a run of `steps` steps"""
    limit: float
    """of a disturbance that holds the settled gain, which longer runs come near; else the gain"""
    steps: int
    within: bool = True
    """True if the law acts within the lists at every step, as the upper bounds need"""


@dataclass
class State:
    """All that a search needs to go on."""

    islands: list[Island]
    champions: dict[tuple[Kind, Breaks], tuple[Array, float, int]]
    """by kind and faults: the best disturbance so far with its score and its steps"""
    seconds: float = 0.0
    stale: list[int] = field(default_factory=list)
    turns: int = 0
    """of islands; a search that is continued in short pieces gives each its turn"""


class Hunt:
    """A search that can be stopped and continued later."""

    def __init__(self, topology: Topology, seed: int = 0, faults: bool = False, steps: int | None = None) -> None:
        """Take `steps` as the length of the run of a disturbance that holds its last value; None chooses one."""
        if len(topology.ids) > LARGEST:
            raise UserError(
                f"{topology.name}: has {len(topology.ids)} nodes; a disturbance is sought for {LARGEST}",
                code=Code.TOPOLOGY,
            )
        self.topology = quiet(topology)
        self.scene = Scene.of(self.topology)
        steps = steps or (STEPS if len(topology.ids) <= FEW else LEAST_STEPS)
        self.steps, self.faults = steps, faults
        self.rng = np.random.default_rng(seed)
        size = max(SIZE, min(MOST, FEW_ROWS // len(topology.ids)))
        self.size = min(size, max(SMALLEST, ROWS // len(topology.ids)))
        self._key = f"{fingerprint(plant_of(topology.network))} {topology.law} {seed} {faults} {steps}"
        self.state = State([], {})
        self.fault_gains: dict[Breaks, float] = {}
        """by single fault: the best gain with it; of those under which a disturbance was found"""
        self.faults_of = 0
        """number of single faults that there are"""

    def run(self, budget_s: float, say: Say, quit_now: Quit = lambda: False) -> None:
        """Search for so long; `say` gets a line for every gain that is larger than before, and for long pauses."""
        began = time.monotonic()
        until = began + budget_s * (1 - BROKEN_SHARE if self.faults else 1.0)
        best = self.best_score()
        found, silent = began, SILENT_S
        for island in self._turns():
            # One generation is always made: the constant that is worst for the oracle is in it.
            if best > 0 and (time.monotonic() >= until or quit_now()):
                break
            self._evolve(island, NONE, until, quit_now)
            if self.best_score() > best * (1 + 1e-4):
                best, found, silent = self.best_score(), time.monotonic(), SILENT_S
                say(f"gain {best**0.5:.4f} in the search")
            elif (waited := time.monotonic() - found) >= silent:
                silent *= 2
                say(f"gain {best**0.5:.4f} in the search, and none larger for {waited:.0f} s")
        if self.faults:
            self._break(max(began + budget_s, time.monotonic()), say, quit_now)
        self.state.seconds += time.monotonic() - began

    @property
    def unbroken(self) -> float | None:
        """Return the largest gain that the search saw without faults; None before the first."""
        scores = [found[1] for (_, breaks), found in self.state.champions.items() if breaks == NONE]
        return max(scores) ** 0.5 if scores else None

    def best_score(self) -> float:
        """Return the largest gain squared so far."""
        return max((found[1] for found in self.state.champions.values()), default=0.0)

    def _turns(self) -> Iterator[int]:
        """Yield the number of the next island: each in turn, and every second time the best."""
        islands = self.state.islands
        if not islands:
            islands += [Island.new(self.scene, kind, self.size, self.rng) for kind in KINDS]
            self.state.stale = [0] * len(islands)
        while True:
            each, is_best = divmod(self.state.turns, 2)
            self.state.turns += 1
            scored = [float(island.score.max(initial=0.0)) for island in islands]
            yield int(np.argmax(scored)) if is_best else each % len(islands)

    def _evolve(self, number: int, breaks: Breaks, until: float, quit_now: Quit) -> None:
        """Improve one population for a turn, which a slow machine may not cut short before `until`."""
        island, turn = self.state.islands[number], time.process_time() + SLICE_S
        for generation in itertools.count(1):
            before = float(island.score.max(initial=0.0))
            island.evolve(self.scene, self.rng)
            grown = float(island.score.max()) > before * (1 + 1e-6)
            self.state.stale[number] = 0 if grown else self.state.stale[number] + 1
            self._crown(island)
            if self.state.stale[number] > STALE:
                self.state.islands[number] = Island.new(self.scene, island.kind, self.size, self.rng, breaks)
                self.state.stale[number] = 0
                return
            is_over = time.process_time() >= turn and generation >= SLICE
            if is_over or time.monotonic() >= until or quit_now():
                return

    def _crown(self, island: Island) -> None:
        key, score = (island.kind, island.breaks), float(island.score.max())
        if score > 0 and (key not in self.state.champions or score > self.state.champions[key][1]):
            best = island.best
            self.state.champions[key] = (island.members[best].copy(), score, int(island.steps[best]))

    def _break(self, until: float, say: Say, quit_now: Quit) -> None:
        """Try every cut and drop alone, then add faults to the best, one at a time."""
        graph, breaking = self.scene.graph, NONE
        best = (self.unbroken or 0.0) ** 2
        singles = [Breaks(cuts=((e, first),)) for e in range(len(graph.edges)) for first in (0,)]
        singles += [Breaks(drops=((k, first),)) for k in range(len(graph.node)) for first in (0, 2, 4)]
        self.faults_of = len(singles)
        while len(breaking) < MOST_FAULTS:
            order = self.rng.permutation(len(singles))
            share = (until - time.monotonic()) / (MOST_FAULTS - len(breaking))
            deadline, each = time.monotonic() + share, share / max(1, len(singles))
            found: tuple[float, Breaks] = (best, breaking)
            for number in order.tolist():
                if time.monotonic() >= deadline or quit_now():
                    break
                breaks = breaking + singles[number]
                score = self._under(breaks, time.monotonic() + each)
                if not len(breaking) and score > 0:
                    self.fault_gains[breaks] = score**0.5
                found = max(found, (score, breaks), key=lambda one: one[0])
            if found[1] == breaking or time.monotonic() >= until or quit_now():
                return
            best, breaking = found
            say(f"gain {best**0.5:.4f} in the search with {self.named(breaking)}")

    def _under(self, breaks: Breaks, until: float) -> float:
        """Return the best gain squared under some faults, from the best disturbances without them."""
        known = sorted(self.state.champions.items(), key=lambda one: -one[1][1])
        kind = Kind(4, True) if not known or known[0][0][0].holds else known[0][0][0]
        island = Island.new(self.scene, kind, self.size // 2, self.rng, breaks)
        alike = [_stretched(w, kind) for (own, _), (w, _, _) in known if own.holds == kind.holds]
        for place, w in enumerate(alike[: self.size // 4]):
            island.members[place] = w
        while True:
            island.evolve(self.scene, self.rng)
            if time.monotonic() >= until and island.generation > LEAST_GENERATIONS:
                self._crown(island)
                return float(island.score.max())

    def named(self, breaks: Breaks) -> str:
        """Return faults in words."""
        graph, ids = self.scene.graph, self.topology.ids
        cuts = [(graph.edges[e], first) for e, first in breaks.cuts]
        drops = [((graph.neighbour[k], graph.node[k]), first) for k, first in breaks.drops]
        parts = [f"cut {ids[i]}-{ids[j]} from step {first}" for (i, j), first in cuts]
        return ", ".join(parts + [f"drop {ids[i]} to {ids[j]} from step {first}" for (i, j), first in drops])

    def attacks(self) -> Iterator[tuple[float, Attack]]:
        """Yield the best disturbances, each behind its gain in the search, the largest first.

        An attack has the gain that its run should reach. It is smaller if an estimate changes after the search's runs.
        """
        found = [(score, kind, breaks, w, steps) for (kind, breaks), (w, score, steps) in self.state.champions.items()]
        # The best of a population may live on a tie, or settle late. Others of it do not.
        for island in self.state.islands:
            ranks = np.argsort(-island.score, kind="stable")[[k for k in RANKS if k < len(island.score)]].tolist()
            found += [
                (float(island.score[k]), island.kind, island.breaks, island.members[k], int(island.steps[k]))
                for k in ranks
                if island.score[k] > 0
            ]
        for score, kind, breaks, w, steps in sorted(found, key=lambda one: -one[0]):
            if not kind.holds:
                yield score**0.5, Attack(w[:steps], False, breaks, score**0.5, score**0.5, steps)
                continue
            # As the file has it: a constant, and impulses, of which small ones may do as well as large ones.
            scales = SCALES if kind.length > 1 else np.ones(1)
            tried = w[-1] + (w - w[-1]) * scales[:, None, None]
            limits = self._limits(play(self.scene, tried, breaks, min(self.steps, TRIED)))
            least = np.flatnonzero(limits >= limits.max() * (1 - SETTLED))[-1]
            played = play(self.scene, tried[least][None], breaks, self.steps)
            if (limit := self._limits(played)[0]) > 0:
                gain = float(np.sqrt(played.cost.sum() / np.square(played.w).sum()))
                yield score**0.5, Attack(tried[least], True, breaks, gain, float(limit), self.steps)

    def _limits(self, played: Played) -> Array:
        """Return the settled gains of some runs that hold their last value; 0 of those that have not settled."""
        energy = np.square(played.w[:, -1]).sum(axis=1)
        settled = played.settled(len(played.theta) // 2, SETTLED) & (energy > 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(settled, np.sqrt(played.cost[-1] / energy), 0.0)

    def repeated(self, say: Say = lambda _: None, quit_now: Quit = lambda: False) -> tuple[Attack, Topology]:
        """Return the best attack with a run that repeats its gain, and the topology of that run.

        The runs take as long as they need, after the time of the search. `say` gets a line before the first run, for
        every gain that a run repeats, and for long pauses. `quit_now` ends them after the first repeated gain.
        """
        best: tuple[Attack, Topology] | None = None
        say(
            f"the search ends; runs of up to {self.steps} steps repeat its best attacks, and a gain that repeats counts"
        )
        said, silent = time.monotonic(), SILENT_S
        for sought, attack in self.attacks():
            is_asked = quit_now()  # also before there is a gain: it reports the signal
            if best is not None and (sought <= best[0].limit * (1 + SETTLED) or is_asked):
                break
            if (waited := time.monotonic() - said) >= silent:
                silent *= 2
                say(f"no run has repeated a {'larger ' * (best is not None)}gain for {waited:.0f} s")
            if best is not None and attack.limit <= best[0].limit:
                continue
            is_steady, within = self.steady(attack)
            if not is_steady:
                continue
            topology = self.topology_of(attack)
            content = run_here(topology)
            gain = content["metrics"].get("gain")
            if content["verdict"] == "valid" and gain is not None and abs(gain - attack.gain) <= SAME * attack.gain:
                best = replace(attack, gain=gain, within=within), topology
                said, silent = time.monotonic(), SILENT_S
                say(f"gain {attack.limit:.4f} repeated by a run")
        if best is None:
            raise HedgerowError(f"{self.topology.name}: no disturbance was found. Give a larger --budget.")
        return best

    def steady(self, attack: Attack) -> tuple[bool, bool]:
        """Return two properties of an attack, of any law.

        The first is True if small changes of the disturbance hardly change its gain, so that it lives on no rounding
        tie. The second is True if every input is within the sector of its list, so that the upper bound covers the run.
        """
        size = NUDGE * float(np.sqrt(np.square(attack.w).mean()))
        change = size * np.random.default_rng(0).uniform(-1, 1, (NUDGED, *attack.w.shape))
        # Of a change and its opposite, one breaks a tie the other way.
        w = attack.w + np.concatenate([0 * change[:1], change, -change])
        played = play(self.scene, w, attack.breaks, attack.steps)
        gains = np.sqrt(played.cost.sum(axis=0) / np.square(played.w).sum(axis=(1, 2)))
        candidates = self.topology.network.candidates
        low, high = (1 / (1 - end(candidates, axis=0)) for end in (np.nanmin, np.nanmax))
        theta, rests = played.theta[:, 0], played.x[:-1, 0] == 0
        inside = (theta >= low * (1 - SAME)) & (theta <= high * (1 + SAME))
        return bool((np.abs(gains - attack.gain) <= STEADY * attack.gain).all()), bool((inside | rests).all())

    def topology_of(self, attack: Attack) -> Topology:
        """Return the network under an attack, from x(0) = 0."""
        raw = yaml.safe_load(text_beside_table(self.topology, spelled_out=True))
        raw["steps"] = attack.steps
        for k, own in enumerate(raw["nodes"].values()):  # in the order of the file, which is that of every array
            value = attack.w[:, k]
            own["x0"] = 0.0
            own["disturbance"] = (
                [{"kind": "constant", "value": float(value[-1])}, *_impulses(value)]
                if attack.holds
                else {"kind": "samples", "values": value.tolist()}
            )
        graph, ids = self.scene.graph, self.topology.ids
        faults: list[FaultModel] = []
        for e, first in attack.breaks.cuts:
            i, j = graph.edges[e].tolist()
            faults.append(Cut(edge=(ids[i], ids[j]), steps=(first, attack.steps)))
        for k, first in attack.breaks.drops:
            faults.append(Drop(from_=ids[graph.neighbour[k]], to=ids[graph.node[k]], steps=(first, attack.steps)))
        raw["faults"] = [fault.written() for fault in faults]
        text = json.dumps(raw)
        return resolve(parse(text.encode(), "worst.yaml", Path()))

    def save(self, file: Path) -> None:
        """Write all that is needed to go on."""
        arrays: dict[str, Any] = {}
        listed = []
        for number, ((kind, breaks), (w, score, steps)) in enumerate(self.state.champions.items()):
            arrays[f"w{number}"] = w
            listed.append([*kind, list(breaks.cuts), list(breaks.drops), score, steps])
        for number, island in enumerate(self.state.islands):
            arrays |= {f"m{number}": island.members, f"s{number}": island.score, f"t{number}": island.steps}
        head = {
            "key": self._key,
            "champions": listed,
            "islands": [[*island.kind, island.generation] for island in self.state.islands],
            "stale": self.state.stale,
            "turns": self.state.turns,
            "seconds": self.state.seconds,
            "rng": self.rng.bit_generator.state,
        }
        part = beside(file)
        try:
            archive.write(part, {"worst": head}, arrays)
            part.rename(file)
        finally:
            part.unlink(missing_ok=True)

    def resume(self, file: Path) -> bool:
        """Continue a stopped search of the same network, law and options; return False for other options.

        Raises UserError for a file that `save` did not write, or that holds an attack on another network or law.
        """
        settings, arrays = archive.read(file)
        with archive.reading(file):
            if not isinstance(settings.get("worst"), dict):
                raise UserError(
                    f"{file}: exists and is no state of `worst`. Choose another --out.", code=Code.FILE_FORMAT
                )
            head = settings["worst"]
            there = str(head["key"])
            # A new search replaces the file: an attack on another network or law would be lost.
            if _attacked(there) != _attacked(self._key):
                raise UserError(
                    f"{file}: holds an attack on another network or law, {_attacked(there).partition(' ')[2]}."
                    " Choose another --out.",
                    code=Code.OUTPUT,
                )
            if there != self._key:
                return False
            self.state = self._state(head, arrays)
            self.rng.bit_generator.state = head["rng"]
        return True

    def _state(self, head: Mapping[str, Any], arrays: Mapping[str, Array]) -> State:
        """Return the state that a file holds. Raises ValueError if it does not fit this network."""
        nodes, state = len(self.topology.ids), State([], {})
        for number, (length, holds, cuts, drops, score, steps) in enumerate(head["champions"]):
            breaks = Breaks(*(tuple((int(k), int(first)) for k, first in one) for one in (cuts, drops)))
            w = _numbers(arrays[f"w{number}"], (None, nodes))
            state.champions[Kind(int(length), bool(holds)), breaks] = w, float(score), int(steps)
        for number, (_, holds, generation) in enumerate(head["islands"]):
            members = _numbers(arrays[f"m{number}"], (self.size, None, nodes))
            score, taken = arrays[f"s{number}"], arrays[f"t{number}"]
            shapes = {score.shape, taken.shape}
            if shapes not in ({(self.size,)}, {(0,)}) or not {score.dtype.kind, taken.dtype.kind} <= {"i", "f"}:
                raise ValueError("it has other arrays")
            state.islands.append(Island(bool(holds), members, NONE, score, taken, int(generation)))
        state.stale, state.seconds = [int(one) for one in head["stale"]], float(head["seconds"])
        state.turns = int(head["turns"])
        if len(state.stale) != len(state.islands) or not 0 <= state.seconds < np.inf:
            raise ValueError("it has other numbers")
        return state


def _attacked(key: str) -> str:
    """Return the network and the law of the key of a search, without its seed and options."""
    return key.rsplit(" ", 3)[0]


def _numbers(array: Array, shape: Sequence[int | None]) -> Array:
    """Return an array of finite numbers of a shape, of which None is any length from 1. Raises ValueError."""
    fits = array.ndim == len(shape) and all(
        have == want or (want is None and have > 0) for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits or array.dtype != np.float64 or not np.isfinite(array).all():
        raise ValueError("it has other arrays")
    return array


def _stretched(w: Array, kind: Kind) -> Array:
    """Return a disturbance with the number of values of a kind: the last is repeated, or some are left out."""
    return np.concatenate([w, np.repeat(w[-1:], kind.length, axis=0)])[: kind.length]


def _impulses(value: Array) -> list[dict[str, Any]]:
    """Return what a node's first values are more than its last one."""
    more = value[:-1] - value[-1]
    return [{"kind": "impulse", "at": t, "value": float(v)} for t, v in enumerate(more) if v]


def quiet(topology: Topology) -> Topology:
    """Return a network without its faults and its disturbance, from x(0) = 0."""
    nodes, edges = dict(topology.nodes), tuple(topology.edges)  # a large network has views of its table
    return topology.model_copy(update={"faults": (), "disturbance": None, "nodes": nodes, "edges": edges})
