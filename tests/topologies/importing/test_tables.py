"""Tables as spreadsheets, R, pandas and networkx write them: none is read as another kind of table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest

import hedgerow as hg
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.written import import_file
from tests.tools.importing import edges_of
from tests.tools.refusals import refusal

EDGES = {
    "three edges below a header": "from,to,weight\n1,2,0.5\n2,3,2\n3,4,1\n",
    "three edges with numbers of their own": "id,from,to,weight\n1,1,2,0.5\n2,2,3,2\n3,3,4,1\n",
    "four edges with two attributes": "from,to,weight,length\n1,2,0.25,7\n2,3,2,8\n3,4,1,9\n2,1,0.25,1\n",
    "names in quotes between blanks": '1 "2" 0.5\n2 3 2\n"3" "4" 1\n',
}
MATRICES = {
    "the corner is left out, as R does": "a,b,c\na,0,0.5,0\nb,0.5,0,2\nc,0,2,0\n",
    "a text in the corner": "node,a,b,c\na,0,0.5,0\nb,0.5,0,2\nc,0,2,0\n",
    "rows in another order": ",a,b,c\nc,0,2,0\nb,0.5,0,2\na,0,0.5,0\n",
    "a header, no names of rows": "a,b,c\n0,0.5,0\n0.5,0,2\n0,2,0\n",
    "row numbers of pandas": ",a,b,c\n0,0,0.5,0\n1,0.5,0,2\n2,0,2,0\n",
}
COMMAS = {
    "a;b;0,5\nb;c;1,5\n": 1,
    "a b 2\nb c 0,5\n": 2,
    "a\tb\t0,5\nb\tc\t1,5\n": 1,
    "# k\n0;0,5;0\n0,5;0;1,5\n0;1,5;0\n": 2,
}


def read(content: str, name: str = "t.csv", **options: Any) -> hg.Network:
    Path(name).write_text(content, encoding="utf-8", newline="")
    import_file(Path(name), Options(**options)).save(Path("out.yaml"), force=True)
    return hg.Network.of("out.yaml")


@pytest.mark.parametrize("what", EDGES)
def test_a_list_of_edges_is_no_matrix(what: str, here: Path) -> None:
    assert edges_of(read(EDGES[what])) == {frozenset((1, 2)): 0.5, frozenset((2, 3)): 2.0, frozenset((3, 4)): 1.0}


@pytest.mark.parametrize("what", MATRICES)
def test_a_matrix_with_names_is_no_list_of_edges(what: str, here: Path) -> None:
    assert edges_of(read(MATRICES[what])) == {frozenset(("a", "b")): 0.5, frozenset(("b", "c")): 2.0}


@pytest.mark.parametrize("content", COMMAS)
def test_a_decimal_comma_separates_no_cells_and_is_refused_with_its_line(content: str, here: Path) -> None:
    with refusal(hg.Code.FILE_FORMAT, f"t.csv:{COMMAS[content]}"):
        read(content)


def test_the_line_of_a_mistake_below_a_cell_of_two_lines(here: Path) -> None:
    with refusal(hg.Code.FILE_FORMAT, "t.csv:5"):
        read('source,target,weight\n"two\nlines",b,2\n# none\nb,c,x\n')


def test_a_name_with_a_separator_of_lines_of_unicode_stays_whole(here: Path) -> None:
    assert len(read("a\u2028b,c\nc,d\n").topology.ids) == 3


def test_digits_with_an_underscore_are_no_number(here: Path) -> None:
    with pytest.raises(hg.UserError):
        read("source,target,weight\na,b,1_0\nb,c,2\n")


YED = """<graphml xmlns="http://graphml.graphdrawing.org/xmlns" xmlns:y="http://www.yworks.com/xml/graphml">
<key for="node" id="d6" yfiles.type="nodegraphics"/><graph edgedefault="directed">{}<edge source="n0" target="n1"/>
</graph></graphml>"""
NODE = """<node id="n{}"><data key="d6"><y:ShapeNode><y:Geometry x="{}.0" y="{}.0"/><y:NodeLabel>Tank {}</y:NodeLabel>
<y:Shape type="rectangle"/></y:ShapeNode></data></node>"""
DOWNWARDS = {
    "g.graphml": YED.format(NODE.format(0, 100, 50, "A") + NODE.format(1, 200, 0, "B")),
    "g.net": '*Vertices 2\n1 "Tank A" 100 50 0\n2 "Tank B" 200 0 0\n*Edges\n1 2 1\n',
    "g.json": '{"elements": {"nodes": [{"data": {"id": "a", "name": "Tank A"}, "position": {"x": 100, "y": 50}}, '
    '{"data": {"id": "b", "name": "Tank B"}, "position": {"x": 200, "y": 0}}], '
    '"edges": [{"data": {"source": "a", "target": "b"}}]}, "data": []}',
}


@pytest.mark.parametrize("name", DOWNWARDS)
def test_pictures_of_tools_whose_y_points_down_are_not_mirrored(name: str, here: Path) -> None:
    network = read(DOWNWARDS[name], name).topology.network
    assert [network.name(k) for k in range(2)] == ["Tank A", "Tank B"]
    assert network.positions is not None
    np.testing.assert_array_equal(network.positions, [[100, -50], [200, 0]])


def test_one_place_for_all_nodes_is_no_picture(here: Path) -> None:
    nx.write_pajek(nx.path_graph(3), "t.net")
    import_file(Path("t.net"), Options()).save(Path("out.yaml"))
    assert hg.load("out.yaml").network.positions is None
