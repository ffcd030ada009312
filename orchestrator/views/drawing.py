"""A picture of a network for notebooks and pages, drawn by matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hedgerow.orchestrator.ground.colours import BLUE
from hedgerow.orchestrator.views.layout import placed
from hedgerow.topologies.schema import Topology

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAMED = 60
"""the maximum number of nodes for a picture with names by default"""


def draw(topology: Topology, ax: Axes | None = None, labels: bool | None = None) -> Axes:
    """Draw a resolved network into the axes, or into new ones, and return them.

    Nodes are at the positions in the file, or in a layout; the width of an edge grows with its weight.
    """
    from matplotlib import pyplot as plt  # noqa: PLC0415 (a third of a second)
    from matplotlib.collections import LineCollection  # noqa: PLC0415
    from matplotlib.patheffects import withStroke  # noqa: PLC0415

    if ax is None:
        _, ax = plt.subplots(figsize=(8, 6), layout="constrained")
    network = topology.network
    graph = network.graph
    places = placed(topology) * np.array([1.0, -1.0])  # y points down in a layout
    # Use the rank of the magnitude as width: conductances in one network differ by factors of a thousand.
    weights = np.ones(len(graph.edges)) if graph.weights is None else graph.weights
    low, high = (float(weights.min()), float(weights.max())) if len(weights) else (1.0, 1.0)
    share = np.log(weights / low) / np.log(high / low) if high > low else np.full(len(weights), 0.3)
    segments = [places[edge] for edge in graph.edges]
    ax.add_collection(LineCollection(segments, linewidths=0.6 + 3.4 * share, colors="0.6", zorder=1))
    size = float(np.clip(1000 / max(len(places), 1), 5, 90))
    ax.scatter(places[:, 0], places[:, 1], s=size, c=BLUE, edgecolors="white", linewidths=0.5, zorder=2, clip_on=False)
    halo = withStroke(linewidth=1.5, foreground="white")  # names cross edges
    if labels if labels is not None else len(places) <= NAMED:
        for k in range(len(places)):
            text = network.name(k).replace("$", r"\$")  # a `$` would start a formula
            ax.annotate(text, places[k], (4, 4), textcoords="offset points", fontsize=7, path_effects=[halo], zorder=3)
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.05)
    ax.set_axis_off()
    ax.autoscale_view()
    return ax
