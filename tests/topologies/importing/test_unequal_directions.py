"""A directed source with weights that differ by direction: the note counts these edges."""

from __future__ import annotations

import numpy as np
import pytest

import hedgerow as hg


@pytest.mark.parametrize(("back", "unlike"), [(1.0, False), (3.0, True)])
def test_a_note_counts_the_edges_with_two_unequal_weights(back: float, unlike: bool) -> None:
    net = hg.from_adjacency(np.array([[0, 1, 0], [back, 0, 1], [0, 1, 0]], float))
    assert any("unequal" in note for note in net.notes) == unlike
