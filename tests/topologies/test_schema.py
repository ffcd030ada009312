"""The JSON Schema that `orchestrator schema` prints, for editors."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import pytest

from hedgerow.topologies.load import bundled, find
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.source import read_source

VALIDATOR = jsonschema.Draft202012Validator(Topology.model_json_schema())
GOOD: dict[str, Any] = {"name": "good", "b": 0.1, "steps": 1, "nodes": [1, 2], "edges": [[1, 2]]}


@pytest.mark.parametrize("name", bundled())
def test_every_bundled_file_satisfies_it(name: str) -> None:
    written = read_source(name, find(name).read_bytes()).value
    VALIDATOR.validate(json.loads(json.dumps(written)))


@pytest.mark.parametrize(
    "more",
    [
        {"nodes": {"1": None, "2": {"disturbance": "none"}}},
        {"disturbance": "worst_case"},
        {"defaults": {"disturbance": ["none", {"kind": "white", "std": 1}]}},
        {"faults": [], "backfill": False, "history": 1, "processes": 2},
    ],
)
def test_the_short_forms_satisfy_it(more: dict[str, Any]) -> None:
    VALIDATOR.validate(GOOD | more)


@pytest.mark.parametrize(
    "more",
    [{"b": -1}, {"b": "0.1"}, {"name": "a b"}, {"steps": 0}, {"law": "foo"}, {"defaults": {"xo": 1}}, {"sead": 1}],
)
def test_a_slip_does_not(more: dict[str, Any]) -> None:
    assert VALIDATOR.is_valid(GOOD)
    assert not VALIDATOR.is_valid(GOOD | more)


FAULTS = """
- {kind: drop, link: [2, 4], steps: [10, 20]}
- {kind: drop, from: 2, to: 4, steps: [10, 20], probability: 0.3}
- {kind: drop, at: {10: [[2, 4], [3, 5]], 12: [[2, 4]]}}
- {kind: delay, from: 2, to: 4, by: 3, steps: [10, 40]}
- {kind: cut, edge: [2, 4], steps: [10, 20]}
- {kind: cut, at: {10: [[2, 4]]}}
- {kind: partition, groups: [[1, 2, 3], [4, 5, 6, 7]], steps: [10, 20], cut: false}
- {kind: sensor, node: 3, steps: [5, 9]}
- {kind: actuator, node: hub, steps: [5, 9], probability: 0.5}
- {kind: crash, node: 4, at: 12, restart_after: 5}
- {kind: crash, process: 2, at: 12}
- {kind: jump, node: 4, at: 15, a: 0.3}
- {kind: jump, node: 4, at: 15, a: random}
"""


@pytest.mark.parametrize("fault", FAULTS.strip().splitlines())
def test_every_form_of_every_fault_satisfies_it(fault: str) -> None:
    """Steps that are keys are text in JSON."""
    (written,) = read_source("faults", fault.encode()).value
    VALIDATOR.validate(GOOD | {"faults": [json.loads(json.dumps(written))]})


@pytest.mark.parametrize(
    "fault",
    [
        *("5", "{}", "{kind: dorp}", "{link: [2, 4]}", "{node: 3}", "{kind: drop}", "{kind: drop, from: 2}"),
        *("{kind: drop, link: [2, 4], from: 2, to: 4}", "{kind: drop, link: [2]}", "{kind: drop, link: [2, 4, 5]}"),
        *("{kind: drop, link: [2, 4], step: [1, 2]}", "{kind: drop, link: [2, 4], steps: [1]}", "{kind: drop, at: {}}"),
        *("{kind: drop, at: {x: [[2, 4]]}}", "{kind: drop, at: {-1: [[2, 4]]}}", "{kind: drop, at: {1: [2, 4]}}"),
        *(
            "{kind: drop, link: [2, 4], probability: 2}",
            "{kind: delay, link: [2, 4]}",
            "{kind: delay, link: [2, 4], by: 0}",
        ),
        *("{kind: cut}", "{kind: cut, link: [2, 4]}", "{kind: partition, groups: [[1]]}", "{kind: sensor}"),
        *("{kind: sensor, node: a b}", "{kind: crash, node: 4}", "{kind: crash, node: 4, process: 1, at: 2}"),
        *("{kind: crash, node: 4, at: 2, restart_after: 0}", "{kind: jump, node: 4, at: 2}"),
        "{kind: jump, node: 4, at: 2, a: drawn}",
    ],
)
def test_a_fault_that_the_loader_refuses_does_not(fault: str) -> None:
    written = read_source("faults", fault.encode()).value
    assert not VALIDATOR.is_valid(GOOD | {"faults": [json.loads(json.dumps(written))]})


@pytest.mark.parametrize("more", [{"backfill": "no"}, {"history": 0}, {"processes": 0}])
def test_a_slip_around_the_faults_does_not(more: dict[str, Any]) -> None:
    assert not VALIDATOR.is_valid(GOOD | more)
