"""An upper bound on the gain of the law (7) that counts what it learns, for small networks.

It is Theorem 3 of Rantzer (2021) for the product set of the models of a network, of which (7) chooses the one with the
least J: J is a sum over nodes. Let 0 be the truth, and A_0k = A_0 - B B' Theta_k with Theta = diag(1/(1 - a)). Find one
P_j per model j, and the least g, such that for all models j and k, and all (x, w),

    |A_0k x + w|^2_(P_j) - g (theta |w|^2 + (1 - theta) |w + (A_0 - A_j) x|^2) + |x|^2 + |B' Theta_k x|^2
        <= |x|^2_(P_k).

Rantzer has theta = 1/2, and pairs of any two models; pairs with the truth are enough, for one truth. With theta = 1 the
law learns nothing. docs/guarantee.md has the proof.
"""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass

import numpy as np

from hedgerow.orchestrator.metrics.gain_bound import MARGIN
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.semidefinite import Blocks, NoBoundError, Program, Unknowns
from hedgerow.topologies.graph import Array

MOST_MODELS = 16
"""Number of joint models up to which the bound is computed; the program has a matrix for every two of them."""
COARSE = (1.0, 0.9, 0.75, 0.5)
FINE = 3
"""Number of times that the step between two values of theta is halved around the best."""


@dataclass(frozen=True)
class Learning:
    """The bound, and its weight of the truth."""

    g: float
    theta: float
    models: int
    margin: float
    seconds: float

    @property
    def gain(self) -> float:
        """Return sqrt(g)."""
        return math.sqrt(self.g)


def learning(plant: PlantModel, candidates: Array, time_limit_s: float = 600.0) -> Learning:
    """Return the proved bound of a network under (7); raises NoBoundError.

    candidates: (M, n), NaN where a list has fewer. Every edge is open, no a jumps, and every message arrives.
    """
    began = time.monotonic()
    lists = [np.unique(column[~np.isnan(column)]) for column in candidates.T]
    count = math.prod(len(one) for one in lists)
    if count > MOST_MODELS:
        raise NoBoundError(f"the lists have {count} joint models, and the bound takes at most {MOST_MODELS}")
    models = np.array(list(itertools.product(*lists)))
    if not (models == plant.a).all(axis=1).any():
        raise NoBoundError("the true a of a node is not in its list")
    found: dict[float, tuple[float, float]] = {}

    def at(theta: float) -> float:
        if theta not in found:
            try:
                found[theta] = _bound(plant, models, theta, time_limit_s - (time.monotonic() - began))
            except NoBoundError:
                found[theta] = math.inf, 0.0
        return found[theta][0]

    best, step = min(COARSE, key=at), 0.125
    for _ in range(FINE):
        best = min((best, max(0.05, best - step), min(1.0, best + step)), key=at)
        step /= 2
    g, margin = found[best]
    if not math.isfinite(g):
        raise NoBoundError("the solver found no storage of this form that bounds the gain")
    return Learning(g, best, count, margin, time.monotonic() - began)


def _bound(plant: PlantModel, models: Array, theta: float, time_limit_s: float) -> tuple[float, float]:
    program = _program(plant, models, theta)
    margin = MARGIN
    for _ in range(3):
        y = program.solve(margin, time_limit_s)
        if program.proof(y, margin / 2) is not None:
            return float(y[0]), margin / 2
        margin = max(10 * margin, 1e-9 * float(np.abs(y).max()))
    raise NoBoundError("the solver's answer is not proved, even with a larger margin")


def _program(plant: PlantModel, models: Array, theta: float) -> Program:
    """Return the program: one block in (x, w) for every two models, and P of the truth at least 0."""
    n, count = plant.n, len(models)
    truth = int((models == plant.a).all(axis=1).argmax())
    B = plant.incidence()
    unknowns = Unknowns()
    upper = list(zip(*np.triu_indices(n), strict=True))
    P = [unknowns.new(len(upper), free=True) for _ in range(count)]
    blocks = Blocks(2 * n, count * count)
    eye = np.eye(n)
    for j, k in itertools.product(range(count), range(count)):
        number = np.array([j * count + k])
        gain = 1 / (1 - models[k])
        after = np.hstack([np.diag(plant.a) - (B @ B.T) * gain, eye])
        unlike = np.hstack([np.diag(plant.a - models[j]), eye])
        edge = np.hstack([B.T * gain, np.zeros((B.shape[1], n))])
        cost = edge.T @ edge
        cost[:n, :n] += eye
        noise = -(1 - theta) * unlike.T @ unlike
        noise[n:, n:] -= theta * eye
        _add(blocks, number, -1, cost)
        _add(blocks, number, 0, noise)
        for p_j, p_k, (r, s) in zip(P[j].tolist(), P[k].tolist(), upper, strict=True):
            twice = 1.0 if r == s else 2.0
            product = np.outer(after[r], after[s]) * twice
            _add(blocks, number, p_j, (product + product.T) / 2)
            blocks.entry(p_k, int(r), int(s), -twice, number)
    positive = Blocks(n, 1)
    for number, (r, s) in zip(P[truth].tolist(), upper, strict=True):
        positive.entry(number, int(r), int(s), -1.0 if r == s else -2.0)
    return unknowns.program([blocks, positive])


def _add(blocks: Blocks, number: Array, unknown: int, matrix: Array) -> None:
    """Add unknown * X' matrix X, of a symmetric matrix, to one block."""
    for i, j in zip(*np.nonzero(np.triu(matrix)), strict=True):
        blocks.entry(unknown, int(i), int(j), float(matrix[i, j] if i == j else 2 * matrix[i, j]), number)
