"""The files of a local view: both kinds give the view that was written."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import views_of
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.schema import Topology
from tests.tools.networks import networks, partitions


@pytest.mark.parametrize("suffix", [".json", ".npz"])
@given(topology=networks(), data=st.data())
@settings(max_examples=20, deadline=None)
def test_a_view_of_any_file_is_the_view_that_was_written(suffix: str, topology: Topology, data: st.DataObject) -> None:
    shards = data.draw(partitions(len(topology.ids)))
    with tempfile.TemporaryDirectory() as folder:
        for view in views_of(topology, shards):
            file = Path(folder) / f"view{suffix}"
            view.write(file)
            back = View.read(file)
            for name in ("ids", "row", "column", "outside"):
                one, other = getattr(view, name), getattr(back, name)
                assert (one.dtype, one.shape, one.tolist()) == (other.dtype, other.shape, other.tolist())
            assert back.candidates.tobytes() == np.ascontiguousarray(view.candidates).tobytes()
            assert back.to_json() == view.to_json()
            assert back.history == view.history


@pytest.mark.parametrize("text", ["[]", "{}", '{"nodes": 3, "peers": []}', "null", "{"])
def test_json_that_is_no_view_is_refused_with_a_code(tmp_path: Path, text: str) -> None:
    (tmp_path / "v.json").write_text(text)
    with pytest.raises(UserError) as refused:
        View.read(tmp_path / "v.json")
    assert refused.value.code == Code.FILE_FORMAT
