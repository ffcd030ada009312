"""Laws that ask for local knowledge: the same in every layout, under every fault, over Zenoh as in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.loading import new_law
from hedgerow.orchestrator.ground import laws
from hedgerow.orchestrator.ground.assignment import layout, views_of
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.schema import Topology
from tests.test_faults import faulty, harsh
from tests.tools.examples import examples
from tests.tools.networks import partitions, read, simulate
from tests.tools.processes import orchestrator

CURIOUS = "tests.tools.laws:Curious"
PAPER7 = Path(__file__).parents[2] / "topologies" / "paper7.yaml"


@given(topology=faulty(), history=st.sampled_from([0, 1, 2, 5, 100_000]), data=st.data())
@settings(max_examples=examples(60))
def test_a_law_that_asks_for_everything_is_the_same_in_every_layout(
    topology: Topology, history: int, data: st.DataObject
) -> None:
    more = {"law": CURIOUS, "history": max(1, history), "backfill": history > 0}
    topology = topology.model_copy(update=more)
    assert simulate(topology, data.draw(partitions(len(topology.ids)))).same_bits(simulate(topology))


@pytest.mark.parametrize("history", [10, 100_000])
@pytest.mark.parametrize("seed", range(8))
def test_restarts_and_lost_messages_change_nothing_in_another_layout(seed: int, history: int) -> None:
    settings = ["steps=60", f"history={history}", f"law={CURIOUS}", f"faults=[{', '.join(harsh(seed))}]"]
    topology = resolve(load("paper7", settings))
    alone = simulate(topology, layout(topology, 7))
    assert all(simulate(topology, layout(topology, processes)).same_bits(alone) for processes in (1, 2, 3))


def test_a_late_sample_has_the_values_of_its_step() -> None:
    """After back-filling, the memory of a law that learns from its neighbours' states is that without the gap."""
    whole = ["steps=40", f"law={CURIOUS}", "defaults.x0=5"]
    gap = [*whole, "faults=[{kind: drop, link: [2, 4], steps: [10, 20]}]"]
    # The inputs of the law do not depend on gaps, so both runs have the same states.
    same = [[*one, "law.weight=0"] for one in (whole, gap)]
    first, second = (simulate(resolve(load("paper7", one))) for one in same)
    np.testing.assert_array_equal(first.x, second.x)
    assert (first.report[15] != second.report[15]).any()
    np.testing.assert_array_equal(first.report[25:], second.report[25:])


@pytest.mark.slow
def test_seven_processes_with_an_asking_law_equal_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    faults = (
        "faults=[{kind: drop, from: 2, to: 4, probability: 0.4}, {kind: delay, from: 4, to: 6, by: 2, steps: [5, 20]},"
        " {kind: crash, node: 3, at: 8, restart_after: 5}]"
    )
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    ran = orchestrator(
        "up", "paper7", "--viewer=none", "--no-record", "--verify", f"--law={CURIOUS}", f"--set={faults}"
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


# Parameters.


@pytest.mark.parametrize("law", [f'"{CURIOUS}(weight=0.5)"', f'{{class: "{CURIOUS}", weight: 0.5}}'])
def test_a_parameter_is_written_as_a_call_or_as_a_mapping(law: str) -> None:
    topology = laws.checked(resolve(read(f"name: one\nb: 0.1\nsteps: 3\nnodes: [1]\nlaw: {law}")))
    assert LawChoice.parse(topology.law) == LawChoice(CURIOUS, {"weight": 0.5})
    (view,) = views_of(topology, layout(topology, 1))
    assert new_law(view).weight == 0.5  # type: ignore[attr-defined]


def test_a_default_is_written_down_and_a_resolved_file_keeps_it() -> None:
    topology = laws.checked(resolve(load("paper7", [f"law={CURIOUS}"])))
    assert topology.law == f"{CURIOUS}(weight=0.25)"
    again = laws.checked(resolve(read(to_yaml(topology))))
    assert again.law == topology.law
    assert laws.checked(resolve(load("paper7", [f"law={CURIOUS}", "law.weight=2"]))).law == f"{CURIOUS}(weight=2)"


@pytest.mark.parametrize(
    "law",
    [f"{CURIOUS}(wieght=1)", f"{CURIOUS}(weight='heavy')", f"{CURIOUS}(b=3)", f"{CURIOUS}(local=3)"],
)
def test_a_wrong_parameter_is_refused_at_its_line(law: str, tmp_path: Path) -> None:
    file = tmp_path / "one.yaml"
    file.write_text(f'name: one\nb: 0.1\nsteps: 3\nlaw: "{law}"\nnodes: [1]\n')
    with pytest.raises(UserError) as refused:
        laws.checked(resolve(load(str(file))))
    assert refused.value.code == Code.LAW
    assert f"{file}:4:" in str(refused.value)


@pytest.mark.parametrize(
    "law", ["minimax(decay=1)", "x(", "x(1)", "f(a=g())", "minimax()()", "a b", "f(a=[[[[[1]]]]])"]
)
def test_a_text_that_is_no_law_is_refused(law: str) -> None:
    with pytest.raises(TopologyError):
        load("paper7", [f'law="{law}"'])


VALUES = st.none() | st.booleans() | st.integers() | st.floats(-1e300, 1e300) | st.text(max_size=9)


@given(st.dictionaries(st.from_regex(r"p_[a-z0-9]{0,5}", fullmatch=True), VALUES, max_size=4))
def test_a_choice_survives_its_text(parameters: dict[str, object]) -> None:
    choice = LawChoice.of("mylaws:RLS", parameters)
    assert LawChoice.parse(str(choice)) == choice
