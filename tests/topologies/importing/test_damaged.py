"""No bytes make a reader crash: a file is read, or refused with a code."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hedgerow as hg
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.written import import_file

EXAMPLES = int(os.environ.get("HEDGEROW_IMPORT_EXAMPLES", "6"))
MATRIX = np.array([[0, 0.5, 0], [0.5, 0, 2.0], [0, 2.0, 0]])


def _bytes(write: object, *content: object) -> bytes:
    file = io.BytesIO()
    write(file, *content)  # type: ignore[operator]
    return file.getvalue()


GRAPH = nx.path_graph(3)
SEEDS: dict[str, bytes] = {
    "t.graphml": "\n".join(nx.generate_graphml(GRAPH)).encode(),
    "t.gml": "\n".join(nx.generate_gml(GRAPH)).encode(),
    "t.gexf": "\n".join(nx.generate_gexf(GRAPH)).encode(),
    "t.net": "\n".join(nx.generate_pajek(GRAPH)).encode(),
    "t.json": json.dumps(nx.node_link_data(GRAPH, edges="links")).encode(),
    "t.csv": b"from,to,weight\np,q,0.5\nq,r,2\n",
    "t.mtx": _bytes(scipy.io.mmwrite, scipy.sparse.coo_array(MATRIX)),
    "t.npz": _bytes(scipy.sparse.save_npz, scipy.sparse.csr_array(MATRIX)),
    "t.mat": _bytes(scipy.io.savemat, {"A": MATRIX}),
}


@pytest.mark.parametrize("name", SEEDS)
@pytest.mark.filterwarnings("ignore")
@given(st.data())
@settings(deadline=None, max_examples=EXAMPLES, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_bytes_are_read_or_refused(name: str, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(SEEDS[name])
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place : place + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
        if not content:
            content = bytearray(b"x")
    path = tmp_path / name
    path.write_bytes(bytes(content))
    try:
        found = import_file(path, Options())
        found.save(tmp_path / "out.yaml", force=True)
        found.topology(tmp_path / "out.yaml")
    except hg.UserError as error:
        assert error.code != hg.Code.CRASH  # noqa: PT017 (most bytes can still be read)
