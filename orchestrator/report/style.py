"""One look for all figures; the same run gives the same files at any time and place."""

from __future__ import annotations

import contextlib
import io
import itertools
import shutil
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import matplotlib.style
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from hedgerow.orchestrator.ground.colours import COLOURS
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.regular_file import check_regular


def colour(place: int) -> str:
    """Return the colour of a run, by its place in a comparison."""
    return COLOURS[place % len(COLOURS)]


_MARKERS = "os^Dv<>"


def marker(place: int) -> str:
    """Return the marker of a run, by its place in a comparison."""
    return _MARKERS[place % len(_MARKERS)]


def ink() -> str:
    """Return the colour of text: black, or another one if the user's style has a dark background."""
    return str(matplotlib.rcParams["text.color"])


FORMATS = ("pdf", "png", "svg", "pgf")
NARROWEST_IN, WIDEST_IN = 2.0, 20.0


@dataclass(frozen=True)
class Look:
    """The width of all figures, the user's style on top of ours, and the formats of the files."""

    width_in: float | None = None
    """None for the width of the style, one column of a journal"""
    style: str | None = None
    """a .mplstyle file, or the name of a style of matplotlib"""
    formats: tuple[str, ...] = ("pdf", "png")

    def __post_init__(self) -> None:
        if self.width_in is not None and not NARROWEST_IN <= self.width_in <= WIDEST_IN:
            raise UserError(
                f"--width {self.width_in:g}: is not between {NARROWEST_IN:g} and {WIDEST_IN:g} in. Give inches, 3.5 for"
                " a column or 7.16 for a page.",
                code=Code.OPTION,
            )
        strange = [name for name in self.formats if name not in FORMATS]
        if strange or not self.formats:
            raise UserError(
                f"--format {','.join(strange)}: is not a format. Choose one of {', '.join(FORMATS)}.",
                code=Code.OPTION,
            )
        if "pgf" in self.formats and shutil.which(tex := str(matplotlib.rcParams["pgf.texsystem"])) is None:
            raise UserError(
                f"--format pgf: there is no {tex} here, which measures the text. Install LaTeX, or choose pdf.",
                code=Code.OPTION,
            )


@contextmanager
def look(asked: Look = Look()) -> Iterator[None]:
    """Draw with hedgerow.mplstyle and the requested look, independent of the user's own settings.

    Raise UserError if the user's style cannot be read. A sign without a glyph is left out.
    """
    ours = resources.files("hedgerow.orchestrator.report") / "hedgerow.mplstyle"
    with contextlib.ExitStack() as stack:
        path = stack.enter_context(resources.as_file(ours))
        stack.enter_context(matplotlib.style.context(str(path), after_reset=True))
        stack.enter_context(warnings.catch_warnings())
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        if asked.style is not None:
            _use(asked.style)
        if asked.width_in is not None:
            matplotlib.rcParams["figure.figsize"] = (asked.width_in, matplotlib.rcParams["figure.figsize"][1])
        yield


def _use(style: str) -> None:
    """Apply a user's style on top of ours; lines keep our line styles if the user's style has colours only."""
    ours = matplotlib.rcParams["axes.prop_cycle"].by_key()["linestyle"]
    try:
        if (path := user_path(style)).exists():
            check_regular(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # matplotlib only warns of an unknown key
            matplotlib.style.use(str(path) if path.exists() else style)
        cycle = matplotlib.rcParams["axes.prop_cycle"]
        if "linestyle" not in cycle.keys:
            rows = [one for _, one in zip(ours, itertools.cycle(cycle), strict=False)]
            keys = {key: [one[key] for one in rows] for key in cycle.keys}
            matplotlib.rcParams["axes.prop_cycle"] = cycler(**keys, linestyle=ours)
    except (OSError, UserWarning, ValueError, SyntaxError, KeyError) as error:
        raise UserError(
            f"--style {style}: cannot be used: {error}. Give a .mplstyle file or the name of a style of matplotlib.",
            code=Code.OPTION,
        ) from None


def width_in() -> float:
    """Return the width of the figures [in]."""
    return float(matplotlib.rcParams["figure.figsize"][0])


PAGE_IN = 7.16
"""the width of a page with two columns"""
COLUMN_IN = 3.5
"""the width of the figures in hedgerow.mplstyle"""


def sheet(height_in: float, otherwise_in: float | None = None) -> Figure:
    """Return an empty figure of the width of the look; of `otherwise_in` if the user asks for no width."""
    asked = width_in()
    return Figure(figsize=(otherwise_in if otherwise_in and asked == COLUMN_IN else asked, height_in))


def label_panels(axes: Iterable[Axes]) -> None:
    """Put the letters (a), (b), … above the upper left corners of panels, as journals ask for."""
    for place, axis in enumerate(axes):
        axis.set_title(f"({ascii_lowercase[place % len(ascii_lowercase)]})")


def save(figure: Figure, folder: Path, name: str, title: str, formats: Sequence[str] = ("pdf", "png")) -> None:
    """Write NAME in each format; no file contains the time of its creation."""
    _keep_layout(figure)
    _write(figure, folder, name, title, formats)


def save_and_embed(figure: Figure, folder: Path, name: str, title: str, formats: Sequence[str]) -> bytes:
    """Write NAME in each format as `save` does, and return the figure as SVG, for a page."""
    _keep_layout(figure)
    drawn = _svg(figure)
    if "svg" in formats:
        (folder / f"{name}.svg").write_bytes(drawn)
    _write(figure, folder, name, title, [one for one in formats if one != "svg"])
    return drawn


def _keep_layout(figure: Figure) -> None:
    """Compute the layout once: all formats have the same."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def _write(figure: Figure, folder: Path, name: str, title: str, formats: Sequence[str]) -> None:
    # Do not use savefig, which draws everything one more time to measure it.
    if "pdf" in formats:
        pdf: Any = FigureCanvasPdf(figure)
        pdf.print_pdf(folder / f"{name}.pdf", metadata={"Title": title, "CreationDate": None, "Producer": None})
    if "pgf" in formats:
        (folder / f"{name}.pgf").write_text(_pgf(figure), encoding="utf-8")
    if "svg" in formats:
        (folder / f"{name}.svg").write_bytes(_svg(figure))
    if "png" in formats:  # the last one, because it changes the resolution of the figure
        figure.dpi = matplotlib.rcParams["savefig.dpi"]
        png: Any = FigureCanvasAgg(figure)
        png.print_png(folder / f"{name}.png", metadata={"Title": title, "Software": None})


def _svg(figure: Figure) -> bytes:
    drawn = io.BytesIO()
    svg: Any = FigureCanvasSVG(figure)
    svg.print_svg(drawn, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    return drawn.getvalue()


def _pgf(figure: Figure) -> str:
    """Return a figure as PGF. Raise UserError if LaTeX cannot measure the text."""
    from matplotlib.backends.backend_pgf import FigureCanvasPgf, LatexError  # noqa: PLC0415 (it looks for LaTeX)

    drawn = io.StringIO()
    pgf: Any = FigureCanvasPgf(figure)
    try:
        pgf.print_pgf(drawn)
    except (LatexError, ValueError) as error:
        reason = next((line for line in str(error).splitlines() if line.startswith("!")), str(error)[:200])
        raise UserError(
            f"--format pgf: LaTeX cannot measure a text: {reason}. Install the packages fontspec, pgf and underscore of"
            " LaTeX, or choose pdf.",
            code=Code.OPTION,
        ) from None
    # A comment names the folder of the fonts on this computer: without it, the file is the same everywhere.
    return "".join(line for line in drawn.getvalue().splitlines(keepends=True) if "Path=" not in line)
