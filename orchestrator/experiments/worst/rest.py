"""Constant disturbances with large settled gains, found by rest states: a start for the search, without a run.

Under a constant w and with fixed estimates, the state tends to x = (I - A + B B' Theta)^-1 w, with Theta = diag(1/(1 -
ahat)). The estimates can stay there if each is the candidate nearest a + w/x, the least-squares estimate of many steps.
One w may have several such rest states. From x(0) = 0 the estimates begin large, and fall while x grows. So without
other disturbances, a run reaches the rest state that follows from the largest candidates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hedgerow.orchestrator.experiments.worst.loop import Scene, product
from hedgerow.topologies.graph import Array, Mask

SIZE, FEW = 160, 24
"""Least size of a population, and the number of nodes up to which it costs little."""
LARGEST, GENERATIONS, FLOPS = 100, 80, 10**6
"""Number of nodes up to which rest states are solved, and of generations: 3 + FLOPS / n^3 for large networks."""
DISTANCES = 1e-3, 0.1
"""The largest gains are where another candidate is nearly as near, and there a run takes many steps to settle. So each
member keeps a distance from such places, relative to the difference of the two candidates."""
ITERATIONS = 12
"""Number of changes of the estimates after which a disturbance has no rest state."""
LEAD = 3
"""Number of steps that lead a run to a rest state."""


class Rest(NamedTuple):
    """Rest states under constants, (K, n) each."""

    w: Array
    ahat: Array
    x: Array


def resting(scene: Scene, count: int, rng: np.random.Generator, steered: bool) -> Rest:
    """Return up to `count` constants with large settled gains and their rest states, the largest gain first.

    Only with `steered` are the estimates other than those that a run from x(0) = 0 reaches under the constant alone.
    A network of more than LARGEST nodes has none.
    """
    n, candidates = len(scene.a), scene.view.candidates
    if n > LARGEST or not count:
        return Rest(*np.empty((3, 0, n)))
    wanted, count = count, max(count, SIZE if n <= FEW else 0)
    lengths = (~np.isnan(candidates)).sum(axis=0)
    highest = np.broadcast_to(np.nanmax(candidates, axis=0), (count, n))
    distances = np.geomspace(*DISTANCES, count)

    def drawn() -> Array:
        # Padding is last in a column.
        return np.asarray(candidates[(rng.random((count, n)) * lengths).astype(np.int64), np.arange(n)])

    w = np.abs(rng.standard_normal((count, n)))
    w[0] = scene.worst_of_oracle
    w[1::2] *= rng.random((len(w[1::2]), n)) < 0.5
    first = drawn() if steered else highest
    gains, x, ahat = _judged(scene, w, first, distances)
    for generation in range(min(GENERATIONS, 3 + FLOPS // n**3)):
        best = int(gains.argmax())
        size = np.sqrt(np.square(w).sum(axis=1, keepdims=True))
        copies = rng.random((count, 1)) < 0.3
        base = np.where(copies, w[best], w)
        match generation % 3:
            case 0:
                along = _climbed(scene, x, ahat)
                with np.errstate(invalid="ignore", divide="ignore"):
                    along *= size / np.sqrt(np.square(along).sum(axis=1, keepdims=True))
                share = rng.choice([1.0, 0.5, 0.2, 0.05], (count, 1))
                trials = np.where(np.isfinite(along), (1 - share) * w + share * along, w)
            case 1:
                scale = 10 ** rng.uniform(-4, -0.3, (count, 1)) * np.sqrt(np.square(base).mean(axis=1, keepdims=True))
                few = rng.random((count, n)) < rng.choice([0.15, 0.5, 1.0], (count, 1))
                trials = base + scale * few * rng.standard_normal((count, n))
            case _:
                weight = rng.uniform(0.3, 0.9, (count, 1))
                one, two = rng.permutation(count), rng.permutation(count)
                trials = base + weight * (w[one] - w[two])
        start = highest
        if steered:
            start = np.where(copies, ahat[best], ahat)
            turned = rng.random((count, n)) < rng.choice([0.0, 1 / n, 0.5], (count, 1))
            start = np.where(turned, drawn(), start)
        found, at, chosen = _judged(scene, trials, start, distances)
        better = found > gains
        w[better], gains[better], x[better], ahat[better] = trials[better], found[better], at[better], chosen[better]
    order = np.argsort(-gains, kind="stable")
    order = order[gains[order] > 0]
    # From the whole range of distances: those with the largest gains settle last.
    order = order[np.unique(np.linspace(0, max(0, len(order) - 1), min(wanted, len(order)), dtype=np.int64))]
    return Rest(w[order], ahat[order], x[order])


def steered(scene: Scene, rest: Rest, rng: np.random.Generator) -> Array:
    """Return disturbances that lead a run from x(0) = 0 to rest states and hold there, (K, LEAD + 1, n).

    w(0) is the state s x. Then w(1) = (ahat - a) x(1) makes the estimate ahat look exact, and it leads the others by a
    score that grows with s.
    """
    count, n = rest.w.shape
    scale = rng.choice([0.3, 1.0, 2.0, 5.0], (count, 1))
    w = np.empty((count, LEAD + 1, n))
    w[:, 0] = scale * rest.x
    w[:, 1] = (rest.ahat - scene.a) * w[:, 0]
    w[:, 2:] = rest.w[:, None]
    return w


def _judged(scene: Scene, w: Array, start: Array, distances: Array) -> tuple[Array, Array, Array]:
    """Return the settled gains squared, (B,), 0 without a rest state; x and the estimates, (B, n)."""
    x, ahat, stays = _rest(scene, w, start, distances)
    z = x / (1 - ahat)
    energy = np.square(w).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        gains = (np.square(x).sum(axis=1) + (z * _coupled(scene, z)).sum(axis=1)) / energy
    return np.where(stays & np.isfinite(gains), gains, 0.0), x, ahat


def _climbed(scene: Scene, x: Array, ahat: Array) -> Array:
    """Return a step of the power method, w <- M'(I + Theta B B' Theta) M w, where M w = x."""
    theta = 1 / (1 - ahat)
    return _solved(scene, theta, x + theta * _coupled(scene, theta * x), transposed=True)


def _coupled(scene: Scene, z: Array) -> Array:
    """Return B B' z of B vectors z, (B, n)."""
    b = np.asarray(scene.b, dtype=float)
    return np.asarray(b * product(scene.laplacian(frozenset()), b * z))


def _solved(scene: Scene, theta: Array, right: Array, transposed: bool = False) -> Array:
    """Return y of (I - A + B B' Theta) y = right, or of the transposed equation, for B right sides, (B, n)."""
    n = len(scene.a)
    gains = np.broadcast_to(np.asarray(scene.b, dtype=float), n)
    coupling = scene.laplacian(frozenset()) * np.outer(gains, gains)
    matrices = np.eye(n) * (1 - scene.a) + coupling * theta[:, None, :]
    if transposed:
        matrices = matrices.swapaxes(1, 2)
    return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0])


def _rest(scene: Scene, w: Array, start: Array, distances: Array) -> tuple[Array, Array, Mask]:
    """Return the states and the estimates that follow from `start`, (B, n), and True where the estimates stay."""
    candidates, ahat = scene.view.candidates, start.copy()
    x, stays, moving = np.empty_like(w), np.zeros(len(w), dtype=bool), np.arange(len(w))
    for _ in range(ITERATIONS):
        x[moving] = _solved(scene, 1 / (1 - ahat[moving]), w[moving])
        residuals = np.abs((candidates - scene.a) * x[moving, None] - w[moving, None])
        best = np.nanargmin(residuals, axis=1)[:, None]
        chosen = np.take_along_axis(np.broadcast_to(candidates, residuals.shape), best, axis=1)[:, 0]
        same = (chosen == ahat[moving]).all(axis=1)
        more = residuals - np.take_along_axis(residuals, best, axis=1)
        apart = np.abs((candidates - chosen[:, None]) * x[moving, None])
        near = (more < distances[moving, None, None] * apart).any(axis=(1, 2))
        stays[moving[same & ~near]] = True
        ahat[moving] = chosen
        moving = moving[~same]
        if not len(moving):
            break
    return x, ahat, stays
