"""Disturbances of a comparison: names, those of a file, and both joined."""

from __future__ import annotations

import pytest

from hedgerow.orchestrator.experiments.compare.plan import comparison, disturbances_of
from hedgerow.topologies.errors import Code, TopologyError, UserError


@pytest.mark.parametrize(
    ("text", "members"),
    [
        ("white", 1),
        ("white+ar1", 2),
        ("{kind: impulse, at: 20, value: 3}", 1),
        ("white+{kind: impulse, at: 20, value: 3}", 2),
        ("{kind: impulse, at: 20, value: 1e+1} + white", 2),
        ("[{kind: white, std: 0.1}, {kind: constant, value: 1}]", 2),
    ],
)
def test_names_and_disturbances_of_a_file_are_joined_by_plus(text: str, members: int) -> None:
    (own,) = disturbances_of(text)
    plan = comparison("paper7", ["minimax"], [own], range(1))
    network = plan.settings[0].topology.model_copy(update={"seed": 0})
    disturbance = network.defaults.disturbance
    assert (len(disturbance) if isinstance(disturbance, tuple | list) else 1) == members


@pytest.mark.parametrize("text", ["noise", "white+", "+", "white+noise", "white+{kind: noise}", "white+[1]", "white+{"])
def test_an_unknown_disturbance_is_refused(text: str) -> None:
    with pytest.raises(UserError) as refused:
        comparison("paper7", ["minimax"], disturbances_of(text), range(1))
    assert refused.value.code in (Code.OPTION, Code.TOPOLOGY, Code.FILE_FORMAT)
    if isinstance(refused.value, TopologyError):
        assert {one.origin for one in refused.value.problems} == {f"--disturbances {text}"}
