"""Upper bounds on the gain of the adaptive law: semidefinite programs by clarabel, each answer proved by a Cholesky.

Let alpha_low_i = 1/(1 - lowest candidate), alpha_high_i = 1/(1 - highest) and z_i = x_i/(1 - ahat_i). With the
incidence matrix N, B is diag(b) N diag(sqrt k), and phi are the edge inputs. Find p, tau, nu, s >= 0 and the least g
with, for all (x, z, w, phi, v),

    sum p_i (x_i+)^2 - sum p_i x_i^2 + |x|^2 + |phi|^2 - g |w|^2
        + sum tau_i (z_i - alpha_low_i x_i)(alpha_high_i x_i - z_i)
        + sum nu_e phi_e ((B'z)_e - phi_e) + sum s_i (v_i - lowest_i x_i)(highest_i x_i - v_i) <= 0.

The premise decides x+: docs/guarantee.md has the derivation.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.gain_uniform import uniform
from hedgerow.orchestrator.metrics.semidefinite import Blocks, Form, NoBoundError, Program, Unknowns
from hedgerow.topologies.graph import Array, Index

MARGIN, LARGE_MARGIN = 1e-8, 1e-7
"""The form is at most -MARGIN |(x, z, w, phi, v)|^2, where the cost of x has the coefficient 1; of LARGE nodes more."""
LARGE = 100
WHOLE_LARGEST = 150
"""Size of the matrix up to which `whole` is chosen; it takes a second."""
ATTEMPTS = 4
"""The maximum number of tries, each with a larger margin, until an answer is proved."""
FULL_LARGEST = 30
"""Number of nodes up to which a full P is sought."""
HUB = 40
"""Largest degree of a node that the split program takes."""


class Premise(StrEnum):
    """The assumption of a bound, from the strongest to the weakest."""

    ESTIMATES = "estimates"
    """any estimates within the lists; every edge is open; x+ = A x - B B'z + w"""
    EDGES = "edges"
    """any edges closed at any steps as well; x+ = A x - B phi + w"""
    JUMPS = "jumps"
    """any a within its list at any step as well; x+ = v - B phi + w"""

    @property
    def needs_truth(self) -> bool:
        """Return True if a bound holds for one given a only, and False if it holds for any a(t) within the lists."""
        return self != Premise.JUMPS


class Method(StrEnum):
    """The program that a bound solves."""

    WHOLE = "whole"
    """one matrix of all nodes, diagonal P"""
    SPLIT = "split"
    """one small matrix per node; equal to `whole` on forests, and not less anywhere"""
    UNIFORM = "uniform"
    """one multiplier for all edges, in closed form; for networks of any size, and not less than `whole`"""
    FULL = "full"
    """one matrix of all nodes, full P"""


SPLIT_LARGEST = {Premise.ESTIMATES: 1000, Premise.EDGES: 300, Premise.JUMPS: 300}
"""Number of nodes up to which `split` is chosen. Beyond, `uniform` gives the same, except without closed edges."""


@dataclass(frozen=True)
class Bound:
    """An upper bound on the gain that holds in floating point: gain <= sqrt(g)."""

    premise: Premise
    method: Method
    g: float
    p: Array = field(repr=False)
    """the storage sum p_i x_i^2, (n,); of a full P x'Px, (n, n)"""
    margin: float
    """the form is at most -margin |(x, z, w, phi, v)|^2"""
    magnitude: float
    """of the largest coefficients of the form: a relative error r of its numbers changes it by r times this at most"""
    seconds: float

    @property
    def gain(self) -> float:
        """Return sqrt(g)."""
        return math.sqrt(self.g)

    def storage(self, x: Array) -> Array:
        """Return the storage of B states, (B,)."""
        return np.asarray(x * x @ self.p if self.p.ndim == 1 else ((x @ self.p) * x).sum(axis=-1))


def method_for(plant: PlantModel, premise: Premise) -> Method:
    """Return the program that gives the least bound in about a second."""
    if 3 * plant.n + len(plant.edges) <= WHOLE_LARGEST and _has_cycle(plant):
        return Method.WHOLE
    hub = int(np.bincount(plant.edges.ravel(), minlength=1).max()) > HUB
    return Method.UNIFORM if hub or plant.n > SPLIT_LARGEST[premise] else Method.SPLIT


def _has_cycle(plant: PlantModel) -> bool:
    parent = list(range(plant.n))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for i, j in plant.edges.tolist():
        one, other = root(i), root(j)
        if one == other:
            return True
        parent[one] = other
    return False


def bound(plant: PlantModel, premise: Premise, method: Method | None = None, time_limit_s: float = 600.0) -> Bound:
    """Return the proved bound of a network under a premise, or raise NoBoundError.

    Without a method, `method_for` chooses.
    """
    until = time.monotonic() + time_limit_s
    if not _permitted(plant, premise):
        raise NoBoundError("the true a of a node is outside its list")
    if method is not None:
        return _bound(plant, premise, method, until)
    method = method_for(plant, premise)
    try:
        return _bound(plant, premise, method, until)
    except NoBoundError:
        if method == Method.UNIFORM:
            raise
    # The solver may fail where numbers are large, and the closed forms may not.
    return _bound(plant, premise, Method.UNIFORM, until)


def _permitted(plant: PlantModel, premise: Premise) -> bool:
    """Return True if the truth is within the lists, which the premise `jumps` needs."""
    return premise != Premise.JUMPS or bool(((plant.lowest <= plant.a) & (plant.a <= plant.highest)).all())


def _bound(plant: PlantModel, premise: Premise, method: Method, until: float) -> Bound:
    began = time.monotonic()
    margin = MARGIN if plant.n <= LARGE else LARGE_MARGIN
    if method == Method.UNIFORM:
        # With every edge open nothing less is known in this form.
        g, storage, magnitude = uniform(plant, premise == Premise.JUMPS, margin / 2, until)
        return Bound(premise, method, g, storage, margin / 2, magnitude, time.monotonic() - began)
    if method == Method.FULL and plant.n > FULL_LARGEST:
        raise NoBoundError(f"a full P is sought for up to {FULL_LARGEST} nodes, and there are {plant.n}")
    if method == Method.SPLIT:
        program, p = _split(plant, premise)
    else:
        program, p = _whole(plant, premise, full=method == Method.FULL)
    for _ in range(ATTEMPTS):
        y = program.solve(margin, until - time.monotonic())
        # The solver needs half of the margin, and the other half is proved.
        if (magnitude_ := program.proof(y, margin / 2)) is not None:
            storage = y[p]
            if method == Method.FULL:
                storage = _symmetric(storage, plant.n)
            return Bound(premise, method, float(y[0]), storage, margin / 2, magnitude_, time.monotonic() - began)
        # The solver's residual is relative to its largest unknown.
        margin = max(10 * margin, 1e-9 * float(np.abs(y).max()))
    raise NoBoundError("the solver's answer is not proved, even with a larger margin")


def _symmetric(upper: Array, n: int) -> Array:
    matrix = np.zeros((n, n))
    i, j = np.triu_indices(n)
    matrix[i, j] = matrix[j, i] = upper
    return matrix


def _whole(plant: PlantModel, premise: Premise, full: bool) -> tuple[Program, Index]:
    """Return the program with one matrix, and the unknowns of P."""
    n, e = plant.n, len(plant.edges)
    edges = premise != Premise.ESTIMATES
    jumps = premise == Premise.JUMPS
    alpha_low, alpha_high = 1 / (1 - plant.lowest), 1 / (1 - plant.highest)
    fixed, unmoved = alpha_low == alpha_high, ~np.asarray(plant.lowest < plant.highest) | (not jumps)
    # Of a node with one candidate z = alpha_low x, and of one that cannot jump v = a x: no variables.
    m = 2 * n
    place_z = np.where(fixed, -1, m + np.cumsum(~fixed) - 1)
    m += int((~fixed).sum())
    place_v = np.where(unmoved, -1, m + np.cumsum(~unmoved) - 1)
    m += int((~unmoved).sum())
    place_phi = m + np.arange(e)
    m += e * edges
    blocks, unknowns = Blocks(m, 1), Unknowns()
    x = [Form((i,), (1.0,)) for i in range(n)]
    w = [Form((n + i,), (1.0,)) for i in range(n)]
    z = [Form((i,), (float(alpha_low[i]),)) if fixed[i] else Form((int(place_z[i]),), (1.0,)) for i in range(n)]
    phi: list[Form] = []
    gap: list[Form] = []
    incident: list[list[tuple[float, Form]]] = [[] for _ in range(n)]
    for k, (i, j) in enumerate(plant.edges.tolist()):
        bi, bj = float(plant.b[i] * plant.root_weights[k]), float(-plant.b[j] * plant.root_weights[k])
        drop = _sum((bi, z[i]), (bj, z[j]))
        phi.append(Form((int(place_phi[k]),), (1.0,)) if edges else drop)
        gap.append(_sum((1.0, drop), (-1.0, phi[-1])))
        incident[i].append((-bi, phi[-1]))
        incident[j].append((-bj, phi[-1]))
    after = []
    for i in range(n):
        own = (float(plant.a[i]), x[i]) if unmoved[i] else (1.0, Form((int(place_v[i]),), (1.0,)))
        after.append(_sum(own, *incident[i], (1.0, w[i])))
    pairs = [(i, j) for i in range(n) for j in range(i, n)] if full else [(i, i) for i in range(n)]
    p = unknowns.new(len(pairs), free=full)
    for number, (i, j) in zip(p.tolist(), pairs, strict=True):
        twice = 1.0 if i == j else 2.0
        blocks.add(number, after[i], after[j], twice)
        blocks.add(number, x[i], x[j], -twice)
    tau, s, nu = unknowns.new(n), unknowns.new(n * jumps), unknowns.new(e * edges)
    for i in range(n):
        blocks.add(-1, x[i], x[i])
        blocks.add(0, w[i], w[i], -1.0)
        if not fixed[i]:
            blocks.sector(int(tau[i]), z[i], x[i], float(alpha_low[i]), float(alpha_high[i]))
        if not unmoved[i]:
            v = Form((int(place_v[i]),), (1.0,))
            blocks.sector(int(s[i]), v, x[i], float(plant.lowest[i]), float(plant.highest[i]))
    for k in range(e):
        blocks.add(-1, phi[k], phi[k])
        if edges:
            blocks.add(int(nu[k]), phi[k], gap[k])
    every = [blocks]
    if full:
        # P >= 0: the storage at the end of a run must not be negative.
        positive = Blocks(n, 1)
        for number, (i, j) in zip(p.tolist(), pairs, strict=True):
            positive.entry(number, i, j, -1.0 if i == j else -2.0)
        every.append(positive)
    return unknowns.program(every), p


def _sum(*parts: tuple[float, Form]) -> Form:
    """Return the sum of scaled forms, with each variable once."""
    total: dict[int, float] = {}
    for scale, form in parts:
        for index, coefficient in zip(*form, strict=True):
            total[index] = total.get(index, 0.0) + scale * coefficient
    return Form(tuple(total), tuple(total.values()))


def _split(plant: PlantModel, premise: Premise) -> tuple[Program, Index]:
    """Return the program with one matrix per node, over (x, z, w, v) of the node and phi of its edges.

    The two ends of an edge share phi_e only: `share` divides its square between them. If every edge is open, phi_e is
    (B'z)_e, so nu may have either sign, and so may sigma, the multiplier of (phi_e - (B'z)_e)(B_ie z_i - B_je z_j).
    """
    n, e = plant.n, len(plant.edges)
    edges, jumps = premise != Premise.ESTIMATES, premise == Premise.JUMPS
    alpha_low, alpha_high = 1 / (1 - plant.lowest), 1 / (1 - plant.highest)
    fixed, unmoved = alpha_low == alpha_high, ~np.asarray(plant.lowest < plant.highest) | (not jumps)
    ends, edge = plant.edges.T.ravel(), np.tile(np.arange(e), 2)
    order = np.argsort(ends, kind="stable")
    degree = np.bincount(ends, minlength=n)
    first = np.concatenate([[0], np.cumsum(degree)])
    if degree.max(initial=0) > HUB:
        raise NoBoundError(f"a node has {degree.max()} edges, and the split program takes {HUB}")
    unknowns = Unknowns()
    p, tau, s = unknowns.new(n), unknowns.new(n), unknowns.new(n * jumps)
    nu, share = unknowns.new(e, free=not edges), unknowns.new(e, free=True)
    sigma = unknowns.new(e * (not edges), free=True)
    sign = np.repeat([1.0, -1.0], e)
    every = []
    for kind in np.unique(np.stack([degree, fixed, unmoved]), axis=1).T:
        d, is_fixed, is_unmoved = int(kind[0]), bool(kind[1]), bool(kind[2])
        nodes = np.flatnonzero((degree == d) & (fixed == is_fixed) & (unmoved == is_unmoved))
        has_z, has_v = not is_fixed, not is_unmoved
        blocks = Blocks(2 + has_z + has_v + d, len(nodes))
        x, w = Form((0,), (1.0,)), Form((1,), (1.0,))
        low, high = alpha_low[nodes], alpha_high[nodes]
        z = Form((2,), (1.0,)) if has_z else Form((0,), (low,))
        v = Form((2 + has_z,), (1.0,)) if has_v else Form((0,), (plant.a[nodes],))
        after_index, after_value = [*v.at, 1], [*v.coefficient, 1.0]
        for k in range(d):
            end = order[first[nodes] + k]
            own, phi = edge[end], Form((2 + has_z + has_v + k,), (1.0,))
            gain = sign[end] * plant.b[nodes] * plant.root_weights[own]
            after_index.append(phi.at[0])
            after_value.append(-gain)
            # Half of (1 - nu) phi^2 is this end's, and `share` moves some of it from one end to the other.
            blocks.add(-1, phi, phi, 0.5)
            blocks.add(nu[own], phi, phi, -0.5)
            blocks.add(share[own], phi, phi, sign[end])
            blocks.add(nu[own], phi, z, gain)
            if not edges:
                blocks.add(sigma[own], phi, z, sign[end] * gain)
                blocks.add(sigma[own], z, z, -sign[end] * gain * gain)
        after = Form(tuple(after_index), tuple(after_value))
        blocks.add(p[nodes], after, after)
        blocks.add(p[nodes], x, x, -1.0)
        blocks.add(-1, x, x)
        blocks.add(0, w, w, -1.0)
        if has_z:
            blocks.sector(tau[nodes], z, x, low, high)
        if has_v:
            blocks.sector(s[nodes], v, x, plant.lowest[nodes], plant.highest[nodes])
        every.append(blocks)
    return unknowns.program(every), p
