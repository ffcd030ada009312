"""Make the pictures and the numbers of docs/gallery.md: python docs/make_gallery.py FOLDER [PACKAGE ...]

It needs the extras `water` and `power`, and the package topohub, which contain the networks. PACKAGE restricts it to
the networks of some packages.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import hedgerow as hg
from hedgerow.orchestrator.report.curves import draw_nodes, steps_axis
from hedgerow.orchestrator.report.style import PAGE_IN, look
from hedgerow.orchestrator.views.drawing import draw
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.written import import_file


class Shown(NamedTuple):
    """A network of the gallery: its file, and its import options."""

    name: str
    package: str
    file: str
    options: Options


NETWORKS = (
    Shown("net3", "wntr", "library/networks/Net3.inp", Options(junction_storage=5000.0)),
    Shown("nobel-eu", "topohub", "data/sndlib/nobel-eu.json", Options(steps=300)),
    Shown("case118", "pandapower", "networks/power_system_test_case_jsons/case118.json", Options(steps=300)),
)


def main(folder: Path, packages: Sequence[str]) -> None:
    """Import and run each network, draw it, and print a line of numbers."""
    warnings.simplefilter("ignore")
    print(f"{'network':9} nodes edges steps  gamma*  gain  right  peak |x| at")
    for shown in NETWORKS:
        if packages and shown.package not in packages:
            continue
        spec = importlib.util.find_spec(shown.package)
        if spec is None or spec.origin is None:
            sys.exit(f"{shown.package} is not installed")
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / "network.yaml"
            import_file(Path(spec.origin).parent / shown.file, shown.options).save(path)
            run = hg.simulate(path, run_dir=Path(scratch) / "run")
            show(shown, run, folder)


def show(shown: Shown, run: hg.Run, folder: Path) -> None:
    """Draw a run beside its network, and print its numbers."""
    with look():
        figure = Figure(figsize=(PAGE_IN, 3.1))
        left, right = figure.subplots(1, 2, width_ratios=[1.6, 1])
        draw(run.topology, left)
        figure.legend(*draw_nodes(right, run, np.abs(run.x)), loc="outside upper right", ncols=3)
        right.set_ylabel("$|x_i(t)|$ [units of $x$]")
        right.set_ylim(bottom=0)
        steps_axis(right, [run])
        figure.savefig(folder / f"gallery-{shown.name}.png", dpi=180)
    t, k = np.unravel_index(np.abs(run.x).argmax(), run.x.shape)
    cost = (run.x[:-1] ** 2).sum() + (run.weights * run.u_edge**2).sum()
    w = run.w
    gain = np.sqrt(cost / (w**2).sum())
    right_ = float((run.ahat[-1] == run.a[-1]).mean())
    name = run.topology.network.title(int(k))
    print(
        f"{shown.name:9} {len(run.ids):5d} {len(run.edges):5d} {run.T:5d} {run.gamma_star:7.3f} {gain:5.3f}"
        f"  {right_:4.2f}  {abs(run.x[t, k]):.3g} at step {t}, node {name}"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
