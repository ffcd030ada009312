"""Every possible mistake in a topology file, and the message about it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.resolve import resolve, to_yaml
from tests.tools.refusals import refusal
from tests.tools.topology_texts import GOOD, HEAD, good, only, problems


def test_all_mistakes_are_reported_with_their_lines_and_fixes() -> None:
    """One file, ten mistakes, one message: file:line, node, value, allowed interval, fix."""
    text = """\
name: no good
b: 0.1
steps: -3
sede: 1
defaults:
  candidates: [0.3, 0.6]
nodes:
  1: {a: 0.4}
  2:
    x0: many
    candidates:
      - 0.5
      - 0.99
  3: {x0: true}
edges:
  - [1, 2]
  - [2, 1]
  - [3, 3]
  - [3, 9]
  - [1]
"""
    with pytest.raises(TopologyError) as caught:
        parse(text.encode(), "net.yaml", Path())

    assert [(p.line, p.column, p.place) for p in caught.value.problems] == [
        (1, 7, "name"),
        (3, 8, "steps"),
        (4, 1, ""),
        (8, 10, "node 1: a"),
        (10, 9, "node 2: x0"),
        (13, 9, "node 2: candidates"),
        (14, 11, "node 3: x0"),
        (17, 5, "edge 2"),
        (18, 5, "edge 3"),
        (19, 5, "edge 4"),
        (20, 5, "edge 5"),
    ]
    lines = str(caught.value).splitlines()
    assert [line.split(": ")[0] for line in lines] == [f"net.yaml:{p.line}:{p.column}" for p in caught.value.problems]
    for line, written in zip(lines, ("no good", "-3", "sede", "0.4", "many", "0.99", "true", "[2, 1]"), strict=False):
        assert written in line


@pytest.mark.parametrize(
    ("old", "new", "line", "place"),
    [
        ("b: 0.1", "b: .nan", 2, "b"),
        ("b: 0.1", "b: .inf", 2, "b"),
        ("b: 0.1", "b: -.INF", 2, "b"),
        ("b: 0.1", "b: 1e400", 2, "b"),
        ("b: 0.1", "b: " + "9" * 400, 2, "b"),
        ("b: 0.1", "b: " + "9" * 5000, 2, "b"),
        ("b: 0.1", "b: 1e200", 2, "b"),
        ("b: 0.1", 'b: "0.1"', 2, "b"),
        ("b: 0.1", "b: true", 2, "b"),
        ("b: 0.1", "b: [0.1]", 2, "b"),
        ("b: 0.1", "b:", 2, "b"),
        ("b: 0.1", "b: 0", 2, "b"),
        ("b: 0.1\n", "", 0, ""),
        ("steps: 3", "steps: 0", 3, "steps"),
        ("steps: 3", "steps: 3.0", 3, "steps"),
        ("steps: 3", "steps: yes", 3, "steps"),
        ("steps: 3", "steps: true", 3, "steps"),
        ("seed: 4", "seed: -1", 4, "seed"),
        (
            "seed: 4",
            "law: min",
            4,
            "law",
        ),
        ("seed: 4", "~: 4", 4, ""),
        ("x0: 1", "x0: .nan", 5, "defaults: x0"),
        ("x0: 1", "xo: 1", 5, "defaults"),
        ("x0: 1", "x0: {random: [2, 1]}", 5, "defaults: x0: random"),
        ("x0: 1", "x0: {random: [1]}", 5, "defaults: x0: random"),
        ("[0.3, 0.6]", "[]", 5, "defaults: candidates"),
        ("[0.3, 0.6]", "[0.3, no]", 5, "defaults: candidates: 1"),
        ("[0.3, 0.6]", "{random: 0}", 5, "defaults: candidates: random"),
        ("{a: 0.6}", "{a: drawn}", 8, "node 2: a"),
        ("{a: 0.6}", "{nominal: 1.5}", 8, "node 2: nominal"),
        ("{a: 0.6}", "5", 8, "node 2"),
        ("1: {}", "1.5: {}", 7, "nodes"),
        ("1: {}", "true: {}", 7, "nodes"),
        (
            "nodes:\n  1: {}\n  2: {a: 0.6}",
            "nodes: [{id: 1}, {id: 2}]",
            6,
            "nodes",
        ),
        ("1: {}", '"a b": {}', 7, "node a b"),
        ("2: {a: 0.6}", "2: {}\n  2: {}", 9, "nodes"),
        ("2: {a: 0.6}", '2: {}\n  "2": {}', 9, "nodes"),
        ("seed: 4", "b: 0.2", 4, ""),
        ("- [1, 2]", "- [1, 2, 1]", 10, "edge 1"),
        ("- [1, 2]", "- 5", 10, "edge 1"),
        ("- [1, 2]", "- '12'\n  - [1, 2]", 10, "edge 1"),
        ("- [1, 2]", "- [1, two]", 10, "edge 1"),
        ("edges:\n  - [1, 2]", "edges: 5", 9, "edges"),
        ("edges:\n  - [1, 2]", "edges: {x: {y: 1, y: 2}}", 9, "edges: x"),
        ("b: 0.1", "b: 0.5", 2, "b"),
    ],
)
def test_a_mistake_is_reported_at_its_place(old: str, new: str, line: int, place: str) -> None:
    """One change to a valid file; the message names line, place, value and fix."""
    assert old in GOOD
    found = problems(GOOD.replace(old, new))
    assert (line, place) in [(p.line, p.place) for p in found]


def test_a_node_with_too_many_neighbours_has_no_interval() -> None:
    """8 b² d >= 1 at the hub: the fix gives a suitable degree, and a suitable b."""
    problem = only(HEAD.replace("0.1", "0.25") + "nodes: [h, 1, 2]\nedges: [[h, 1], [h, 2]]\n")
    assert (problem.line, problem.place) == (4, "node h")
    assert "0.2499" in problem.cure
    assert "below 2" in problem.cure


def test_many_nodes_without_an_interval_are_one_problem_with_the_largest_b() -> None:
    nodes = "nodes: [1, 2, 3, 4]\nedges: [[1, 2], {ends: [2, 3], weight: 4}, [3, 4]]\n"
    problem = only(HEAD.replace("0.1", "0.25") + nodes)
    assert problem.place == "b"
    assert "2 nodes (2, 3)" in problem.what
    assert "0.1581" in problem.cure
    good(HEAD.replace("0.1", "0.1581") + nodes)
    assert "0.1581" in only(HEAD.replace("0.1", "0.1582") + nodes).cure


@pytest.mark.parametrize("wrong", ["nodes: 5", "nodes:", "nodes: []", "nodes: {}"])
def test_a_network_has_nodes(wrong: str) -> None:
    problem = only(HEAD + wrong)
    assert (problem.line, problem.place) == (4, "nodes")


@pytest.mark.parametrize(
    ("disturbance", "place"),
    [
        ("{kind: sinusoid, amplitude: 1}", "node 1: disturbance"),
        ("{kind: sinusoid, amplitude: 1, omega: 1, std: 1}", "node 1: disturbance"),
        ("[none, {kind: white, std: 1, sdt: 1}]", "node 1: disturbance: 1"),
        ("{kind: wave}", "node 1: disturbance: kind"),
        ("{value: 1}", "node 1: disturbance"),
        ("5", "node 1: disturbance"),
        ("{kind: constant, value: .inf}", "node 1: disturbance: value"),
        ("{kind: constant, value: -1e101}", "node 1: disturbance: value"),
        ("{kind: white, std: -1}", "node 1: disturbance: std"),
        ("{kind: white, std: {random: [-2, 1]}}", "node 1: disturbance: std: random: 0"),
        ("{kind: impulse, at: -1, value: 1}", "node 1: disturbance: at"),
        ("{kind: samples}", "node 1: disturbance"),
        ("{kind: samples, values: [1, 2]}", "node 1: disturbance"),
        ("[none, {kind: white, std: a}]", "node 1: disturbance: 1: std"),
        ("worst_case", "node 1: disturbance"),
    ],
)
def test_a_disturbance_can_be_wrong_too(disturbance: str, place: str) -> None:
    problem, *_ = problems(f"{HEAD}nodes:\n  1:\n    disturbance: {disturbance}\n")
    assert (problem.line, problem.place) == (6, place)


def test_the_network_or_its_nodes_have_disturbances() -> None:
    """`worst_case` replaces the disturbances of all nodes, so both together are a mistake."""
    own = "nodes: {1: {disturbance: {kind: constant, value: 1}}}\n"
    assert only(HEAD + own + "disturbance: worst_case\n").place == "node 1: disturbance"
    wrong = problems(HEAD + "nodes: [1]\ndisturbance: {kind: white}\n")
    assert wrong[0].place == "disturbance: kind"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (b"", 0),
        (b"# nothing\n\n# but comments\n", 0),
        (b"---\n", 0),
        (b"hello", 1),
        (b"- 1\n- 2\n", 1),
        (b"name: n\nb: [1, 2\nsteps: 3\n", 3),
        (b"name: n\nb: 'x\n", 2),
        (b"name: n\nnodes:\n\t- 1\n", 3),
        (b"name: n\n# caf\xe9\n", 2),
        ("name: n\n".encode("utf-16"), 1),
        (b"name: n\nb: 0.1\nsteps\0: 3\n", 3),
        (b"name: n\n\x07\n", 2),
        (b"name: n\n---\nname: m\n", 2),
        (b"name: n\nb: !!float 1\n", 2),
        (b"name: n\nb: !!python/object/apply:os.getcwd []\n", 2),
        (b"name: n\nnodes: !mine {}\n", 2),
        (b"name: *who\n", 1),
        (b"a: &a [*a]\n", 1),
        (b"{a: 1}: 2\n", 1),
        (b"a: 1\n.nan: 2\n", 2),
        (b"[" * 100_000, 1),
        (b"".join(b" " * k + b"a:\n" for k in range(40)), 33),
    ],
)
def test_a_text_that_is_not_a_topology_is_refused_with_its_line(text: bytes, line: int) -> None:
    problem = only(text)
    assert (problem.line, problem.code) == (line, Code.FILE_FORMAT)


def test_aliases_that_multiply_are_refused_before_they_fill_the_memory() -> None:
    """Ten aliases of ten aliases of ..: 200 bytes that would expand to 10^12 values."""
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    problem = only("\n".join(lines))
    assert problem.line == 7
    assert problem.code == Code.FILE_TOO_LARGE


def test_an_honest_alias_is_fine() -> None:
    """Two nodes may share an anchor's content."""
    nodes = "nodes:\n  1: &same {x0: 3, candidates: [0.4]}\n  2: *same\n"
    assert good(HEAD + nodes).nodes[2].x0 == 3.0


def test_the_file_of_a_name_that_does_not_exist() -> None:
    """A nearly right name gets the intended bundled name; any other gets all of them."""
    with refusal(Code.FILE_MISSING) as refused:
        load("papr7")
    assert "paper7?" in str(refused.value)
    with refusal(Code.FILE_MISSING):
        load("zzz.yaml")


@pytest.mark.parametrize("name", ["", "no\0good", "x" * 5000, "/dev/null"])
def test_names_that_can_be_no_topology(name: str) -> None:
    with pytest.raises(UserError):
        load(name)


def test_a_directory_is_no_topology_unless_it_is_the_folder_of_a_run(tmp_path: Path) -> None:
    with refusal(Code.FILE_MISSING):
        load(str(tmp_path))
    (tmp_path / "topology.yaml").write_text(GOOD)
    assert load(str(tmp_path)).name == "pair"


def test_a_file_of_100_mb_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(100 * 2**20)
    with refusal(Code.FILE_TOO_LARGE):
        load(str(path))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_that_may_not_be_read(tmp_path: Path) -> None:
    path = tmp_path / "secret.yaml"
    path.write_text(GOOD)
    path.chmod(0)
    with refusal(Code.FILE_UNREADABLE):
        load(str(path))


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with refusal(Code.FILE_NOT_REGULAR):
        load(str(tmp_path / "pipe"))


# Good files.


def test_nodes_are_a_list_or_a_mapping() -> None:
    """`[1, 2]`, `{1: {}, 2: {}}`, `{1:, 2:}` and quoted ids are the same network."""
    forms = ["[1, 2]", "{1: {}, 2: {}}", "{1: , 2: }", '["1", "2"]', '{"1": {}, "2": {}}']
    first, *others = [good(f"{HEAD}nodes: {form}\nedges: [[1, '2']]\n") for form in forms]
    assert first.ids == (1, 2)
    assert first.edges == ((1, 2),)
    assert all(other == first for other in others)


def test_no_is_a_name_and_1e_05_a_number() -> None:
    """YAML 1.1 would make a boolean of Norway, and text of 1e-05."""
    nodes = "nodes: [no, se, on, y]\nedges: [[no, se], [on, y]]\ndefaults: {x0: 1e-05}\n"
    topology = good(HEAD + nodes)
    assert topology.ids == ("no", "se", "on", "y")
    assert topology.defaults.x0 == 1e-05


@pytest.mark.parametrize("name", ["no", "08", "1e5", "1.5e3", "7.", "null", "0x1F", "1_000"])
def test_a_name_that_looks_like_something_else_survives_a_round_trip(name: str) -> None:
    """Quoted in the file, it must be quoted in the run's folder too."""
    node = name if name != "08" else "a08"
    text = f"name: '{name}'\nb: 0.1\nsteps: 3\nnodes: ['{node}', z]\nedges: [['{node}', z]]\n"
    topology = resolve(good(text))
    again = good(to_yaml(topology))
    assert (again.name, again.ids) == (name, (node, "z"))
    assert again == topology


def test_a_value_from_outside_the_file_has_no_line() -> None:
    """A mistake on the command line is not blamed on the file's line."""
    assert str(only(GOOD, "b=-1")) == "b: -1 is not above 0; choose a larger one"
    assert only(GOOD, "b=-1").line == 0


def test_overrides_replace_values_by_their_path() -> None:
    """Keys, list indices (from the end too) and node ids lead to a value; it is read as YAML."""
    overrides = (
        *("b=0.2", "law=hinf", "defaults.x0={random: [0, 1]}", "nodes.1.x0=7"),
        *("defaults.candidates.0=0.4", "defaults.candidates.-1=0.7", "nodes.2.a=0.7"),
        *("nodes.3.nominal=0.4", "edges.0=[2, 3]"),
    )
    topology = good(GOOD.replace("  2:", "  3: {}\n  2:"), *overrides)
    assert (topology.b, topology.law, topology.edges) == (0.2, "hinf", ((2, 3),))
    assert topology.defaults.candidates == (0.4, 0.7)
    assert (topology.nodes[1].x0, topology.nodes[3].nominal) == (7.0, 0.4)
    assert good(GOOD) == good(GOOD), "the file is read anew every time"


@pytest.mark.parametrize("nodes", ["[1, 2]", '{"1": {}, "2": {}}', "{1: {}, 2: {}}"])
def test_a_node_is_overridden_by_its_id_in_every_form_of_nodes(nodes: str) -> None:
    assert good(f"{HEAD}nodes: {nodes}\n", "nodes.2.x0=5").nodes[2].x0 == 5.0


def test_an_override_of_a_shared_anchor_changes_one_place() -> None:
    nodes = "nodes:\n  1: &same {x0: 3}\n  2: *same\n"
    topology = good(HEAD + nodes, "nodes.2.x0=4")
    assert (topology.nodes[1].x0, topology.nodes[2].x0) == (3.0, 4.0)


@pytest.mark.parametrize(
    ("override", "code"),
    [
        ("b", Code.OPTION),
        ("=3", Code.OPTION),
        ("b.c=3", Code.OPTION),
        ("nodes.9.x0=3", Code.OPTION),
        ("nodes.².x0=3", Code.OPTION),
        ("edges.5=[1, 2]", Code.OPTION),
        ("edges.--1=[1, 2]", Code.OPTION),
        ("b=[1", Code.FILE_FORMAT),
        ("bb=1", Code.TOPOLOGY),
        ("nodes.2.xo=1", Code.TOPOLOGY),
        ("name=\udcff", Code.OPTION),
        ("\udcff=1", Code.OPTION),
        ("nodes.2.a=0.5", Code.TOPOLOGY),
    ],
)
def test_overrides_that_lead_nowhere(override: str, code: Code) -> None:
    with refusal(code):
        parse(GOOD.encode(), "bad.yaml", Path(), [override])
