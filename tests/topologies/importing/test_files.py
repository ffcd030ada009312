"""Files of other tools, each with two edges: p - q of weight 0.5 and q - r of weight 2."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import scipy.io
import scipy.sparse

import hedgerow as hg
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.written import import_file
from hedgerow.topologies.schema import Topology
from tests.tools.refusals import refusal

THREE = nx.Graph()
THREE.add_node("p", label="Pe", x=0.0, y=1.0)
THREE.add_node("q", label="Qu", x=1.0, y=1.0)
THREE.add_node("r", label="eR", x=2.0, y=0.0)
THREE.add_edge("p", "q", weight=0.5)
THREE.add_edge("q", "r", weight=2.0)
MATRIX = np.array([[0, 0.5, 0], [0.5, 0, 2.0], [0, 2.0, 0]])


def text(content: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        path.write_text(content)

    return write


WRITERS: dict[str, Callable[[Path], None]] = {
    "t.graphml": lambda path: nx.write_graphml(THREE, path),
    "t.gml": lambda path: nx.write_gml(nx.relabel_nodes(THREE, str), path),
    "t.gexf": lambda path: nx.write_gexf(THREE, path),
    "links.json": text(json.dumps(nx.node_link_data(THREE, edges="links"))),
    "edges.json": text(json.dumps(nx.node_link_data(THREE, edges="edges"))),
    "t.edgelist": text("# a comment\np q 0.5\nq r 2\n"),
    "attributes.edgelist": text("p q {'weight': 0.5}\nq r {'weight': 2}\n"),
    "letters.csv": text("a,b,0.5\nb,c,2\n"),
    "comma.csv": text("p,q,0.5\nq,r,2\n"),
    "header.csv": text("\ufefffrom;to;weight\np;q;0.5\n\n# later\nq;r;2\n"),
    "columns.csv": text("length,target,source,weight\n7,q,p,0.5\n8,r,q,2\n"),
    "named.csv": text(",p,q,r\np,0,0.5,0\nq,0.5,0,2\nr,0,2,0\n"),
    "matrix.csv": text("0,0.5,0\n0.5,0,2\n0,2,0\n"),
    "blanks.txt": text("0 0.5 0\n0.5 0 2\n0 2 0\n"),
    "t.tsv": text("source\ttarget\tweight\np\tq\t0.5\nq\tr\t2\n"),
    "t.mtx": lambda path: scipy.io.mmwrite(path, scipy.sparse.coo_array(MATRIX)),
    "t.npz": lambda path: scipy.sparse.save_npz(path, scipy.sparse.csr_array(MATRIX)),
    "t.mat": lambda path: scipy.io.savemat(path, {"A": MATRIX}),
}


def weights(topology: Topology) -> list[float]:
    found = topology.graph.weights
    assert found is not None
    return [float(one) for one in found]


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_has_its_nodes_and_weights(name: str, here: Path) -> None:
    WRITERS[name](Path(name))
    found = import_file(Path(name), Options())
    found.save(Path("out.yaml"))
    topology = hg.load("out.yaml")
    assert (len(topology.ids), weights(topology)) == (3, [0.5, 2.0])
    assert [sorted(edge) for edge in topology.graph.edges.tolist()] == [[0, 1], [1, 2]]
    if name.endswith((".graphml", "json")):
        assert topology.ids == ("Pe", "Qu", "eR")
        assert topology.network.positions is not None
        assert topology.network.positions[2].tolist() == [2.0, 0.0]


def test_three_edges_of_a_triangle_are_no_matrix(here: Path) -> None:
    Path("t.csv").write_text("1,2,3\n2,3,1\n3,1,2\n")
    found = import_file(Path("t.csv"), Options())
    assert [edge["ends"] if isinstance(edge, dict) else edge for edge in found.content["edges"]] == [
        [1, 2],
        [2, 3],
        [3, 1],
    ]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("t.graphml", "<graphml"),
        ("t.gml", "graph ["),
        ("t.json", "{"),
        ("t.json", "[1]"),
        ("t.json", '{"nodes": [{"id": 1}], "links": [{"source": 1}]}'),
        ("t.csv", ""),
        ("t.csv", "p\nq\n"),
        ("t.csv", "p,q,1\nq,r,heavy\n"),
        ("t.csv", "p,q,-1\n"),
        ("t.csv", "p,q,heavy\n"),
        ("t.mtx", "%%MatrixMarket matrix coordinate real general\n2 2 9\n"),
        ("t.mtx", "%%MatrixMarket matrix array real general\n2 3\n1\n2\n3\n4\n5\n6\n"),
        ("t.npz", "PK"),
        ("t.mat", "no"),
        ("t.m", "x = 1"),
        ("t.bin", "x"),
        ("t.json", '{"_class": "pandapowerNet", "_module": "os"}'),
    ],
)
def test_a_file_that_is_wrong_is_refused(name: str, content: str, here: Path) -> None:
    Path(name).write_text(content)
    with pytest.raises(hg.UserError) as raised:
        import_file(Path(name), Options())
    assert raised.value.code in (hg.Code.FILE_FORMAT, hg.Code.OPTION)


def test_a_pandapower_file_cannot_import_other_modules(here: Path) -> None:
    inner = json.dumps({"_module": "os", "_class": "function", "_object": "system"})
    content = {"_class": "pandapowerNet", "_module": "pandapower.auxiliary", "_object": {"bus": inner}}
    Path("t.json").write_text(json.dumps(content))
    with refusal(hg.Code.FILE_FORMAT):
        import_file(Path("t.json"), Options())


def test_only_regular_files_of_allowed_size_are_read(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo("t.csv")
    with pytest.raises(hg.UserError) as raised:
        import_file(Path("t.csv"), Options())
    assert raised.value.code == hg.Code.FILE_NOT_REGULAR
    with pytest.raises(hg.UserError) as raised:
        import_file(Path("none.csv"), Options())
    assert raised.value.code == hg.Code.FILE_MISSING
    monkeypatch.setenv("HEDGEROW_MEMORY_MB", "1")
    Path("large.csv").write_text("p,q\n" * 100_000)
    with pytest.raises(hg.UserError) as raised:
        import_file(Path("large.csv"), Options())
    assert raised.value.code == hg.Code.FILE_TOO_LARGE


def test_a_file_is_replaced_only_if_it_is_asked_for(here: Path) -> None:
    Path("t.csv").write_text("p,q\n")
    found = import_file(Path("t.csv"), Options())
    found.save(Path("out.yaml"))
    with pytest.raises(hg.UserError) as raised:
        found.save(Path("out.yaml"))
    assert raised.value.code == hg.Code.OUTPUT
    found.save(Path("out.yaml"), force=True)


def test_a_comment_is_one_line_for_any_name_of_the_source(here: Path) -> None:
    Path("t\nsteps: 7.csv").write_text("p,q\nq,r\n")
    found = import_file(Path("t\nsteps: 7.csv"), Options())
    found.save(Path("out.yaml"))
    assert hg.load("out.yaml").steps == 300


def test_a_large_network_is_a_table(here: Path) -> None:
    Path("t.csv").write_text("".join(f"n{k},n{k + 1},{k + 1}\n" for k in range(1200)))
    found = import_file(Path("t.csv"), Options())
    assert [path.name for path in found.save(Path("out.yaml"))] == ["out.yaml", "out.npz"]
    topology = hg.load("out.yaml")
    assert topology.ids[1200] == "n1200"
    assert weights(topology)[:2] == [1.0, 2.0]
