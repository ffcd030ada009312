"""Make docs/images/faults.png: node 3 of docs/examples/faulty.yaml, with and without its faults.

python docs/plot_faults.py [IMAGE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.ground.colours import RED
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.report.style import look
from hedgerow.orchestrator.runs.reference import run
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.message import End, Telemetry

HERE = Path(__file__).parent
NODE = 2  # the position of node 3
WINDOWS = {
    (0, 12): "drop\nmessages between 2 and 3 are lost",
    (22, 32): "cut\nnothing flows between 3 and 4",
    (42, 52): "crash\nagent 3 is absent",
}
NOTES = (
    (1, 6, 0.15, "no samples:\nthe first candidate stays"),
    (1, 13.5, 0.62, "back-filled: as\nwithout the fault"),
    (1, 27, 0.73, "this flow is known to be 0:\nno sample is lost"),
    (1, 47, 0.79, "no estimate"),
    (1, 52.2, 0.62, "as without\nthe fault"),
    (2, 14.6, 2.2, "a wrong estimate costs regret"),
    (2, 37, 0.35, "the oracle has the same edges closed: no regret"),
)
"""(panel, step, height, text)"""
FAULTY, WITHOUT, SHADE, NOTE = RED, "#555555", "#EAEAEA", "#333333"


def ran(*overrides: str) -> tuple[Observer, Batch]:
    """Return the run of the network in this process, with all of its metrics."""
    network = resolve(load(str(HERE / "examples/faulty.yaml"), overrides))
    shards = layout(network, None)
    *rows, end = run(truth_of(network, shards), views_of(network, shards))
    assert isinstance(end, End)
    observer = Observer(network)
    batch = observer.take([row for row in rows if isinstance(row, Telemetry)])
    observer.finish(end)
    return observer, batch


def draw(axes: np.ndarray[tuple[int], np.dtype[np.object_]], faulty: Batch, without: Batch) -> None:
    """Draw state, estimate and regret of the node, in three rows."""
    state, estimate, regret = axes
    for batch, colour, label, width in (
        (without, WITHOUT, "without faults", 1.2),
        (faulty, FAULTY, "with faults", 2.0),
    ):
        style = {"color": colour, "lw": width, "label": label, "ls": "--" if batch is without else "-"}
        state.plot(batch.t, batch.x[:, NODE], **style)
        estimate.step(batch.t, batch.ahat[:, NODE], where="post", **style)
        regret.plot(batch.t, batch.regret[:, NODE], **style)
    state.legend(loc="upper left", bbox_to_anchor=(0.54, 1.0), frameon=False)
    estimate.set_yticks([0.3, 0.6, 0.88], ["0.3", "0.6", "truth 0.88"])
    for panel, step, height, text in NOTES:
        where = "center" if step in (6, 27, 37, 47) else "left"
        axes[panel].text(step, height, text, ha=where, va="center", color=NOTE)
    for axis, title, highest in (
        (state, "state $x_3$", 7.4),
        (estimate, "estimate $\\hat a_3$", 1.05),
        (regret, "regret $|x_3 - x_3^*|$", 3.8),
    ):
        axis.set_ylabel(title)
        axis.set_ylim(0, highest)
        shade(axis)


def shade(axis: Axes) -> None:
    """Mark the steps of a fault."""
    for start, stop in WINDOWS:
        axis.axvspan(start, stop, color=SHADE, zorder=0, lw=0)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set_xlim(0, 60)


def main(image: Path) -> None:
    """Draw and write the picture."""
    observer, faulty = ran()
    lossless, without = ran("faults=[]")
    summary = f"regret D {observer.regret_sum:.4g} with faults, {lossless.regret_sum:.4g} without"
    with look():
        figure = Figure(figsize=(7.16, 5.2))
        axes = figure.subplots(3, 1, sharex=True)
        draw(axes, faulty, without)
        for (start, stop), text in WINDOWS.items():
            name, what = text.split("\n")
            middle = (start + stop) / 2
            axes[0].text(middle, 8.3, name, ha="center", va="bottom", fontsize=10, weight="bold")
            axes[0].text(middle, 7.6, what, ha="center", va="bottom")
        axes[-1].set_xlabel("step $t$")
        figure.savefig(image, dpi=180, metadata={"Description": summary, "Software": None})
    print(summary)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "images/faults.png")
