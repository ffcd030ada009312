"""|x| of all nodes at all steps in one picture of a fixed size, however many there are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.observer import Batch

ROWS, COLUMNS = 200, 400


class HeatMap:
    """A row some nodes, a column some steps, a cell the largest |x| among them; columns widen as the run goes on."""

    def __init__(self, nodes: int) -> None:
        self._nodes = nodes
        self._starts = np.unique(np.linspace(0, nodes, min(nodes, ROWS), endpoint=False).astype(np.int64))
        self._cells = np.zeros((len(self._starts), COLUMNS), dtype=np.float16)
        self._steps = 1
        """in a column"""
        self._last = 0
        self.step = 0
        """the last that was taken in"""

    def take(self, batch: Batch) -> None:
        """Take in the next steps."""
        most = np.maximum.reduceat(np.abs(batch.x), self._starts, axis=1).T
        while batch.t[-1] >= COLUMNS * self._steps:
            joined = np.maximum(self._cells[:, ::2], self._cells[:, 1::2])
            self._cells = np.concatenate([joined, np.zeros_like(joined)], axis=1)
            self._steps *= 2
        column = batch.t // self._steps
        first = np.concatenate([[0], np.flatnonzero(np.diff(column)) + 1])
        at = column[first]
        largest = np.maximum.reduceat(most, first, axis=1)
        self._cells[:, at] = np.maximum(self._cells[:, at], np.minimum(largest, 6e4))
        self._last, self.step = int(at[-1]), int(batch.t[-1])

    @property
    def image(self) -> NDArray[np.float16]:
        """(rows, columns) so far."""
        return self._cells[:, : self._last + 1].copy()

    @property
    def axes(self) -> tuple[str, str]:
        """What a row is, and what a column."""
        nodes = -(-self._nodes // len(self._starts))
        return (
            "nodes" if nodes == 1 else f"nodes, {nodes} a row",
            "steps" if self._steps == 1 else f"steps, {self._steps} a column",
        )
