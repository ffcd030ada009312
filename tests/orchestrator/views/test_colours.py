"""One palette: the live view, the figures and their style sheet have the same colours in the same order."""

from __future__ import annotations

import re
from importlib import resources

import pytest

from hedgerow.orchestrator.ground.colours import COLOURS, ON_DARK
from hedgerow.orchestrator.views.palette import hues, of_hex
from hedgerow.orchestrator.views.rerun.panels import _free_corner
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve


def test_the_style_sheet_has_the_palette_twice() -> None:
    style = (resources.files("hedgerow.orchestrator.report") / "hedgerow.mplstyle").read_text(encoding="utf-8")
    (cycle,) = re.findall(r'cycler\("color", \[(.*?)\]\)', style)
    assert re.findall(r'"(\w{6})"', cycle) == 2 * [code.removeprefix("#") for code in COLOURS]


@pytest.mark.parametrize("count", [0, 3, 7, 8, 60])
def test_nodes_have_the_colours_of_the_figures_and_then_others(count: int) -> None:
    colors = hues(count)
    assert colors[:7] == [of_hex(code) for code in ON_DARK[:count]]
    assert len(set(colors)) == count


@pytest.mark.parametrize(("steps", "x0", "corner"), [(30, 15, "LeftTop"), (600, 15, "RightTop"), (30, 0, "RightTop")])
def test_the_legend_of_the_gain_is_in_the_free_corner(steps: int, x0: float, corner: str) -> None:
    topology = resolve(load("paper7", [f"steps={steps}", f"defaults.x0={x0}"]))
    assert _free_corner(topology, topology.network.gamma_star_now) == corner
