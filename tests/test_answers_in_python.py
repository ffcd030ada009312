"""A mistake in a call of Python is answered with the names of arguments, and never with a traceback of ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.orchestrator.experiments.compare import Compared
from hedgerow.orchestrator.metrics.summary import replaced
from hedgerow.orchestrator.network import Network
from hedgerow.orchestrator.runs.difference import explain_runs
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.testing import Networks
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.in_python import in_words_of_python
from hedgerow.topologies.load import load as read

EDGES = [("A", "B", 1.0), ("B", "C", 2.0)]
PAIR: dict[str, Any] = {"name": "pair", "b": 0.1, "steps": 9, "nodes": ["A", "B"], "edges": [["A", "B"]]}


@pytest.fixture(scope="module")
def net() -> Network:
    return hg.from_edges(EDGES, steps=5, seed=1)


@pytest.fixture(scope="module")
def run(net: Network, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return hg.simulate(net, run_dir=tmp_path_factory.mktemp("run") / "r")


@pytest.fixture(scope="module")
def compared(net: Network, tmp_path_factory: pytest.TempPathFactory) -> Compared:
    return hg.compare(net, disturbances="white", seeds=range(2), out=tmp_path_factory.mktemp("c") / "c")


ANY: Any = "yes"  # the type checker refuses these values too
CALLS: dict[str, tuple[Callable[[], object], Code, str]] = {
    "weight": (lambda: hg.from_edges(EDGES, weight="wheight"), Code.OPTION, "weight=wheight: "),
    "steps": (lambda: hg.from_edges(EDGES, steps="x"), Code.OPTION, "steps=x: "),
    "weights": (lambda: hg.from_edges(EDGES, weights=1), Code.OPTION, "weights: "),
    "storage": (lambda: hg.from_edges(EDGES, storage="c"), Code.FILE_FORMAT, "storage=c: "),
    "gain": (lambda: hg.from_edges(EDGES, b=3), Code.TOPOLOGY, "b=3: "),
    "file": (lambda: hg.from_edges("edges.csv"), Code.FILE_FORMAT, "the edges: "),
    "number": (lambda: hg.from_edges(3), Code.FILE_FORMAT, "the edges: "),
    "number in a list": (lambda: hg.from_edges([3]), Code.FILE_FORMAT, "the edges: "),
    "diagonal": (lambda: hg.from_adjacency(np.eye(3)), Code.FILE_FORMAT, "the matrix: "),
    "full": (lambda: hg.bound(PAIR, full=ANY), Code.OPTION, "full="),
    "faults": (lambda: hg.worst(PAIR, faults=ANY), Code.OPTION, "faults="),
    "budget": (lambda: hg.worst(PAIR, budget=-1), Code.OPTION, "budget=-1: "),
    "jobs": (lambda: hg.sweep(PAIR, seeds=range(2), jobs=-1), Code.OPTION, "jobs=-1: "),
    "disturbances": (lambda: hg.compare(PAIR, disturbances="whiet"), Code.OPTION, "disturbances=whiet: "),
    "override": (lambda: hg.load("paper7", b=-1), Code.TOPOLOGY, "b=-1: "),
    "setting": (lambda: hg.load("paper7", "nodes.99.x0=1"), Code.OPTION, "nodes.99.x0=1: "),
    "a dictionary": (lambda: hg.load({**PAIR, "b": -1}), Code.TOPOLOGY, "the network: b: "),
    "axes": (lambda: hg.Network(**PAIR).plot(ANY), Code.OPTION, "ax="),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_mistake_is_answered_with_its_argument(name: str) -> None:
    call, code, start = CALLS[name]
    with pytest.raises(UserError) as caught:
        call()
    assert caught.value.code == code
    assert str(caught.value).startswith(start)
    assert "--" not in str(caught.value)


@pytest.mark.parametrize("link", ["A", 3, ("A",), ("A", "C")])
def test_a_link_is_a_pair_of_neighbours(run: Run, link: Any) -> None:
    for asked in (run.missing, run.open):
        with pytest.raises(UserError) as caught:
            asked(link)
        assert caught.value.code == Code.OPTION


def test_estimates_are_asked_by_step(run: Run) -> None:
    with pytest.raises(UserError) as caught:
        run.estimates_at("A")  # type: ignore[arg-type]
    assert str(caught.value).startswith("t='A': ")


@pytest.mark.parametrize("names", [("minimx", "gain"), ("minimax", "gian"), ("minimax", "gain", "whiet")])
def test_an_unknown_mean_is_answered_with_the_known_names(compared: Compared, names: tuple[str, ...]) -> None:
    with pytest.raises(UserError) as caught:
        compared.mean(*names)
    assert caught.value.code == Code.OPTION
    assert any(known in str(caught.value) for known in ("minimax, ", "gain, ", "of white"))


def test_one_disturbance_needs_no_list(compared: Compared) -> None:
    assert compared.plan.disturbances == ["white"] or tuple(compared.plan.disturbances) == ("white",)
    assert compared.mean("minimax", "gain") == compared.mean("minimax", "gain", "white")


def test_a_network_without_a_file_has_no_lines() -> None:
    with pytest.raises(TopologyError) as caught:
        hg.Network(**{**PAIR, "b": -1, "nodes": {"A": {"x0": "many"}, "B": {}}})
    assert {(one.line, one.column) for one in caught.value.problems} == {(0, 0)}
    assert caught.value.count == 2


@pytest.mark.parametrize(
    ("text", "counted"),
    [
        ("name: n\nb: 0.1\nstep: 3\nnodes: [1, 2]\nedges: [[1, 2]]\n", 1),
        ("name: n\nb: 0.1\nstep: 3\nlaws: hinf\nnodes: [1, 2]\nedges: [[1, 2]]\n", 2),
        ("name: n\nb: 0.1\nzzz: 3\nnodes: [1, 2]\nedges: [[1, 2]]\n", 2),
    ],
)
def test_a_misspelled_key_is_one_mistake(text: str, counted: int) -> None:
    with pytest.raises(TopologyError) as caught:
        hg.load(text)
    assert caught.value.count == counted


def test_a_law_named_by_its_file_is_answered_with_its_module() -> None:
    with pytest.raises(TopologyError) as caught:
        read("paper7", ["law=/tmp/own/mylaw.py:Huber"])
    assert "write mylaw:Huber, and set PYTHONPATH=/tmp/own" in str(caught.value)


def test_a_truth_that_replaces_a_drawn_candidate_is_listed() -> None:
    text = (
        "name: n\nb: 0.1\nsteps: 3\ndefaults: {candidates: {random: 3}}\nnodes: {1: {a: 0.3}, 2: {}}\nedges: [[1, 2]]\n"
    )
    (line,) = replaced(hg.load(text).given_as.parse())  # type: ignore[attr-defined]
    assert "1 (0.3)" in line
    assert replaced(read("line5")) == []


def test_a_jump_is_answered_with_its_argument_and_the_near_candidate(network: Networks) -> None:
    candidates = hg.load("paper7").nodes[4].candidates
    assert isinstance(candidates, tuple)
    with pytest.raises(UserError) as caught:
        network("paper7").jump(4, at=3, to=candidates[0] + 1e-5)
    assert caught.value.code == Code.FAULT
    assert str(caught.value).startswith("jump: to: ")
    assert f"did you mean {candidates[0]!r}?" in str(caught.value)


def test_a_difference_names_the_cut_before_it(network: Networks) -> None:
    lines = explain_runs(network("paper7").cut((2, 4), steps=(3, 9)).run(), network("paper7").run())
    assert "cut 2-4" in lines[2]
    assert "cut" not in lines[3]


def test_a_run_that_does_not_exist_is_answered_with_the_number_of_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for k in range(9):
        (tmp_path / "runs" / f"r{k}").mkdir(parents=True)
    with pytest.raises(UserError) as caught:
        hg.load_run("nope")
    assert "and 3 more" in str(caught.value)


@pytest.mark.parametrize(
    ("option", "argument"),
    [
        ("--max-degree 0: is none", "max_degree=0: is none"),
        ("--set b=-1 --set x=2: b: wrong", "b=-1 x=2: b: wrong"),
        ("file: exists. Replace it with --force.", "file: exists. Replace it with force."),
        ("the node: wrong. Use --b 0.14, which fits.", "the node: wrong. Use b=0.14, which fits."),
        ("node --x--y: z", "node --x--y: z"),
        ("write `orchestrator up --rate 3`", "write `orchestrator up --rate 3`"),
    ],
)
def test_an_option_becomes_an_argument(option: str, argument: str) -> None:
    assert in_words_of_python(option) == argument
