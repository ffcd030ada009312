"""The certificate of the adaptive law: sum cost <= g sum |w|^2 + sum p_i x_i(0)^2 - sum p_i x_i(t+1)^2 at every step.

There is one per premise of `gain_bound`. All of them start at t = 0. Each is claimed while its premise has held: no
edge closed so far, no jump so far, every u within the sector of its node's list. None begins later. The bounds are
solved beside the run: rows that come before them wait here.

Rounding. With phi and z = -u/b of the recorded u, the state obeys x(t+1) = A x - B phi + w + e, and the inequality
holds with w + e for w. Let eps = (max n_i + 4) delta, with n_i the number of edges at node i and delta the unit
roundoff; then |e| <= eps (|x| + |phi| + |w|), since |B| < 1. So g |w + e|^2 exceeds g |w|^2 by at most 5 g eps (|x|^2
+ |phi|^2 + |w|^2). z may lie outside its sector by SECTOR relative to it. The margin of the bound covers both if it is
at least (5 eps + 2 SECTOR) times the bound's magnitude, and g is not more than the magnitude. The rounding of the sums
remains. Each sum has one term per step, of n + E squares, so its error is at most (t + n + E + 8) delta times itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hedgerow.orchestrator.metrics.checks import TINY, Worst
from hedgerow.orchestrator.metrics.gain_bound import Bound, Premise
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.guarantee import Guarantee
from hedgerow.orchestrator.metrics.semidefinite import UNIT
from hedgerow.topologies.graph import Array, Index, Mask

SECTOR = 16 * UNIT
"""A blend of a few inputs, each within the sector, may leave it by so much, relative to the largest."""
WAITING_BYTES = 2**26
"""The maximum memory of the rows that wait for the bounds; later rows are not checked before the bounds are known."""
CLAIMS = {
    Premise.ESTIMATES: "sum cost <= g sum |w|^2 + sum p_i x_i(0)^2 - sum p_i x_i(t+1)^2 at every step before the first"
    " with a closed edge, a jump of a, or a u outside the sector of its list",
    Premise.EDGES: "the same, with the g and p of any closed edges, before the first step with a jump of a, or with a u"
    " outside the sector of its list",
    Premise.JUMPS: "the same, with the g and p of any a within its list, before the first step with an a or a u"
    " outside its list",
}


class _Rows(NamedTuple):
    """Some consecutive steps: their numbers, x(t + 1), the sums up to t, and how many of them each premise covers."""

    t: Index
    after: Array
    cost: Array
    energy: Array
    covered: dict[Premise, int]


@dataclass
class Track:
    """One premise in a run."""

    ended: int | None = None
    """the first step that is not covered; None if all were so far"""
    why: str = ""
    check: Worst = field(default_factory=Worst)
    slack: float = np.nan
    """at the last step that was checked"""


class GainCertificate:
    """Checks the certificates of one run."""

    def __init__(self, plant: PlantModel, x0: Array) -> None:
        self._plant, self._x0 = plant, x0
        e = len(plant.edges)
        degree = int(np.bincount(plant.edges.ravel(), minlength=plant.n).max(initial=0))
        self._margin_needed = 5 * (degree + 4) * UNIT + 2 * SECTOR
        """relative to the magnitude of a bound"""
        self._terms = plant.n + e + 8
        self.tracks = {premise: Track() for premise in Premise}
        self.known: Guarantee | None = None
        """the bounds, once they are solved; another thread may assign them"""
        self._waiting: list[_Rows] = []
        self._late: list[tuple[Index, Array, Array]] = []
        """the claims at steps that waited"""
        self._bytes = 0
        self._next = 0
        self.left_out = 0
        """steps that were not checked, because too many waited for the bounds"""

    def take(
        self, t: Index, x: Array, u: Array, after: Array, is_open: Mask, a: Mapping[int, Array], sums: Array
    ) -> tuple[Array, Array]:
        """Record B steps; return the claimed bound on the gain at each, and its slack, (B,), NaN without a claim.

        x, u and x(t + 1) are (B, n). `is_open` is True where every edge is open. `a` gives, by row, the new truth.
        sums, (B, 2), are of the cost and of |w|^2 up to each step.
        """
        premises = self._premises(t, x, u, is_open, a)
        rows = _Rows(t, after, sums[:, 0], sums[:, 1], premises)
        known = self.known
        if known is None:
            if any(premises.values()):
                self._wait(rows)
            return np.full(len(t), np.nan), np.full(len(t), np.nan)
        self._catch_up(known)
        return self._claim(known, rows)

    def _claim(self, known: Guarantee, rows: _Rows) -> tuple[Array, Array]:
        """Return the claimed bound on the gain at each of some steps, and its slack, (B,)."""
        ceiling, slack = np.full(len(rows.t), np.nan), np.full(len(rows.t), np.nan)
        # The strongest premise last: where it holds, its bound is the least.
        for premise in reversed(Premise):
            if (bound := known.bounds.get(premise)) is not None and (count := rows.covered[premise]):
                slack[:count] = self._check(premise, bound, rows)
                ceiling[:count] = bound.gain
        return ceiling, slack

    def finish(self) -> None:
        """Check the rows that still wait."""
        if self.known is not None:
            with np.errstate(over="ignore", invalid="ignore"):  # as in the observer
                self._catch_up(self.known)

    def _premises(self, t: Index, x: Array, u: Array, is_open: Mask, a: Mapping[int, Array]) -> dict[Premise, int]:
        """Return how many of the rows each premise covers, from the first on."""
        count = len(t)
        lost = t != self._next + np.arange(count)
        if lost.any():
            self._end(Premise, self._next + int(lost.argmax()), "telemetry is lost")
        self._next = int(t[-1]) + 1
        if all(track.ended is not None for track in self.tracks.values()):
            return dict.fromkeys(Premise, 0)
        # In the operations of `agents.law.control`, which round alike: an estimate of the list is never outside.
        low, high = (self._plant.b * x / (ends - 1.0) for ends in (self._plant.lowest, self._plant.highest))
        # A missing input is NaN: its edges are closed, so any z in the sector may replace it.
        outside = (u - low) * (u - high) > SECTOR * high * high
        if outside.any():
            row = int(outside.any(axis=1).argmax())
            self._end(Premise, int(t[row]), f"u of node number {int(outside[row].argmax())} is outside its sector")
        if a:
            row = min(a)
            self._end((Premise.ESTIMATES, Premise.EDGES), int(t[row]), "an a jumps")
            for row, now in a.items():
                if not ((self._plant.lowest <= now) & (now <= self._plant.highest)).all():
                    self._end((Premise.JUMPS,), int(t[row]), "an a is outside its list")
        if not is_open.all():
            self._end((Premise.ESTIMATES,), int(t[is_open.argmin()]), "an edge is closed")
        first = int(t[0])
        return {
            premise: count if track.ended is None else max(0, min(count, track.ended - first))
            for premise, track in self.tracks.items()
        }

    def _end(self, premises: Any, step: int, why: str) -> None:
        for premise in premises:
            track = self.tracks[premise]
            if track.ended is None or step < track.ended:
                track.ended, track.why = step, why

    def _wait(self, rows: _Rows) -> None:
        size = rows.after.nbytes
        if self._bytes + size > WAITING_BYTES:
            self.left_out += len(rows.t)
            return
        self._bytes += size
        self._waiting.append(rows)

    def _catch_up(self, known: Guarantee) -> None:
        waiting, self._waiting = self._waiting, []
        for rows in waiting:
            self._late.append((rows.t, *self._claim(known, rows)))

    def late_claims(self) -> tuple[Index, Array, Array]:
        """Return the steps that came before the bounds, the claimed bound at each, and its slack, (K,) each."""
        steps, ceiling, slack = (
            (np.concatenate(parts) for parts in zip(*self._late, strict=True))
            if self._late
            else (np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
        )
        return steps, ceiling, slack

    def _check(self, premise: Premise, bound: Bound, rows: _Rows) -> Array:
        """Return the slack at the rows that the premise covers."""
        track, count = self.tracks[premise], rows.covered[premise]
        if not self.covers_rounding(bound):
            return np.full(count, np.nan)
        # Row by row: the bits must not depend on how the rows were batched.
        end = (rows.after[:count] ** 2 * bound.p).sum(axis=1)
        given = bound.g * rows.energy[:count] + (self._x0**2 * bound.p).sum()
        slack = np.asarray(given - end - rows.cost[:count])
        scale = given + end + rows.cost[:count] + TINY
        track.check.see(-slack / scale - (rows.t[:count] + self._terms) * UNIT, rows.t[:count])
        track.slack = float(slack[-1])
        return slack

    def covers_rounding(self, bound: Bound) -> bool:
        """Return True if the margin of a bound covers the rounding errors of a step."""
        return bound.margin >= self._margin_needed * bound.magnitude

    def to_dict(self, n_steps: int) -> dict[str, Any]:
        """Return the bounds, and how far each premise held in `n_steps` steps, as verdict.json holds them."""
        if self.known is None:
            return {"not_computed": "the bounds were not solved in time"}
        content = self.known.to_dict()
        for premise, entry in content["bounds"].items():
            track = self.tracks[premise]
            entry |= {
                "held": track.ended is None,
                "steps": n_steps if track.ended is None else min(track.ended, n_steps),
                "ended_by": track.why or None,
                "slack": track.slack if np.isfinite(track.slack) else None,
            }
        content["steps_not_checked"] = self.left_out
        return content
