"""The colours of the live view: one per node in every panel, one per kind of fault, and scales for magnitudes."""

from __future__ import annotations

import colorsys

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.ground.colours import ON_DARK

Color = tuple[int, int, int, int]
Packed = NDArray[np.uint32]

BACKGROUND: Color = (17, 20, 26, 255)
"""the background of the picture: objects in this colour are invisible"""
TEXT: Color = (190, 196, 206, 255)
GREY: Color = (170, 170, 170, 255)

RIGHT: Color = (66, 74, 90, 255)
"""the ring of a node with the right model"""
WRONG: Color = (255, 64, 200, 255)
NO_INPUT: Color = (64, 160, 255, 255)
DEAD: Color = (255, 48, 48, 255)
LOST: Color = (255, 150, 0, 255)
CUT: Color = DEAD
BOTH: Color = (255, 100, 30, 255)

_STATES = np.array([[46, 62, 118], [40, 110, 142], [34, 160, 134], [122, 209, 81], [253, 231, 37]], dtype=float)
_FLOWS = np.array([[58, 66, 80], [120, 134, 156], [226, 234, 246]], dtype=float)


def of_hex(code: str, alpha: int = 255) -> Color:
    """Return the colour of a code #RRGGBB."""
    r, g, b = bytes.fromhex(code.removeprefix("#"))
    return r, g, b, alpha


BLUE, ORANGE, _, VERMILLION = (of_hex(code) for code in ON_DARK[:4])


def hues(count: int, alpha: int = 255) -> list[Color]:
    """Return one colour per node, by its place in the file: those of the figures, and then a golden section of the
    circle from the last.
    """
    first = [of_hex(code, alpha) for code in ON_DARK[:count]]
    rgb = (colorsys.hsv_to_rgb(0.55 + k * 0.6180339887 % 1, 0.6, 0.95) for k in range(len(first), count))
    return [*first, *((int(255 * r), int(255 * g), int(255 * b), alpha) for r, g, b in rgb)]


def packed(color: Color) -> np.uint32:
    """Return a colour in Rerun's form, 0xRRGGBBAA."""
    r, g, b, a = color
    return np.uint32(r << 24 | g << 16 | b << 8 | a)


def state_colors(part: NDArray[np.float64]) -> Packed:
    """Return the fill of a node, from blue to yellow, for |x| as a part of the maximum."""
    return _between(_STATES, part)


def flow_colors(part: NDArray[np.float64]) -> Packed:
    """Return the colour of an edge, from grey to white, for the flow k_ij |u_j - u_i| as a part of the maximum."""
    return _between(_FLOWS, part)


def thickness(weights: NDArray[np.float64] | None, count: int) -> NDArray[np.float64]:
    """Return the width of each of `count` edges by its weight, as a part of the widest: from 0.3 to 1, by the square
    root.
    """
    if weights is None or not count:
        return np.ones(count)
    return np.asarray(np.maximum(0.3, np.sqrt(weights / weights.max())))


def _between(stops: NDArray[np.float64], part: NDArray[np.float64]) -> Packed:
    place = np.linspace(0, 1, len(stops))
    r, g, b = (np.interp(part, place, stops[:, k]).astype(np.uint32) for k in range(3))
    return np.asarray(r << 24 | g << 16 | b << 8 | 255, dtype=np.uint32)
