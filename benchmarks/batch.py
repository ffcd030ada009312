"""A sweep beside plain numpy: the same metrics of many seeds of paper7, in one process, as a ratio of times.

    python -m benchmarks.batch [SEEDS]

The plain script is typical code of a researcher for this one network: no files, no checks, no verdict, and random
numbers of numpy's generator. The rounds of both alternate; the figure is the median ratio, with the minimum and the
maximum.
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.runs import batch
from hedgerow.topologies.load import load

Array = NDArray[np.float64]
ROUNDS = 5
N, M, T, B = 7, 5, 30, 0.1
EDGES = np.array([(0, 1), (1, 2), (1, 3), (2, 4), (3, 5), (3, 6)])


def plain(seeds: int) -> dict[str, Array]:
    """Run paper7 with the law, the oracle and the nominal controller, and return the metrics of every run, (S,)."""
    rng = np.random.default_rng(1)
    L = np.zeros((N, N))
    for i, j in EDGES:
        L[[i, j, i, j], [i, j, j, i]] += [1, 1, -1, -1]
    s = np.sqrt(1 - 8 * B * B * np.diag(L))
    lists = (1 - s) / 2 + s * rng.random((M, seeds, N))
    a = np.take_along_axis(lists, rng.integers(0, M, (1, seeds, N)), axis=0)[0]
    amplitude, omega, phase = (high * rng.random((seeds, N)) for high in (1.0, np.pi, 2 * np.pi))
    x = x_oracle = x_nominal = np.full((seeds, N), 15.0)
    v0 = (x * x / (1 - a)).sum(axis=1)
    J = np.zeros((M, seeds, N))
    D, D_nominal, C, C_oracle, energy = np.zeros((5, seeds))

    def cost(x: Array, u: Array) -> Array:
        edge = u[:, EDGES[:, 0]] - u[:, EDGES[:, 1]]
        return np.asarray((x * x).sum(axis=1) + (edge * edge).sum(axis=1))

    for t in range(T):
        ahat = np.take_along_axis(lists, J.argmin(axis=0)[None], axis=0)[0]
        u, u_oracle, u_nominal = B * x / (ahat - 1), B * x_oracle / (a - 1), B * x_nominal / (0.5 - 1)
        w = amplitude * np.sin(omega * t + phase)
        D += ((x - x_oracle) ** 2).sum(axis=1)
        D_nominal += ((x_nominal - x_oracle) ** 2).sum(axis=1)
        C += cost(x, u)
        C_oracle += cost(x_oracle, u_oracle)
        energy += (w * w).sum(axis=1)
        flow = u @ L
        after = a * x + B * flow + w
        J += (lists * x + B * flow - after) ** 2
        x = after
        x_oracle = a * x_oracle + B * (u_oracle @ L) + w
        x_nominal = a * x_nominal + B * (u_nominal @ L) + w
    D += ((x - x_oracle) ** 2).sum(axis=1)
    D_nominal += ((x_nominal - x_oracle) ** 2).sum(axis=1)
    Q = B * B * L + np.einsum("si,ij->sij", (1 - a) ** 2, np.eye(N))
    return {
        "regret": D,
        "regret_nominal": D_nominal,
        "cost": C,
        "cost_oracle": C_oracle,
        "cost_regret": C - C_oracle,
        "cost_ratio": C / C_oracle,
        "disturbance_energy": energy,
        "gain": np.sqrt(C / energy),
        "gain_less_x0": np.sqrt(np.maximum(0, C - v0) / energy),
        "gamma_star": np.linalg.eigvalsh(Q)[:, 0] ** -0.5,
        "rho": np.maximum(a, lists.max(axis=0) - a).max(axis=1),
        "nodes_right": (ahat == a).sum(axis=1),
    }


def ours(seeds: int) -> int:
    """Run the same with the batch engine and all checks, and return the number of runs that pass them."""
    topology = load("paper7")
    size = batch.seeds_at_once(topology)
    good = 0
    for first in range(0, seeds, size):
        good += int(batch.run(topology, range(first, min(seeds, first + size))).good.sum())
    return good


def main() -> None:
    """Time both in turn and print the ratio."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    plain(100)
    ours(100)
    ratios, times = [], []
    for _ in range(ROUNDS):
        began = time.process_time()
        plain(seeds)
        between = time.process_time()
        assert ours(seeds) == seeds
        ended = time.process_time()
        ratios.append((between - began) / (ended - between))
        times.append(ended - between)
    print(f"{seeds} seeds of paper7, {T} steps, one process: {statistics.median(times):.2f} s of CPU")
    print(f"plain numpy / ours: {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


if __name__ == "__main__":
    main()
