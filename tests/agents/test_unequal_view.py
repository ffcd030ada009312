"""The gains and weights of a shard in words, as TOML and JSON hold them."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.truth import Truth
from hedgerow.topologies.schema import Topology
from tests.tools.networks import VECTORS, from_vector, gathered, networks, partitions

(W1,) = (path for path in VECTORS if path.stem == "w1_path3")


@given(networks(), st.data())
def test_the_data_of_a_process_survive_its_text(topology: Topology, data: st.DataObject) -> None:
    shards = data.draw(partitions(len(topology.ids)))
    truth, views = truth_of(topology, shards), views_of(topology, shards)
    again = [View.from_dict(json.loads(view.to_json())) for view in views]
    assert [view.to_json() for view in again] == [view.to_json() for view in views]
    document = Truth.from_dict(json.loads(json.dumps(truth.to_dict())))
    assert gathered(reference.run(document, again)).same_bits(gathered(reference.run(truth, views)))


@pytest.mark.parametrize(("key", "value"), [("b", [0.1]), ("weights", [1.0])])
def test_too_few_numbers_are_refused(key: str, value: Any) -> None:
    topology, _ = from_vector(W1)
    document = views_of(topology, layout(topology, 1))[0].to_dict()
    (document if key == "b" else document["nodes"][1])[key] = value
    with pytest.raises(ValueError):
        View.from_dict(document)
