"""Faults as data: the valid entries of `faults:`, the refusals, and the effects as plain numbers."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from hedgerow.topologies.effects import FOREVER, Effect
from hedgerow.topologies.errors import Code, TopologyError
from hedgerow.topologies.fault_kinds import FAULT_KINDS
from hedgerow.topologies.faults import (
    KINDS,
    Actuator,
    Crash,
    Cut,
    Delay,
    Drop,
    Fault,
    Jump,
    Partition,
    Sensor,
    effects,
    known_keys,
)
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.rules import broken_faults
from hedgerow.topologies.schema import Topology
from tests.tools.refusals import refusal

# The star of the tests: 2 is the hub of 1, 3 and 4. A node has the position id - 1. Incidences (receiver <- sender):
#   0: 1 <- 2    1: 2 <- 1    2: 2 <- 3    3: 2 <- 4    4: 3 <- 2    5: 4 <- 2
NODES = (1, 2, 3, 4)
EDGES = ((1, 2), (3, 2), (2, 4))
LINKS = [*EDGES, *(edge[::-1] for edge in EDGES)]
HEAD = """\
name: star
b: 0.1
steps: 30
defaults: {candidates: [0.3, 0.6, 0.8], a: 0.6}
nodes: [1, 2, 3, 4]
edges: [[1, 2], [3, 2], [2, 4]]
"""


def star(faults: str, *more: str) -> Topology:
    """The star with the faults that a text lists, resolved."""
    return resolve(parse(f"{HEAD}faults: {faults}\n".encode(), "star.yaml", Path(), more))


def effects_of(faults: str, *more: str) -> list[Effect]:
    """Return the effects of the listed faults on the star."""
    network = star(faults, *more)
    return effects(network.faults, network)


def again(topology: Topology) -> Topology:
    """Return the topology read back from the file of a run."""
    return parse(to_yaml(topology).encode(), "topology.yaml", Path())


@pytest.mark.parametrize(
    ("fault", "effect"),
    [
        ("{kind: drop, link: [2, 4], steps: [10, 20]}", Effect(0, "drop", (3, 5), 10, 20)),
        ("{kind: drop, link: [4, 2]}", Effect(0, "drop", (3, 5), 0, FOREVER)),
        ("{kind: drop, from: 2, to: 4, probability: 0.3}", Effect(0, "drop", (5,), 0, FOREVER, 0.3)),
        ("{kind: drop, from: 4, to: 2, steps: [0, 1]}", Effect(0, "drop", (3,), 0, 1)),
        (
            "{kind: drop, at: {12: [[2, 4]], 10: [[3, 2], [2, 4], [2, 4]], 11: []}}",
            Effect(0, "drop", (), 10, 13, table={10: (2, 5), 11: (), 12: (5,)}),
        ),
        ("{kind: delay, from: 1, to: 2, by: 3, steps: [1, 4]}", Effect(0, "delay", (1,), 1, 4, by=3)),
        ("{kind: delay, link: [1, 2], by: 1, probability: 0}", Effect(0, "delay", (0, 1), 0, FOREVER, 0.0, by=1)),
        ("{kind: cut, edge: [2, 3], steps: [4, 5]}", Effect(0, "cut", (1,), 4, 5)),
        ("{kind: cut, edge: [3, 2], probability: 0.5}", Effect(0, "cut", (1,), 0, FOREVER, 0.5)),
        (
            "{kind: cut, at: {3: [[4, 2], [1, 2]], 7: [[2, 3]]}}",
            Effect(0, "cut", (), 3, 8, table={3: (0, 2), 7: (1,)}),
        ),
        ("{kind: partition, groups: [[1, 2], [4]], steps: [2, 3]}", Effect(0, "drop", (3, 5), 2, 3)),
        ("{kind: partition, groups: [[1], [2], [3]]}", Effect(0, "drop", (0, 1, 2, 4), 0, FOREVER)),
        ("{kind: partition, groups: [[1], [3, 4]]}", Effect(0, "drop", (), 0, FOREVER)),
        ("{kind: sensor, node: 3, steps: [5, 9]}", Effect(0, "sensor", (2,), 5, 9)),
        ("{kind: actuator, node: 4, probability: 0.5}", Effect(0, "actuator", (3,), 0, FOREVER, 0.5)),
        ("{kind: crash, node: 1, at: 12, restart_after: 5}", Effect(0, "crash", (0,), 12, 17)),
        ("{kind: crash, node: 1, at: 0}", Effect(0, "crash", (0,), 0, FOREVER)),
        ("{kind: crash, process: 3, at: 2}", Effect(0, "crash", (3,), 2, FOREVER)),
        (f"{{kind: crash, node: 1, at: 9, restart_after: {FOREVER}}}", Effect(0, "crash", (0,), 9, FOREVER)),
        ("{kind: jump, node: 2, at: 15, a: 0.3}", Effect(0, "jump", (1,), 15, FOREVER, a=0.3)),
    ],
)
def test_a_fault_becomes_numbers(fault: str, effect: Effect) -> None:
    """The star has the incidences and edges that are counted above."""
    assert effects_of(f"[{fault}]") == [effect]


def test_effects_name_their_fault_and_a_partition_that_cuts_has_two() -> None:
    listed = (
        "[{kind: sensor, node: 1}, {kind: partition, groups: [[2, 1], [3, 4]], cut: true}, {kind: sensor, node: 1}]"
    )
    assert [(effect.fault, effect.kind, effect.targets) for effect in effects_of(listed)] == [
        (0, "sensor", (0,)),
        (1, "drop", (2, 3, 4, 5)),
        (1, "cut", (1, 2)),
        (2, "sensor", (0,)),
    ]


@pytest.mark.parametrize(("processes", "struck"), [(1, [[0, 1, 2, 3]]), (2, [[0, 1], [2, 3]]), (3, [[0, 1], [2], [3]])])
def test_a_process_dies_with_all_its_nodes(processes: int, struck: list[list[int]]) -> None:
    """Nodes are laid out over processes evenly, the first processes having one more."""
    for process, nodes in enumerate(struck):
        (effect,) = effects_of(f"[{{kind: crash, process: {process}, at: 1}}]", f"processes={processes}")
        assert list(effect.targets) == nodes


def test_effects_are_in_the_positions_of_the_ids() -> None:
    """Names, and whole numbers in another order than theirs."""
    text = "{name: n, b: 0.1, steps: 3, nodes: [hub, 7, -1], edges: [[7, hub], [hub, -1]], faults: "
    listed = "[{kind: drop, from: 7, to: hub}, {kind: cut, edge: [-1, hub]}, {kind: sensor, node: '7'}]}"
    network = resolve(parse((text + listed).encode(), "n.yaml", Path()))
    assert [effect.targets for effect in effects(network.faults, network)] == [(0,), (1,), (1,)]


def test_the_plant_needs_no_pydantic_to_read_effects() -> None:
    program = (
        "import sys, topologies.effects as e; print(*{'pydantic', 'numpy', 'yaml'} & sys.modules.keys(), e.FOREVER)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout == f"{FOREVER}\n"


def test_python_gives_the_same_faults_as_a_file() -> None:
    """There is one fault of each form; ranges are windows, and `from_` is `from`."""
    from_python: tuple[Fault, ...] = (
        Drop(link=(2, 4), steps=range(10, 20)),
        Drop(link=(2, 4), steps=(10, 20)),
        Drop(from_=2, to=4, probability=0.3),
        Drop(at={10: [(2, 4), (3, 2)]}),
        Delay(from_=2, to=4, by=3),
        Cut(edge=(2, 4)),
        Partition(groups=[[1, 2], [3, 4]], steps=range(3), cut=True),
        Sensor(node=3),
        Actuator(node=3),
        Crash(node=4, at=12, restart_after=5),
        Crash(process=0, at=12),
        Jump(node=4, at=15, a=0.3),
    )
    written = """
- {kind: drop, link: [2, 4], steps: [10, 20]}
- {kind: drop, link: [2, 4], steps: [10, 20]}
- {kind: drop, from: 2, to: 4, probability: 0.3}
- {kind: drop, at: {10: [[2, 4], [3, 2]]}}
- {kind: delay, from: 2, to: 4, by: 3}
- {kind: cut, edge: [2, 4]}
- {kind: partition, groups: [[1, 2], [3, 4]], steps: [0, 3], cut: true}
- {kind: sensor, node: 3}
- {kind: actuator, node: 3}
- {kind: crash, node: 4, at: 12, restart_after: 5}
- {kind: crash, process: 0, at: 12}
- {kind: jump, node: 4, at: 15, a: 0.3}
"""
    network = star(written)
    assert network.faults == from_python
    assert [yaml.safe_load(line[2:]) for line in written.strip().splitlines()] == json.loads(
        json.dumps([fault.written() for fault in from_python]), object_hook=_whole_keys
    )
    assert Topology.model_validate(network.model_dump()) == network


def _whole_keys(mapping: dict[str, Any]) -> dict[Any, Any]:
    return {int(key) if key.isdigit() else key: value for key, value in mapping.items()}


@pytest.mark.parametrize("steps", [range(0, 10, 2), range(3, 3), range(-1, 4)])
def test_a_range_that_is_no_window(steps: range) -> None:
    with pytest.raises(ValidationError):
        Drop(link=(2, 4), steps=steps)


def test_faults_of_python_are_checked_on_resolving() -> None:
    """There is no file and no line; the network's name is in their place."""
    network = parse(HEAD.encode(), "star.yaml", Path())
    wrong = network.model_copy(update={"faults": (Drop(link=(1, 4)), Sensor(node=9))})
    assert [problem.place for problem in broken_faults(wrong)] == ["fault 1: link", "fault 2: node"]
    with refusal(Code.TOPOLOGY) as refused:
        resolve(wrong)
    assert isinstance(refused.value, TopologyError)
    assert [problem.place for problem in refused.value.problems] == ["fault 1: link", "fault 2: node"]


def test_an_override_reaches_into_a_fault() -> None:
    """By position from 0, and by step."""
    listed = "[{kind: drop, link: [2, 4]}, {kind: cut, at: {3: [[2, 4]]}}]"
    network = star(listed, "faults.0.steps=[3, 5]", "faults.1.at.3=[[1, 2]]")
    assert network.faults == (Drop(link=(2, 4), steps=(3, 5)), Cut(at={3: ((1, 2),)}))


CHANCE = HEAD.replace("[0.3, 0.6, 0.8], a: 0.6", "{random: 4}")
JUMPS = "[{kind: jump, node: 2, at: 5, a: random}, {kind: jump, node: 3, at: 5, a: random}]"


def jumps(text: str) -> list[float]:
    """Where the jumps lead, once drawn."""
    network = resolve(parse(text.encode(), "chance.yaml", Path()))
    assert resolve(network) == network == again(network)
    return [fault.a for fault in network.faults if isinstance(fault, Jump) and isinstance(fault.a, float)]


@given(st.integers(0, 2**63 - 1))
def test_a_random_jump_leads_to_another_candidate(seed: int) -> None:
    """The jump leads to another candidate than the truth before it, which an earlier jump may have changed."""
    listed = "[{kind: jump, node: 2, at: 9, a: random}, {kind: jump, node: 2, at: 5, a: random}]"
    network = resolve(parse(f"{CHANCE}seed: {seed}\nfaults: {listed}".encode(), "n.yaml", Path()))
    later, earlier = (fault.a for fault in network.faults if isinstance(fault, Jump))
    own = network.nodes[2]
    assert own.candidates is not None
    assert isinstance(own.candidates, tuple)
    assert {earlier, later} <= {*own.candidates}
    assert own.a != earlier != later


def test_every_other_candidate_is_drawn_by_some_seed() -> None:
    drawn = {jumps(f"{HEAD}seed: {seed}\nfaults: {JUMPS}")[0] for seed in range(40)}
    assert drawn == {0.3, 0.8}


def test_a_jump_of_a_node_with_one_candidate_stays() -> None:
    assert jumps(HEAD.replace("[0.3, 0.6, 0.8]", "[0.6]") + f"faults: {JUMPS}") == [0.6, 0.6]


def test_a_jump_changes_no_other_draw() -> None:
    """Neither the network's numbers nor another node's or another step's jump."""
    bare = resolve(parse(CHANCE.encode(), "n.yaml", Path()))
    drawn = resolve(parse(f"{CHANCE}faults: {JUMPS}".encode(), "n.yaml", Path()))
    assert drawn.nodes == bare.nodes
    other = "{kind: jump, node: 1, at: 5, a: random}, {kind: jump, node: 4, at: 2, a: random}"
    assert jumps(f"{CHANCE}faults: [{other}, {JUMPS[1:]}")[2:] == jumps(f"{CHANCE}faults: {JUMPS}")


def test_a_jump_to_an_undrawn_number_reports_the_drawn_ones() -> None:
    """Before the draw, the target is unknown; the answer can be copied into the file."""
    network = parse(f"{CHANCE}faults: [{{kind: jump, node: 2, at: 5, a: 0.3}}]".encode(), "n.yaml", Path())
    with pytest.raises(TopologyError) as caught:
        resolve(network)
    drawn = resolve(parse(CHANCE.encode(), "n.yaml", Path())).nodes[2].candidates
    assert isinstance(drawn, tuple)
    listed = ", ".join(map(repr, drawn))
    assert str(caught.value) == f"star: fault 1: a: 0.3 is not among the candidates of node 2; they are {listed}"


STEP = st.one_of(st.integers(0, 40), st.integers(0, 2**61))
WINDOW = st.tuples(STEP, st.integers(1, 50)).map(lambda pair: [pair[0], pair[0] + pair[1]])
LINK = st.sampled_from(LINKS).map(list)
NODE = st.sampled_from(NODES)
TABLE = st.dictionaries(STEP, st.lists(LINK, max_size=4), min_size=1, max_size=4)


def _some(**keys: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({}, optional=keys)


def _with(kind: str, **keys: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({"kind": st.just(kind), **keys})


def _merged(*parts: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    return st.tuples(*parts).map(lambda members: {key: value for part in members for key, value in part.items()})


WHEN = _some(steps=WINDOW, probability=st.sampled_from([0, 0.0, 0.1, 1e-300, 0.5, 1, 1.0]))
ENDS = st.one_of(
    LINK.map(lambda link: {"link": link}),
    LINK.map(lambda link: {"from": link[0], "to": link[1]}),
)
GROUPS = st.permutations(NODES).flatmap(
    lambda order: st.tuples(st.integers(1, 2), st.integers(3, 4)).map(
        lambda at: [list(order[: at[0]]), list(order[at[0] : at[1]])]
    )
)
WRITTEN = st.one_of(
    _merged(_with("drop"), ENDS, WHEN),
    _with("drop", at=TABLE),
    _merged(_with("delay", by=st.integers(1, 10**6)), ENDS, WHEN),
    _merged(_with("cut", edge=LINK), WHEN),
    _with("cut", at=TABLE),
    _merged(_with("partition", groups=GROUPS), _some(steps=WINDOW, cut=st.booleans())),
    _merged(_with("sensor", node=NODE), WHEN),
    _merged(_with("actuator", node=NODE), WHEN),
    _merged(_with("crash", node=NODE, at=STEP), _some(restart_after=st.integers(1, 50))),
    _merged(_with("crash", process=st.integers(0, 2), at=STEP), _some(restart_after=st.integers(1, 50))),
    _with("jump", node=NODE, at=STEP, a=st.sampled_from([0.3, 0.6, 0.8, "random"])),
)


@given(st.lists(WRITTEN, max_size=6), st.booleans(), st.booleans())
@example([{"kind": "drop", "at": {10**18: [], FOREVER: [[2, 4]]}}], True, False)
def test_faults_survive_the_file_of_a_run(written: list[dict[str, Any]], as_json: bool, backfill: bool) -> None:
    """YAML or JSON, read, drawn, written and read back: the same faults, each on one line or one line per step."""
    network = yaml.safe_load(HEAD) | {"faults": written, "processes": 3, "backfill": backfill, "history": 7}
    text = json.dumps(network) if as_json else yaml.safe_dump(network)
    read = parse(text.encode(), "any.yaml", Path())
    topology = resolve(read)
    assert again(topology) == topology == resolve(topology)
    assert to_yaml(again(topology)) == to_yaml(topology)
    assert (topology.processes, topology.backfill, topology.history) == (3, backfill, 7)
    assert [fault.kind for fault in topology.faults] == [fault["kind"] for fault in written]
    lines = to_yaml(topology).split("\nfaults:\n")[1].split("\nbackfill:")[0].split("\nhistory:")[0] if written else ""
    assert len(lines.splitlines()) == sum(2 + len(f["at"]) if isinstance(f.get("at"), dict) else 1 for f in written)


@given(st.lists(WRITTEN, max_size=6))
def test_effects_survive_json_and_have_existing_targets(written: list[dict[str, Any]]) -> None:
    """Targets are sorted, each once, and in range; steps hold at least one."""
    network = yaml.safe_load(HEAD) | {"faults": written, "processes": 3}
    topology = resolve(parse(yaml.safe_dump(network).encode(), "any.yaml", Path()))
    found = effects(topology.faults, topology)
    assert [Effect.from_dict(json.loads(json.dumps(effect.to_dict()))) for effect in found] == found
    assert [Effect.from_dict(effect.to_dict()) for effect in found] == found
    assert [*dict.fromkeys(effect.fault for effect in found)] == [*range(len(written))]
    most = {"drop": 6, "delay": 6, "cut": 3}
    for effect in found:
        assert effect.start < effect.stop <= FOREVER
        for targets in (effect.targets, *(effect.table or {}).values()):
            assert list(targets) == sorted({*targets})
            assert all(0 <= target < most.get(effect.kind, 4) for target in targets)


@given(GROUPS)
def test_a_partition_is_the_drop_of_every_link_between_its_groups(groups: list[list[int]]) -> None:
    of = {node: k for k, group in enumerate(groups) for node in group}
    apart = [list(edge) for edge in EDGES if {*edge} <= of.keys() and of[edge[0]] != of[edge[1]]]
    listed: list[dict[str, Any]] = [{"kind": "partition", "groups": groups, "cut": True}]
    listed += [{"kind": "drop", "link": edge} for edge in apart] + [{"kind": "cut", "edge": edge} for edge in apart]
    drop, cut, *each = effects_of(json.dumps(listed))
    assert sorted(drop.targets) == sorted(c for effect in each if effect.kind == "drop" for c in effect.targets)
    assert sorted(cut.targets) == sorted(e for effect in each if effect.kind == "cut" for e in effect.targets)


def test_every_kind_is_known_by_its_name() -> None:
    """The schema also describes each of its keys."""
    assert list(KINDS) == ["drop", "delay", "cut", "partition", "sensor", "actuator", "crash", "jump"]
    assert known_keys(KINDS["drop"]) == ["kind", "link", "from", "to", "at", "steps", "probability"]
    assert all(
        field.description or key == "kind" for model in KINDS.values() for key, field in model.model_fields.items()
    )


@pytest.mark.parametrize("kind", KINDS)
def test_the_model_and_the_plant_know_the_same_keys_of_a_kind(kind: str) -> None:
    """The model describes the keys in a file; the table is what a plant without pydantic uses."""
    known, fields = FAULT_KINDS[kind], KINDS[kind].model_fields
    targets = {key for form in known.forms for key in form}
    assert {"kind", *targets, *known.required, *known.optional} == {*known_keys(KINDS[kind])}
    always = targets if len(known.forms) == 1 else set()
    assert {*known.required, *always} == {key for key, field in fields.items() if field.is_required()}


def test_a_file_without_faults_has_none() -> None:
    network = resolve(load("paper7"))
    assert (network.faults, network.backfill, network.history, network.processes) == ((), True, 100_000, None)
    assert effects(network.faults, network) == []
    assert not {"faults", "backfill", "history", "processes"} & yaml.safe_load(to_yaml(network)).keys()
