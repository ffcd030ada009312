"""Figures of recorded runs, the curves in them, and the text of a page."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from numpy.typing import NDArray

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.report.figures import FIGURES
from hedgerow.orchestrator.report.style import look
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.schema import Topology

ROOT = Path(__file__).parents[2]


KINDS = {kind.key: kind for kind in FIGURES}


DRAWN = [kind for kind in FIGURES if kind.key != "faults" and not kind.on_request]
"""The figures of a run without faults."""


PAPERS = {"2": "x", "3": "x_oracle", "4": "regret", "5": "nominal_gap"}


def ran(topology: Topology, folder: Path) -> Run:
    """A run in this process, read back from its folder."""
    simulate_into(topology, create(topology, folder), layout(topology, 1), Watching(record=False), Quiet())
    return load_run(folder)


def drawn(key: str, *runs: Run) -> Figure:
    with look():
        figure = KINDS[key].draw(runs)
        figure.draw_without_rendering()
    return figure


def curves(axis: Axes) -> list[NDArray[np.float64]]:
    """The values of the lines with more than two points, each over 0, 1, 2, …"""
    lines = [line for line in axis.lines if len(line.get_ydata()) > 2]  # type: ignore[arg-type]
    for line in lines:
        np.testing.assert_array_equal(line.get_xdata(), np.arange(len(line.get_xdata())))  # type: ignore[arg-type]
    return [np.asarray(line.get_ydata()) for line in lines]


def steps(axis: Axes) -> list[NDArray[np.float64]]:
    """The values of the curves that hold until the next step."""
    return [np.asarray(patch.get_data()[0]) for patch in axis.patches if isinstance(patch, StepPatch)]


def names(figure: Figure) -> list[str]:
    return [text.get_text() for one in figure.legends for text in one.get_texts()]


class Page(HTMLParser):
    """A page for a reader: its elements are closed in order; its references, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    @property
    def links(self) -> list[str]:
        """Everything that a browser might fetch."""
        return [value or "" for _, own in self.elements for key, value in own.items() if key in ("src", "href")]

    def row(self, name: str) -> list[str]:
        """The cells behind the first cell of that name."""
        start = self.text.index(name) + 1
        return [cell for cell in self.text[start : self.text.index("\n", start)] if cell.strip()]


def page(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))
