"""A picture of |x| for all nodes and steps, with a fixed size for any network."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.observer import Batch

ROWS, COLUMNS = 200, 400


class HeatMap:
    """A heat map: one row for some nodes, one column for some steps, and in each cell the largest |x|.

    The columns become wider during the run.
    """

    def __init__(self, nodes: int) -> None:
        self._nodes = nodes
        self._starts = np.unique(np.linspace(0, nodes, min(nodes, ROWS), endpoint=False).astype(np.int64))
        self._cells = np.zeros((len(self._starts), COLUMNS), dtype=np.float16)
        self._steps = 1
        """the number of steps per column"""
        self._last = 0
        self.step = 0
        """the last recorded step"""

    def take(self, batch: Batch) -> None:
        """Record the next steps."""
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
        """Return the picture so far, (rows, columns)."""
        return self._cells[:, : self._last + 1].copy()

    @property
    def axes(self) -> tuple[str, str]:
        """Return the titles of the rows and of the columns."""
        nodes = -(-self._nodes // len(self._starts))
        return (
            "nodes" if nodes == 1 else f"nodes, {nodes} a row",
            "steps" if self._steps == 1 else f"steps, {self._steps} a column",
        )
