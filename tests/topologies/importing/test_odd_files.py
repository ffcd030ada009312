"""Files as people have them: each is read as it is meant, or refused at the place of the mistake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
import scipy.io

import hedgerow as hg
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.written import Imported, import_file
from tests.tools.importing import edges_of, needs
from tests.tools.refusals import refusal

NODE_LINK = {"nodes": [{"id": 1}, {"id": 2}], "links": [{"source": 1, "target": 2}]}
GRAPHML = '<?xml version="1.0"?><graphml><graph edgedefault="undirected">{}</graph></graphml>'
GOOD = {
    "tabs.tsv": "# from a spreadsheet\n1\t2\t0.5\n2\t3\t2\n",
    "semicolons.csv": "from;to;weight\r\n1;2;0.5\r\n2;3;2\r\n",
    "mark.csv": "\ufeffsource,target,weight\n1,2,0.5\n2,3,2\n",
    "capitals.csv": "Source,Target,Type,Id,Label,Weight\n1,2,Undirected,0,,0.5\n2,3,Directed,1,,2.0\n",
    "between.csv": "% one comment\n1,2,0.5\n// another\n2,3,2\n",
    "edges.json": json.dumps(
        {
            "nodes": [{"id": 1}, {"id": 2}, {"id": 3}],
            "edges": [{"source": 1, "target": 2, "weight": 0.5}, {"source": 2, "target": 3, "weight": 2.0}],
        }
    ),
    "bare.graphml": GRAPHML.format(
        '<node id="1"/><node id="2"/><node id="3"/><edge source="1" target="2"/><edge source="2" target="3"/>'
    ),
    "twice.gml": "graph [ node [ id 1 ] node [ id 2 ] node [ id 3 ] edge [ source 1 target 2 weight 0.25 ]"
    " edge [ source 1 target 2 weight 0.25 ] edge [ source 2 target 3 weight 2.0 ] ]",
    "pattern.mtx": "%%MatrixMarket matrix coordinate pattern symmetric\n3 3 2\n2 1\n3 2\n",
    "skew.mtx": "%%MatrixMarket matrix coordinate real skew-symmetric\n3 3 2\n2 1 0.5\n3 2 2\n",
    "corner.csv": ",1,2,3\n1,0,0.5,0\n2,0.5,0,2\n3,0,2,0\n",
}
REFUSED = {
    "empty.csv": "",
    "comments.csv": "# nothing\n",
    "header.csv": "source,target,weight\n",
    "nodes.csv": "node,x,y\nA,0,0\nB,1,1\n",
    "zero.csv": "1,2,0\n",
    "none.csv": "1,2,nan\n",
    "endless.csv": "1,2,inf\n",
    "missing.csv": "1,2,5\n2,3\n",
    "comma.csv": "a;b;weight\n1;2;0,5\n",
    "no-id.graphml": GRAPHML.format('<node/><node/><edge source="a" target="b"/>'),
    "no-node.graphml": GRAPHML.format('<node id="a"/><edge source="a" target="b"/>'),
    "same-id.graphml": GRAPHML.format('<node id="a"/><node id="a"/>'),
    "no-graph.graphml": GRAPHML.format(""),
    "no-links.json": json.dumps({"nodes": [{"id": 1}]}),
    "no-node.json": json.dumps({**NODE_LINK, "nodes": [{"id": 1}]}),
    "same-id.json": json.dumps({**NODE_LINK, "nodes": [{"id": 1}, {"id": 1}, {"id": 2}]}),
    "list.json": "[1, 2]",
    "complex.mtx": "%%MatrixMarket matrix coordinate complex general\n2 2 1\n1 2 1 1\n",
    "negative.mtx": "%%MatrixMarket matrix coordinate integer symmetric\n2 2 1\n2 1 -3\n",
    "wide.mtx": "%%MatrixMarket matrix coordinate real general\n2 3 1\n1 2 1\n",
}


def imported(name: str, content: str, **options: Any) -> Imported:
    Path(name).write_text(content, encoding="utf-8", newline="")
    return import_file(Path(name), Options(**options))


def network_of(found: Imported) -> hg.Network:
    """Return the network after a run of a few steps: its file is valid."""
    found.save(Path("out.yaml"), force=True)
    hg.simulate("out.yaml", steps=3)
    return hg.Network.of("out.yaml")


@pytest.mark.parametrize("name", GOOD)
def test_a_path_of_three_nodes_is_read_in_every_spelling(name: str, here: Path) -> None:
    edges = edges_of(network_of(imported(name, GOOD[name])))
    weighted = name not in ("bare.graphml", "pattern.mtx")
    assert edges == {frozenset((1, 2)): 0.5 if weighted else 1.0, frozenset((2, 3)): 2.0 if weighted else 1.0}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_with_a_mistake_is_refused(name: str, here: Path) -> None:
    with pytest.raises(hg.UserError) as raised:
        imported(name, REFUSED[name])
    assert raised.value.code == hg.Code.FILE_FORMAT


@pytest.mark.parametrize(("content", "line"), [("1,2\n2\n3,4\n", 2), ("1,2,0.5\n2,3,x\n", 2), ("1,2\n2,3\n\n3,\n", 4)])
def test_the_line_of_a_mistake_is_named_once(content: str, line: int, here: Path) -> None:
    with refusal(hg.Code.FILE_FORMAT, f"t.csv:{line}") as refused:
        imported("t.csv", content)
    assert str(refused.value).count("t.csv") == 1


def test_an_edge_from_both_ends_is_one_edge_if_the_user_says_so(here: Path) -> None:
    both = "1,2,3\n2,1,3\n"
    assert edges_of(network_of(imported("t.csv", both))) == {frozenset((1, 2)): 6.0}
    assert edges_of(network_of(imported("t.csv", both, directed=True))) == {frozenset((1, 2)): 3.0}


@pytest.mark.parametrize("write", [nx.adjacency_data, nx.cytoscape_data, nx.node_link_data])
def test_every_json_that_networkx_writes_is_read(write: Any, here: Path) -> None:
    graph = nx.path_graph(3)
    found = imported("t.json", json.dumps(write(graph)))
    assert set(edges_of(network_of(found))) == {frozenset((0, 1)), frozenset((1, 2))}


def test_ids_of_any_size_are_kept(here: Path) -> None:
    huge = 99999999999999999999999
    found = imported("t.csv", f"{huge},9223372036854775807\n9223372036854775807,-3\n007,-3\n")
    assert len(network_of(found).topology.ids) == 4
    assert str(huge) in found.text()


def test_complex_numbers_of_matlab_are_refused(here: Path) -> None:
    scipy.io.savemat("t.mat", {"A": np.array([[0, 1j], [1j, 0]])})
    with pytest.raises(hg.UserError) as raised:
        import_file(Path("t.mat"), Options())
    assert raised.value.code == hg.Code.FILE_FORMAT


# Power grids.


def case(*branches: str, bus: str = "", after: str = "") -> str:
    buses = bus or "".join(f"{k} {1 if k > 1 else 3} 9 0 0 0 1 1 0 345 1 1.1 0.9;\n" for k in (1, 2, 7))
    listed = "".join(f"{one} -360 360;\n" for one in branches)
    return (
        "function mpc = c\nmpc.version = '2';\nmpc.baseMVA = 100;\n"
        f"mpc.bus = [\n{buses}];\nmpc.gen = [\n1 70 0 300 -300 1 100 1 250 10;\n];\nmpc.branch = [\n{listed}];\n{after}"
    )


def branch(i: int, j: int, x: float = 0.1, tap: float = 0, shift: float = 0, status: int = 1) -> str:
    return f"{i} {j} 0 {x} 0 250 250 250 {tap} {shift} {status}"


@pytest.fixture
def matpower() -> None:
    needs("matpowercaseframes")


@pytest.mark.usefixtures("matpower")
@pytest.mark.filterwarnings("default")
def test_parallel_lines_add_and_a_phase_shift_changes_nothing(here: Path) -> None:
    found = imported("c.m", case(branch(1, 2), branch(2, 1), branch(2, 7, tap=0.8, shift=15), branch(1, 7, status=0)))
    assert edges_of(network_of(found)) == {frozenset((1, 2)): pytest.approx(20), frozenset((2, 7)): pytest.approx(12.5)}


@pytest.mark.usefixtures("matpower")
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    "content",
    [
        case(branch(1, 2, x=-0.1), branch(2, 7)),
        case(branch(1, 2, x=0), branch(2, 7)),
        case(branch(1, 9)),
        case(branch(1, 2), bus="1 3 9 0 0 0 1 1 0 345 1 1.1 0.9;\n" * 2 + "2 1 9 0 0 0 1 1 0 345 1 1.1 0.9;\n"),
        # The distribution cases of MATPOWER convert ohms in this way, and the reader runs no statements.
        case(branch(1, 2), branch(2, 7), after="mpc.branch(:, [3 4]) = mpc.branch(:, [3 4]) / 10;\n"),
    ],
    ids=["series capacitor", "no reactance", "no bus", "a bus twice", "a statement"],
)
def test_a_case_that_is_no_network_of_susceptances_is_refused(content: str, here: Path) -> None:
    with pytest.raises(hg.UserError) as raised:
        imported("c.m", content)
    assert raised.value.code == hg.Code.FILE_FORMAT


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_lines_and_buses_out_of_service_are_no_part_of_a_grid(here: Path) -> None:
    needs("pandapower")
    import pandapower  # noqa: PLC0415
    from pandapower.networks import case9  # noqa: PLC0415

    whole = case9()
    pandapower.to_json(whole, "whole.json")
    before = edges_of(network_of(import_file(Path("whole.json"), Options())))
    whole.line.loc[0, "in_service"] = False
    pandapower.to_json(whole, "line.json")
    after = edges_of(network_of(import_file(Path("line.json"), Options())))
    names = dict(zip(whole.bus.index, whole.bus["name"], strict=True))
    lost = frozenset(int(names[whole.line.at[0, end]]) for end in ("from_bus", "to_bus"))
    assert after == {ends: pytest.approx(weight) for ends, weight in before.items() if ends != lost}
    whole.bus.loc[8, "in_service"] = False
    pandapower.to_json(whole, "bus.json")
    found = import_file(Path("bus.json"), Options())
    assert frozenset((9,)) not in {frozenset(ends) & {9} for ends in edges_of(network_of(found))}


# Water networks.

INP = """[JUNCTIONS]
 J1 10 5
 J2 10 5
 J3 8 2
[RESERVOIRS]
 R1 60
[PIPES]
 P1 R1 J1 100 300 100 0 Open
 P2 J1 J2 100 200 100 0 Open
 P4 J1 J3 100 200 100 0 Open
{links}
[CURVES]
 C1 10 30
 C2 0 0
 C2 10 5
[OPTIONS]
 Units LPS
 Headloss {loss}
[TIMES]
 Duration 2:00
[END]
"""


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    ("links", "loss", "joined"),
    [
        (" P3 J2 J3 100 200 100 0 Open", "H-W", True),
        (" P3 J2 J3 100 200 100 0 Closed", "H-W", False),
        (" P3 J2 J3 100 200 0.1 0 Open", "D-W", True),
        ("[PUMPS]\n P3 J2 J3 HEAD C1", "H-W", True),
        ("[PUMPS]\n P3 J2 J3 POWER 5", "H-W", True),
        ("[VALVES]\n P3 J2 J3 200 TCV 10 0", "H-W", True),
        ("[VALVES]\n P3 J2 J3 200 TCV 10 0\n[STATUS]\n P3 Closed", "H-W", False),
        ("[VALVES]\n P3 J2 J3 200 GPV C2 0", "H-W", True),
    ],
    ids=["pipe", "closed pipe", "Darcy-Weisbach", "pump", "pump of a power", "valve", "closed valve", "curve"],
)
def test_pumps_valves_and_closed_pipes(links: str, loss: str, joined: bool, here: Path) -> None:
    needs("wntr")
    roughness = INP if loss == "H-W" else INP.replace("100 0 Open", "0.1 0 Open")
    edges = edges_of(network_of(imported("n.inp", roughness.format(links=links, loss=loss), steps=3)))
    assert (frozenset(("J2", "J3")) in edges) == joined
    assert all(weight > 0 for weight in edges.values())


@pytest.mark.parametrize("content", ["", "hello\n"])
def test_an_epanet_file_without_a_network_is_refused(content: str, here: Path) -> None:
    needs("wntr")
    with pytest.raises(hg.UserError) as raised:
        imported("n.inp", content)
    assert raised.value.code == hg.Code.FILE_FORMAT
