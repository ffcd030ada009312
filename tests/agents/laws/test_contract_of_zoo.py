"""Every law of the project passes the contract test of every run."""

from __future__ import annotations

import pytest

import hedgerow as hg
from hedgerow.agents.laws import LAWS
from hedgerow.orchestrator.ground.laws import checked
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve


@pytest.mark.parametrize("law", LAWS)
def test_a_law_of_the_project_keeps_the_contract(law: str) -> None:
    drawn = checked(resolve(load("paper7", [f"law={law}"])))
    hg.testing.check_law(drawn.law)
    hg.testing.check_law(drawn.law, drawn)
    checked(load("paper7", [f"law={law}"]))
