"""The report of a run, or of several runs beside each other: figures for a paper, and one page with all numbers."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hedgerow.topologies.errors import Code, UserError

if TYPE_CHECKING:
    from hedgerow.orchestrator.report.figures import Kind
    from hedgerow.orchestrator.runs.run import Run

PAGE = "report.html"
RUNS = 7
"""the maximum number of runs with distinct colours"""


def report(
    runs: Sequence[Run],
    out: Path | None = None,
    figures: str | None = None,
    force: bool = False,
    *,
    width_in: float | None = None,
    style: str | None = None,
    formats: Sequence[str] = ("pdf", "png"),
) -> list[Path]:
    """Write report.html and each figure into the folder `out`, and return the files.

    `figures` picks some, as in "2,4,gain". `width_in` is the width of a figure [in], by default one column. `style` is
    a .mplstyle file, or the name of a style of matplotlib, on top of ours. `formats` are of pdf, png, svg and pgf. The
    folder is complete or absent, and the same runs give the same bytes. Raise UserError for a mistake, without
    matplotlib, and if nothing can be written.
    """
    if not 1 <= len(runs) <= RUNS:
        raise UserError(f"{len(runs)} runs: a report is of 1 to {RUNS}", code=Code.OPTION)
    for run in runs:
        run.need_all("a report")
    try:
        from hedgerow.orchestrator.report import figures as known  # noqa: PLC0415
        from hedgerow.orchestrator.report.page import page  # noqa: PLC0415
        from hedgerow.orchestrator.report.style import FORMATS, Look, look, save_and_embed  # noqa: PLC0415
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        raise UserError(
            "a report needs matplotlib. Install it with: pip install matplotlib", code=Code.DEPENDENCY
        ) from None
    asked = Look(width_in, style, tuple(formats))
    kinds = _chosen(known.FIGURES, figures, runs)
    out = out or Path("-".join(run.name for run in runs[:2]) + "-report")
    _refuse(out, force, {PAGE, *(f"{kind.file}.{suffix}" for kind in known.FIGURES for suffix in FORMATS)})
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".report-", dir=out.parent) as scratch:
            whole = Path(scratch) / "report"
            whole.mkdir()
            with look(asked):
                drawn = {
                    kind: save_and_embed(kind.draw(runs), whole, kind.file, kind.title, asked.formats) for kind in kinds
                }
            (whole / PAGE).write_text(page(runs, drawn), encoding="utf-8", errors="backslashreplace")
            if out.is_dir():
                out.rename(Path(scratch) / "old")
            whole.rename(out)
    except OSError as error:
        raise UserError(
            f"{out}: cannot be written: {error.strerror}; --out names another folder", code=Code.OUTPUT
        ) from None
    return [out / PAGE, *(out / f"{kind.file}.{suffix}" for kind in kinds for suffix in asked.formats)]


def _chosen(known: Sequence[Kind], figures: str | None, runs: Sequence[Run]) -> list[Kind]:
    """Return the requested figures in the order of the report; without a request, all figures with content."""
    if figures is None:
        return [kind for kind in known if kind.has(runs) and not kind.on_request]
    asked = [key.strip() for key in figures.split(",")]
    there = [kind.key for kind in known]
    for key in asked:
        if key not in there:
            raise UserError(
                f"--figures {figures}: there is no figure {key or 'without a name'}; choose of {', '.join(there)}",
                code=Code.OPTION,
            )
    chosen = [kind for kind in known if kind.key in asked]
    for kind in chosen:
        if not kind.has(runs):
            what = " and ".join(run.name for run in runs)
            raise UserError(
                f"--figures {figures}: there is nothing to show of {kind.key} in {what}; leave it out", code=Code.OPTION
            )
    return chosen


def _refuse(out: Path, force: bool, own: set[str]) -> None:
    """Raise UserError if a report may not be written to `out`."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: is a file; --out names a folder", code=Code.OUTPUT)
    there = {path.name for path in out.iterdir()} if out.exists() else set()
    if strange := sorted(there - own):
        raise UserError(
            f"{out}: holds {strange[0]}, which is of no report; --out names another folder", code=Code.OUTPUT
        )
    if there and not force:
        raise UserError(f"{out}: already exists; --force replaces it, --out names another folder", code=Code.OUTPUT)
