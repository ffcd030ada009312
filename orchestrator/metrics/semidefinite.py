"""Semidefinite programs of many small matrices, solved by clarabel, and the proof of an answer in floating point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.graph import Array, Index

UNIT = float(np.finfo(float).eps) / 2
"""The largest relative error of one operation in floating point."""

LARGE = 400
"""Number of unknowns beyond which a program is solved less accurately."""


class NoBoundError(HedgerowError):
    """No bound was found; the text gives the reason."""


class Form(NamedTuple):
    """A linear form of each of c blocks: indices of variables, and coefficients that broadcast to (c,)."""

    at: tuple[int, ...]
    coefficient: tuple[Any, ...]


class Blocks:
    """Quadratic forms of c blocks of one size m, linear in the unknowns."""

    def __init__(self, m: int, count: int) -> None:
        self.m, self.count = m, count
        self._terms: list[tuple[NDArray[Any], ...]] = []
        self._all = np.arange(count)

    def add(self, unknown: Any, one: Form, other: Form, scale: Any = 1.0) -> None:
        """Add scale * unknown * one(X) * other(X) to every block; unknown -1 is the constant 1."""
        for i, ci in zip(*one, strict=True):
            for j, cj in zip(*other, strict=True):
                self.entry(unknown, i, j, scale * ci * cj)

    def sector(self, unknown: Any, z: Form, x: Form, low: Any, high: Any, scale: Any = 1.0) -> None:
        """Add scale * unknown * (z - low x)(high x - z) to every block."""
        self.add(unknown, z, z, -scale)
        self.add(unknown, z, x, scale * (low + high))
        self.add(unknown, x, x, -scale * low * high)

    def entry(self, unknown: Any, i: int, j: int, value: Any, blocks: Any = None) -> None:
        """Add value * unknown * X_i X_j to `blocks` (None: all)."""
        blocks = self._all if blocks is None else np.asarray(blocks)
        low, high = (i, j) if i <= j else (j, i)
        columns = [np.broadcast_to(np.asarray(each), blocks.shape) for each in (low, high, unknown, value)]
        self._terms.append((blocks, *columns))

    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Return block, i, j, unknown and value of every term; value * X_i X_j with i <= j."""
        if not self._terms:
            none = np.empty(0, dtype=np.int64)
            return none, none, none, none, np.empty(0)
        return tuple(np.concatenate(each) for each in zip(*self._terms, strict=True))

    def matrices(self, y: Array) -> tuple[Array, Array]:
        """Return the symmetric matrices at unknowns y, and the sums of the magnitudes of their terms, (c, m, m)."""
        block, i, j, unknown, value = self.arrays()
        terms = value * np.where(unknown < 0, 1.0, y[unknown])
        return tuple(self._dense(block, i, j, each) for each in (terms, np.abs(terms)))  # type: ignore[return-value]

    def _dense(self, block: Array, i: Array, j: Array, terms: Array) -> Array:
        m = self.m
        flat = np.bincount((block * m + i) * m + j, terms, self.count * m * m).reshape(self.count, m, m)
        return np.asarray((flat + flat.transpose(0, 2, 1)) / 2)


@dataclass
class Program:
    """Minimise g = y[0] subject to y >= 0 for some unknowns and every block at most -margin I."""

    unknowns: int
    free: Index
    """unknowns of either sign"""
    blocks: list[Blocks]

    def solve(self, margin: float, time_limit_s: float) -> Array:
        """Return the unknowns; raises NoBoundError.

        More accuracy than the margin needs takes twice the iterations in large programs.
        """
        import clarabel  # noqa: PLC0415 (only a bound needs it)

        signed = np.setdiff1d(np.arange(self.unknowns), self.free)
        parts = [(np.arange(len(signed)), signed, np.full(len(signed), -1.0))]
        rights = [np.zeros(len(signed))]
        cones: list[Any] = [clarabel.NonnegativeConeT(len(signed))]
        rows = len(signed)
        for blocks in self.blocks:
            m, size = blocks.m, blocks.m * (blocks.m + 1) // 2
            block, i, j, unknown, value = blocks.arrays()
            # S = -M - margin I; svec scales off-diagonal entries, which are half of the term, by sqrt(2).
            scaled = np.where(i == j, value, value / math.sqrt(2))
            row = block * size + j * (j + 1) // 2 + i
            known = unknown < 0
            right = np.zeros(blocks.count * size)
            diagonal = np.arange(m)
            right.reshape(blocks.count, size)[:, diagonal * (diagonal + 1) // 2 + diagonal] = -margin
            right -= np.bincount(row[known], scaled[known], len(right))
            parts.append((rows + row[~known], unknown[~known], scaled[~known]))
            rights.append(right)
            rows += len(right)
            cones += [clarabel.PSDTriangleConeT(m)] * blocks.count
        cost = np.zeros(self.unknowns)
        cost[0] = 1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.time_limit = time_limit_s
        settings.max_threads = 1
        # The default way to merge blocks, by a clique graph, panics or never ends for some sparse graphs of 25 nodes.
        settings.chordal_decomposition_merge_method = "parent_child"
        large = self.unknowns > LARGE
        settings.tol_gap_abs = settings.tol_gap_rel = 1e-5 if large else 1e-7
        settings.tol_feas = 1e-8 if large else 1e-10
        row, column, value = (np.concatenate(each) for each in zip(*parts, strict=True))
        matrix = _Columns.of(row, column, value, (rows, self.unknowns))
        none = np.empty(0, dtype=np.int64)
        nothing = _Columns.of(none, none, np.empty(0), (self.unknowns, self.unknowns))
        try:
            solution = clarabel.DefaultSolver(nothing, cost, matrix, np.concatenate(rights), cones, settings).solve()
        except BaseException as error:
            # Clarabel's decomposition of sparse blocks panics for some graphs. A panic is no Exception: it would end
            # the thread that computes the bound.
            if type(error).__name__ != "PanicException":
                raise
            raise NoBoundError("the solver failed on this network") from None
        y = np.array(solution.x)
        status = str(solution.status)
        if "Infeasible" in status:
            raise NoBoundError("the solver found no storage of this form that bounds the gain")
        if status == "MaxTime" or not np.isfinite(y).all():
            raise NoBoundError(f"the solver ended with {status} after {solution.solve_time:.0f} s")
        y[signed] = np.maximum(y[signed], 0.0)
        return y

    def proof(self, y: Array, margin: float) -> float | None:
        """Return the largest magnitude in a block if every block at y is at most -margin I, else None.

        A Cholesky factorisation proves each, rounding included. Assembling an entry of k terms errs by at most
        k u sum |terms|. A factorisation of an m by m matrix A that succeeds in floating point is exact for A + E with
        |E| <= (m + 1) u trace(A) / (1 - (m + 1) u). The magnitude is a sum of |terms| over a row.
        """
        largest = 0.0
        for blocks in self.blocks:
            matrix, magnitude = blocks.matrices(y)
            m = blocks.m
            terms = len(blocks.arrays()[0]) // blocks.count + 4
            trace = np.abs(np.einsum("kii->ki", matrix)).sum(axis=1)
            assembly = magnitude.sum(axis=2).max(axis=1)
            taken = margin + 2 * UNIT * ((m + 1) * trace + terms * assembly)
            try:
                np.linalg.cholesky(-matrix - taken[:, None, None] * np.eye(m))
            except np.linalg.LinAlgError:
                return None
            largest = max(largest, float(assembly.max()))
        return largest


@dataclass(frozen=True)
class _Columns:
    """A sparse matrix by columns, as the solver reads it; loading scipy.sparse takes longer than most programs."""

    data: Array
    indices: Index
    indptr: Index
    shape: tuple[int, int]
    has_canonical_format = has_sorted_indices = True

    @classmethod
    def of(cls, row: Index, column: Index, value: Array, shape: tuple[int, int]) -> _Columns:
        """Return the matrix of some entries; those of one place are added up."""
        place = column.astype(np.int64) * shape[0] + row.astype(np.int64)
        places, which = np.unique(place, return_inverse=True)
        starts = np.searchsorted(places, shape[0] * np.arange(shape[1] + 1))
        data = np.bincount(which, value, len(places)).astype(np.float64)
        return cls(data, places % max(1, shape[0]), starts, shape)


class Unknowns:
    """Numbers the unknowns; the first is g."""

    def __init__(self) -> None:
        self.count = 1
        self.free: list[Index] = []

    def new(self, count: int, free: bool = False) -> Index:
        """Return the numbers of `count` new unknowns."""
        numbers = np.arange(self.count, self.count + count)
        self.count += count
        if free:
            self.free.append(numbers)
        return numbers

    def program(self, blocks: Sequence[Blocks]) -> Program:
        """Return the program of some blocks."""
        free = np.concatenate(self.free) if self.free else np.empty(0, dtype=np.int64)
        return Program(self.count, free, list(blocks))
