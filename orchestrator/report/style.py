"""One look for all figures, and files that are the same whenever, and wherever, the same run is drawn."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import matplotlib.style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, SKY, PINK, BLACK = COLOURS = (
    *("#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7"),
    "#000000",
)
"""Okabe and Ito's, in the order of hedgerow.mplstyle"""
GREY = "#777777"
WIDTH_IN = 3.5


def colour(place: int) -> str:
    """The colour of a run, by its place in a comparison."""
    return COLOURS[place % len(COLOURS)]


@contextmanager
def look() -> Iterator[None]:
    """Draw by hedgerow.mplstyle alone, whatever the user's own settings are; a sign without a glyph is no matter."""
    sheet = resources.files("hedgerow.orchestrator.report") / "hedgerow.mplstyle"
    with (
        resources.as_file(sheet) as path,
        matplotlib.style.context(str(path), after_reset=True),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield


def sheet(height_in: float) -> Figure:
    """An empty figure, as wide as a column."""
    return Figure(figsize=(WIDTH_IN, height_in))


def save(figure: Figure, folder: Path, name: str, title: str) -> bytes:
    """Write NAME.pdf and NAME.png, and return the same as SVG; no file says when it was made."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # what has been laid out stays, in all three
    # Not by savefig, which draws everything once more each time, to see how large it is.
    pdf: Any = FigureCanvasPdf(figure)
    pdf.print_pdf(folder / f"{name}.pdf", metadata={"Title": title, "CreationDate": None, "Producer": None})
    drawn = io.BytesIO()
    svg: Any = FigureCanvasSVG(figure)
    svg.print_svg(drawn, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    figure.dpi = matplotlib.rcParams["savefig.dpi"]
    png: Any = FigureCanvasAgg(figure)
    png.print_png(folder / f"{name}.png", metadata={"Title": title, "Software": None})
    return drawn.getvalue()
