"""A file with two readings is refused with both readings, and an option selects one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.launch.external_agents import chosen
from hedgerow.orchestrator.runs.files import find_run
from hedgerow.topologies.base import node_id
from hedgerow.topologies.errors import Code, FileRefusedError, TopologyError, UserError
from hedgerow.topologies.header import split
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.schema import Topology
from tests.tools.examples import examples

HEAD = "name: n\nb: 0.1\nsteps: 3\n"
DATA = "0.5,0.25,0.125\n" * 3


def sampled(folder: Path, nodes: str, table: str, header: str | None = None) -> Topology:
    """Return a resolved network with a CSV file as its disturbance."""
    (folder / "w.csv").write_text(table)
    more = f", header: {header}" if header else ""
    text = f"{HEAD}nodes: {nodes}\ndefaults: {{disturbance: {{kind: samples, file: w.csv{more}}}}}\n"
    return resolve(parse(text.encode(), "n.yaml", folder), folder)


def first_samples(topology: Topology) -> dict[int | str, float]:
    """w(0) of each node."""
    return {node: getattr(own.disturbance, "values")[0] for node, own in topology.nodes.items()}  # noqa: B009


def code_of(folder: Path, nodes: str, table: str, header: str | None = None) -> Code:
    with pytest.raises(TopologyError) as refused:
        sampled(folder, nodes, table, header)
    return refused.value.code


@pytest.mark.parametrize(
    ("nodes", "table"),
    [
        ("[1, 2, 3]", "3,2,4\n" + DATA),
        ("[1, 2, 3]", "3,3,1\n" + DATA),
        ("[1, 2, 3]", "0,1,2\n" + DATA),
        ("[1, 2, 3]", "11,12,13\n" + DATA),
        ("[1, 2, 3]", "1.0,3.0,2.0\n" + DATA),
        ("[7, 12]", "012,007\n" + "0.5,0.25\n" * 3),
        ("[0, 1]", "0,1\n1,1\n0,0\n1,0\n"),
        ("[1, 2, 3]", "3,1,2\n1,2,3\n2,3,1\n1,1,1\n"),
        ("[a, b, c]", "0,0.5,0.25\n1,0.25,0.5\n2,0.5,0.5\n"),
        ("[a, b]", "1,0.5\n2,0.25\n3,0.5\n"),
        ("[a, b]", "0.0,0.5\n0.1,0.25\n0.2,0.5\n"),
    ],
    ids=[
        "shifted",
        "twice",
        "from 0",
        "other ids",
        "points",
        "zeros",
        "bits",
        "ranks",
        "index",
        "index from 1",
        "time",
    ],
)
def test_a_first_row_or_column_with_two_readings_is_refused(nodes: str, table: str, tmp_path: Path) -> None:
    assert code_of(tmp_path, nodes, table) == Code.FILE_AMBIGUOUS


def test_header_selects_the_reading(tmp_path: Path) -> None:
    bits = "1,0\n1,1\n0,0\n1,0\n"
    assert first_samples(sampled(tmp_path, "[0, 1]", bits, "ids")) == {1: 1.0, 0: 1.0}
    assert first_samples(sampled(tmp_path, "[0, 1]", bits, "none")) == {0: 1.0, 1: 0.0}
    assert first_samples(sampled(tmp_path, "[1, 2, 3]", "3,2,4\n" + DATA, "none")) == {1: 3.0, 2: 2.0, 3: 4.0}
    assert code_of(tmp_path, "[1, 2, 3]", "3,2,4\n" + DATA, "ids") == Code.FILE_FORMAT
    ramp = "0,0.5\n1,0.25\n2,0.5\n"
    assert first_samples(sampled(tmp_path, "[a, b]", ramp, "none")) == {"a": 0.0, "b": 0.5}


@pytest.mark.parametrize("what", ["values: [1, 2, 3]", "file: w.csv, header: first"])
def test_header_is_an_option_of_files_with_two_values(what: str, tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text("1\n2\n3\n")
    header = "" if "header" in what else ", header: ids"
    with pytest.raises(TopologyError):
        parse(f"{HEAD}nodes: {{a: {{disturbance: {{kind: samples, {what}{header}}}}}}}".encode(), "n", tmp_path)


@pytest.mark.parametrize(
    ("nodes", "table", "expected"),
    [
        ("[1, 2, 3]", "3,1,2\n" + DATA, {3: 0.5, 1: 0.25, 2: 0.125}),
        ("[1, 2, 3]", " 3 , 1 ,2\n10,20,30\n" * 1 + "1,2,3\n2,3,4\n", {3: 10.0, 1: 20.0, 2: 30.0}),
        ('["007", "012"]', "012,007\n" + "0.5,0.25\n" * 3, {"012": 0.5, "007": 0.25}),
        ("[1, 2, 3]", "0,0,0\n0.5,0,0\n0,0,1\n", {1: 0.0, 2: 0.0, 3: 0.0}),
        ("[a, b, c]", "3,2,4\n5,6,7\n8,9,1\n", {"a": 3.0, "b": 2.0, "c": 4.0}),
        ("[a, t]", "t,a\n0,5\n1,6\n2,7\n", {"t": 0.0, "a": 5.0}),
    ],
    ids=["ids", "whole samples", "quoted", "at rest", "names", "a node t"],
)
def test_a_file_with_one_reading_needs_no_option(
    nodes: str, table: str, expected: dict[int | str, float], tmp_path: Path
) -> None:
    assert first_samples(sampled(tmp_path, nodes, table)) == expected


@pytest.mark.parametrize(
    ("table", "named"),
    [
        (",a,b\n0,1,2\n1,3,4\n2,5,6\n", "index"),
        ("time,a,b\n0,1,2\n1,3,4\n2,5,6\n", "time"),
        ("0,1.5,2\n1,3,4\n2,5,6\n", "index"),
        ("a,b,\n1,2,\n3,4,\n5,6,\n", "comma"),
        ("1.5,2,\n3,4,\n5,6,\n", "comma"),
        ("a;b\n1;2\n3;4\n5;6\n", "semicolons"),
        ("1,5;2,5\n3;4\n5;6\n", "semicolons"),
        ("a\tb\n1\t2\n3\t4\n5\t6\n", "tabs"),
        ("1.0 2.0\n3.0 4.0\n5.0 6.0\n", "spaces"),
        ("# a,b\n1,2\n3,4\n5,6\n", "#"),
        ("a,a\n1,2\n3,4\n5,6\n", "twice"),
        ('a,b\n"1,5",2\n3,4\n5,6\n', "point"),
    ],
)
def test_the_form_of_a_csv_file_is_named_where_it_is_wrong(table: str, named: str, tmp_path: Path) -> None:
    with pytest.raises(TopologyError) as refused:
        sampled(tmp_path, "[a, b]", table)
    (problem,) = refused.value.problems
    assert problem.code == Code.FILE_FORMAT
    assert problem.what.startswith("w.csv:")
    assert named in problem.what + problem.cure


CELLS = st.one_of(st.integers(-2, 6).map(str), st.sampled_from(["a", "b", "", "t", "1.0", "0.5", "007", "nan", " 1"]))


@given(
    st.lists(st.sampled_from(["1", "2", "3", "a", "b", "007"]), min_size=1, max_size=4, unique=True),
    st.integers(1, 5).flatmap(lambda k: st.lists(st.lists(CELLS, min_size=k, max_size=k), min_size=1, max_size=4)),
)
@settings(max_examples=examples(300))
def test_a_file_is_read_in_one_way_or_refused(names: list[str], rows: list[list[str]]) -> None:
    """For any reading, the other option gives another result or is impossible, never the same silently."""
    ids, table = [node_id(name) for name in names], list(enumerate(rows, 1))
    try:
        named, above = split("w.csv", table, ids, None)
    except FileRefusedError:
        return
    asked: Any = "ids" if above else "none"
    assert split("w.csv", table, ids, asked) == (named, above)
    whole = all(cell.strip().lstrip("-").isdecimal() for cell in rows[0])
    if not above and whole and any(name.isdecimal() for name in names) and len({cell.strip() for cell in rows[0]}) > 1:
        raise AssertionError("a row of whole numbers was taken for samples of a network with whole numbers as ids")


# Ids.


@pytest.mark.parametrize("written", ["007", "012", "-01", "00", "12e4", "1e3", "+7", "1.5", "1.0", "true", ".inf"])
def test_an_id_with_two_readings_is_refused_everywhere(written: str) -> None:
    for text in (f"nodes: [{written}, z]", f"nodes: {{{written}: {{}}, z: }}"):
        with pytest.raises(TopologyError) as refused:
            parse((HEAD + text).encode(), "n.yaml", Path())
        (problem,) = refused.value.problems
        assert problem.code == Code.FILE_AMBIGUOUS
        assert written in problem.what
        assert f'"{written}"' in problem.cure
        assert (problem.line, problem.column) == (4, 9)


@pytest.mark.parametrize(
    "more",
    ["edges: [[007, 8]]", "faults: [{kind: sensor, node: 007}]", "record: {nodes: [007]}", "seed: 010", "steps: 010"],
)
def test_a_reference_or_a_number_with_two_readings_is_refused(more: str) -> None:
    text = f"{HEAD}nodes: [7, 8, '007']\n{more}\n".replace(
        "steps: 3\n", "" if more.startswith("steps") else "steps: 3\n"
    )
    with pytest.raises(TopologyError) as refused:
        parse(text.encode(), "n.yaml", Path())
    assert {problem.code for problem in refused.value.problems} == {Code.FILE_AMBIGUOUS}


@pytest.mark.parametrize("steps", ['5: [[1, 2]], "5": [[2, 1]]', '"05": [[1, 2]]'])
def test_a_step_is_named_once_and_in_its_shortest_form(steps: str) -> None:
    with pytest.raises(TopologyError) as refused:
        parse(f"{HEAD}nodes: [1, 2]\nedges: [[1, 2]]\nfaults: [{{kind: drop, at: {{{steps}}}}}]".encode(), "n", Path())
    assert all(problem.place.startswith("fault 1: at") for problem in refused.value.problems)


def test_quoted_ids_stay_text_unless_they_are_spelled_as_a_number_is() -> None:
    text = f"{HEAD}nodes: ['007', 7, '08', \"-5\", '1e3']\nedges: [['007', 7], [7, '08'], ['-5', '1e3']]\n"
    topology = resolve(parse(text.encode(), "n.yaml", Path()))
    assert topology.ids == ("007", 7, "08", -5, "1e3")
    assert parse(to_yaml(topology).encode(), "again.yaml", Path()) == topology


@given(st.lists(st.integers(-(10**30), 10**30), min_size=2, max_size=5, unique=True))
@settings(max_examples=examples(30))
def test_ids_are_any_integers_in_yaml_and_json(ids: list[int]) -> None:
    """Keys in JSON are text, and references can be numbers: both name the same node, of any size."""
    listed = f"{HEAD}nodes: {ids}\nedges: [[{ids[0]}, '{ids[1]}']]\n"
    mapped = ", ".join(f'"{node}": {{}}' for node in ids)
    json = f'{{"name": "n", "b": 0.1, "steps": 3, "nodes": {{{mapped}}}, "edges": [[{ids[0]}, "{ids[1]}"]]}}'
    for text in (listed, json):
        topology = resolve(parse(text.encode(), "n.yaml", Path()))
        assert topology.ids == tuple(ids)
        assert topology.edges == ((ids[0], ids[1]),)
        assert parse(to_yaml(topology).encode(), "again.yaml", Path()) == topology


def test_a_run_of_huge_ids_is_written_and_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hedgerow.orchestrator.launch.simulation import simulate  # noqa: PLC0415
    from hedgerow.orchestrator.runs.reader import load_run  # noqa: PLC0415

    monkeypatch.chdir(tmp_path)
    (tmp_path / "n.yaml").write_text(f"{HEAD}nodes: [{10**30}, 2]\nedges: [[{10**30}, 2]]\n")
    run = simulate("n.yaml", run_dir="run")
    assert load_run(run.folder).ids == (10**30, 2)


# Tables of nodes and edges.


def tabled(folder: Path, more: str = "", **columns: Any) -> Topology:
    np.savez(folder / "t.npz", **columns)
    return parse(f"{HEAD}table: t.npz\n{more}".encode(), "n.yaml", folder)


def test_edges_that_can_be_positions_or_ids_are_refused(tmp_path: Path) -> None:
    columns: dict[str, Any] = {"ids": np.array([1, 2, 3, 4]), "edges": np.array([[1, 2], [2, 3]])}
    with pytest.raises(TopologyError) as refused:
        tabled(tmp_path, **columns)
    assert refused.value.code == Code.FILE_AMBIGUOUS
    assert tabled(tmp_path, "table_nodes: ids", **columns).graph.edges.tolist() == [[0, 1], [1, 2]]
    assert tabled(tmp_path, "table_nodes: positions", **columns).graph.edges.tolist() == [[1, 2], [2, 3]]


def test_edges_with_one_reading_need_no_option(tmp_path: Path) -> None:
    edges = np.array([[0, 1], [1, 2]])
    assert tabled(tmp_path, ids=np.array([1, 2, 3]), edges=edges).graph.edges.tolist() == edges.tolist()
    assert tabled(tmp_path, ids=np.array(["a", "b", "c"]), edges=edges).graph.edges.tolist() == edges.tolist()
    with pytest.raises(TopologyError) as refused:
        tabled(tmp_path, ids=np.array([10, 20, 30]), edges=np.array([[10, 20]]))
    assert refused.value.code == Code.FILE_FORMAT
    names: dict[str, Any] = {"ids": np.array(["a", "b", "c"]), "edges": np.array([["c", "a"]])}
    assert tabled(tmp_path, "table_nodes: ids", **names).graph.edges.tolist() == [[2, 0]]


def test_an_array_of_objects_is_named_with_the_cure(tmp_path: Path) -> None:
    with pytest.raises(TopologyError) as refused:
        tabled(tmp_path, ids=np.array([1, "b"], dtype=object), edges=np.array([[0, 1]]))
    assert refused.value.code == Code.FILE_FORMAT
    assert "`ids`" in str(refused.value)


# Names.


def test_a_run_here_and_one_of_that_name_in_runs_are_two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("mine", "runs/mine"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "topology.yaml").write_text("{}")
    with pytest.raises(UserError) as refused:
        find_run("mine")
    assert refused.value.code == Code.FILE_AMBIGUOUS
    assert find_run("./mine") == tmp_path / "mine"
    assert find_run("runs/mine") == tmp_path / "runs/mine"


@pytest.mark.parametrize("word", ["all", "plant", "agent-1"])
def test_an_external_word_that_is_a_node_and_something_else_is_refused(word: str) -> None:
    topology = resolve(parse(f"{HEAD}nodes: [1, {word}]".encode(), "n.yaml", Path()))
    with pytest.raises(UserError) as refused:
        chosen(word, topology, [[0], [1]], None, "tcp/0.0.0.0:7447", "n", 1.0)
    assert refused.value.code == Code.OPTION
    assert chosen(f"agent-{word}", topology, [[0], [1]], None, "tcp/0.0.0.0:7447", "n", 1.0).shards == {1}


@pytest.mark.parametrize("place", ["paper7", "paper7/topology.yaml"])
def test_a_file_or_run_named_like_a_bundled_network_is_asked_about(place: str, here: Path) -> None:
    """The message names both readings, each with a distinct name."""
    file = here / place
    file.parent.mkdir(exist_ok=True)
    file.write_text("{name: mine, b: 0.1, steps: 3, nodes: [1, 2], edges: [[1, 2]]}")
    with pytest.raises(UserError) as error:
        load("paper7")
    assert error.value.code == Code.FILE_AMBIGUOUS
    assert load("./paper7").name == "mine"
    words = str(error.value).split()
    bundled_file = next(word.removesuffix(".") for word in words if word.endswith("paper7.yaml."))
    assert load(bundled_file).name == "paper7"


def test_a_folder_that_is_no_run_leaves_the_name_to_the_bundled_network(here: Path) -> None:
    (here / "paper7").mkdir()
    assert load("paper7").name == "paper7"
