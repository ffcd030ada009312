"""The contract test of laws: it passes correct laws, and names the method of others."""

from __future__ import annotations

import inspect
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.agents.contract import Trial, check_law
from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.loading import LawError
from hedgerow.orchestrator.ground import laws
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Gain
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools import broken_laws
from tests.tools.broken_laws import BROKEN, IntegratesWithoutFlow, Raises
from tests.tools.examples import examples
from tests.tools.laws import Curious


@pytest.mark.parametrize("law", [Minimax, Curious])
def test_a_law_that_keeps_the_contract_passes(law: type[Any]) -> None:
    check_law(law)


@pytest.mark.parametrize("law", BROKEN, ids=lambda law: law.__name__)
def test_a_broken_law_is_refused_with_its_line_and_method(law: type[Any]) -> None:
    with pytest.raises(LawError) as refused:
        check_law(law)
    assert refused.value.code == Code.LAW
    assert re.match(r"\S*broken_laws\.py:\d+: ", str(refused.value)), str(refused.value)
    assert refused.value.method == BROKEN[law], str(refused.value)


@given(st.integers(1, 12), st.integers(1, 9), st.booleans(), st.data())
@settings(max_examples=examples(30), deadline=None)
def test_the_trial_of_any_network_passes_the_law_of_the_paper(
    n: int, most: int, unequal: bool, data: st.DataObject
) -> None:
    values = st.floats(0.05, 0.98)
    candidates = np.full((most, n), np.nan)
    for column in candidates.T:
        listed = data.draw(st.lists(values, min_size=1, max_size=most))
        column[: len(listed)] = listed
    b = np.linspace(0.05, 0.2, n) if unequal else 0.1
    trial = Trial.of([f"n{k}" for k in range(n)], b, candidates, weighted=unequal)
    assert len(set(trial.ids)) == len(trial.ids) == 5
    check_law(Minimax, trial)
    check_law(Curious, trial)


def test_a_law_that_raises_keeps_the_exception() -> None:
    with pytest.raises(LawError) as refused:
        hg.testing.check_law(Raises)
    assert isinstance(refused.value.__cause__, ZeroDivisionError)
    raised = next(k for k, line in enumerate(inspect.getsource(broken_laws).splitlines(), 1) if "raise Zero" in line)
    assert f"broken_laws.py:{raised}: " in str(refused.value)


def test_a_law_is_tested_by_its_name_with_parameters_on_a_network() -> None:
    hg.testing.check_law("tests.tools.laws:Curious(weight=2)", "paper7")
    hg.testing.check_law(Curious, weight=2)
    with pytest.raises(UserError):
        hg.testing.check_law(Curious, wieght=2)


def test_every_run_is_refused_before_it_begins() -> None:
    name = f"{IntegratesWithoutFlow.__module__}:{IntegratesWithoutFlow.__name__}"
    topology = resolve(load("paper7", [f"law={name}"]))
    with pytest.raises(LawError):
        laws.checked(topology)


class ScalesWeights(Minimax):
    """Mixes the nodes of its process through their weights; equal weights hide it."""

    def __init__(self, b: Any, candidates: Any, *, local: Any) -> None:
        super().__init__(b, candidates)
        self.share = local.sums(local.weight / local.weight.max())

    def act(self, x: Any) -> Any:
        return super().act(x) * self.share


class ScalesGains(Minimax):
    """Mixes the nodes of its process through their gains; equal gains hide it."""

    def act(self, x: Any) -> Any:
        return super().act(x) * (self.b / np.max(self.b))


UNEQUAL = """
name: unequal
b: 0.1
steps: 5
nodes: {1: {b: 0.05}, 2: {b: 0.08}, 3: {}, 4: {b: 0.06}, 5: {}}
edges: [{ends: [1, 2], weight: 0.5}, {ends: [2, 3], weight: 2}, [3, 4], [4, 5]]
"""


@pytest.mark.parametrize("law", [ScalesWeights, ScalesGains])
def test_a_network_with_unequal_gains_and_weights_tries_both(law: type[Any]) -> None:
    check_law(law)
    with pytest.raises(LawError) as refused:
        hg.simulate(UNEQUAL, law=law)
    assert refused.value.method == "act"


class NeedsTwo(Minimax):
    """Divides by the number of candidates less one."""

    def __init__(self, b: Gain, candidates: Array) -> None:
        super().__init__(b, candidates)
        self._others = (~np.isnan(candidates)).sum(axis=0) - 1

    def act(self, x: Array) -> Array:
        return np.asarray(super().act(x) * self._others / self._others)


def test_a_law_that_needs_two_candidates_runs_where_every_list_has_two() -> None:
    law = f"{NeedsTwo.__module__}:{NeedsTwo.__qualname__}"
    network = load("paper7").model_copy(update={"law": law})
    assert laws.checked(network).law == law  # not drawn, as in a comparison and a sweep
    assert laws.checked(resolve(network)).law == law
    one = load("paper7", ["nodes.3.a=0.5", "nodes.3.candidates=[0.5]"]).model_copy(update={"law": law})
    for topology in (one, resolve(one)):
        with pytest.raises(LawError) as refused:
            laws.checked(topology)
        assert (refused.value.method, refused.value.node) == ("act", 3)
    with pytest.raises(LawError) as refused:
        check_law(NeedsTwo)
    assert (refused.value.method, refused.value.node) == ("act", 4)
