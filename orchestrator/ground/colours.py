"""The one palette of all figures, the live view and the pictures of the documentation."""

from __future__ import annotations

BLUE, ORANGE, GREEN, RED, SKY, PINK, BLACK = COLOURS = (
    *("#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7"),
    "#000000",
)
"""the colours of Okabe and Ito, in the order of hedgerow.mplstyle; without the yellow, which is too pale on white"""
GREY = "#777777"
ON_DARK = ("#3D9BE0", "#E69F00", "#12B886", "#F0701E", "#9BD8FF", "#E08FC0", "#EDEDED")
"""the same on a dark background: the dark ones are lighter, in the same order"""
