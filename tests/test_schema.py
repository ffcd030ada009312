"""The JSON Schema that `orchestrator schema` prints, for editors."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import pytest

from topologies.load import bundled, find
from topologies.schema import Topology
from topologies.source import read_source

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
