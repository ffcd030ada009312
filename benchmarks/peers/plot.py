"""The medians of the suite as one picture: the speed of each loop relative to the reference loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from hedgerow.orchestrator.ground.colours import BLUE, COLOURS, GREY
from hedgerow.orchestrator.report.style import look, sheet

ROW_IN = 0.19
MARKS = "os^Dvp"


def draw(ratios: Mapping[str, Mapping[int, float]], ours: Sequence[str], beside: str, file: Path) -> None:
    """Draw ratios by title and number of nodes, one line per title, those in `ours` in blue; an .svg or .png file."""
    sizes = sorted({n for own in ratios.values() for n in own})
    with look():
        figure = sheet(0.6 + ROW_IN * len(ratios))
        axes = figure.add_subplot()
        axes.axvline(1.0, color=GREY, linewidth=0.8)
        places = range(len(ratios), 0, -1)
        for place, (title, own) in zip(places, ratios.items(), strict=True):
            colour = BLUE if title in ours else COLOURS[1]
            axes.plot(sorted(own.values()), [place] * len(own), color=colour, linestyle="-", linewidth=0.8)
            for n, ratio in own.items():
                axes.plot(ratio, place, MARKS[sizes.index(n) % len(MARKS)], color=colour, markersize=3.5)
        for n in sizes:
            mark = MARKS[sizes.index(n) % len(MARKS)]
            axes.plot([], [], mark, color=GREY, markersize=3.5, label=f"{n} nodes")
        axes.set_xscale("log")
        every = [ratio for own in ratios.values() for ratio in own.values()]
        axes.set_xlim(min([*every, 1.0]) / 1.5, max([*every, 1.0]) * 1.5)
        ticks = [step * 10.0**power for power in range(-3, 5) for step in (1, 3)]
        axes.xaxis.set_major_locator(FixedLocator(ticks))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        axes.set_yticks(list(places), list(ratios))
        axes.set_ylim(0.4, len(ratios) + 0.6)
        axes.grid(axis="x")
        axes.set_xlabel(f"steps/s, relative to {beside}")
        figure.legend(loc="outside upper center", ncols=len(sizes))
        metadata = dict.fromkeys(("Date", "Creator")) if file.suffix == ".svg" else {"Software": None}
        figure.savefig(file, metadata=metadata)
