"""A law that raises in a search for the worst disturbance is named with its line: no crash of ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.loading import LawError
from hedgerow.orchestrator.experiments.worst.loop import Scene, play
from hedgerow.topologies.named import resolved


class FailsWhenFar(Minimax):
    """Raises for a state that the contract test does not reach."""

    def act(self, x: Array) -> Array:
        if (abs(x) > 50).any():
            raise SystemExit(0)
        return super().act(x)


def test_a_law_that_fails_in_a_search_is_named() -> None:
    scene = Scene.of(resolved("paper7", [f"law={__name__}:FailsWhenFar"]))
    with pytest.raises(LawError) as failed:
        play(scene, np.full((2, 30, 7), 50.0))
    assert failed.value.method == "act"
    assert f"{Path(__file__).name}:" in str(failed.value)
