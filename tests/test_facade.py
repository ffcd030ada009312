"""The functions of `import hedgerow as hg`."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import itertools
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.orchestrator.experiments.compare import Compared
from hedgerow.orchestrator.experiments.worst import Found
from hedgerow.orchestrator.launch.running import Running
from hedgerow.orchestrator.metrics.guarantee import Guarantee
from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.orchestrator.runs.recorded import RecordedRows

PAIR = {"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}


def test_every_public_name_is_there_and_no_other() -> None:
    assert all(getattr(hg, name) is not None for name in hg.__all__)
    assert hg.__version__
    with pytest.raises(AttributeError):
        _ = hg.nothing


def test_the_import_loads_nothing() -> None:
    program = "import sys; import hedgerow; print({'numpy', 'pydantic', 'zenoh', 'typing'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-I", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("steps", [5, None])
def test_a_network_is_a_name_a_path_a_text_a_dictionary_or_a_topology(here: Path, steps: int | None) -> None:
    text = "{name: pair, b: 0.1, steps: 6, seed: 3, nodes: [p, q], edges: [[p, q]]}"
    Path("pair.yaml").write_text(text)
    overrides = {} if steps is None else {"steps": steps}
    loaded = [hg.load(one, **overrides) for one in ("pair.yaml", Path("pair.yaml"), text, PAIR, hg.load(PAIR))]
    assert all(one == loaded[0] for one in loaded)
    assert loaded[0].steps == (steps or 6)
    assert hg.load("paper7").name == "paper7"


def test_a_simulated_run_is_the_run_that_its_folder_holds(here: Path) -> None:
    run = hg.simulate(PAIR, run_dir="first", law="hinf")
    np.testing.assert_array_equal(run.x, hg.load_run("first").x)
    assert run.T == 6


def test_a_mistake_has_a_code(here: Path) -> None:
    with pytest.raises(hg.UserError):
        hg.load("nowhere.yaml")
    with pytest.raises(hg.TopologyError) as raised:
        hg.load(PAIR, b=2.0)
    assert raised.value.code in hg.Code


def test_a_file_that_no_command_reads_is_refused_here_as_well(here: Path) -> None:
    for load in (hg.load, hg.simulate):
        with pytest.raises(hg.UserError) as raised:
            load("/dev/zero")
        assert raised.value.code == hg.Code.FILE_NOT_REGULAR


def test_the_public_interface_is_this_and_no_more() -> None:
    """A new name is a promise: add it here, to the tables of docs/python.md, and to CHANGELOG.md."""
    assert hg.__all__ == [
        *("Code", "HedgerowError", "Law", "Live", "Minimax", "Network", "Run", "Topology", "TopologyError"),
        *("UserError", "bound", "compare", "from_adjacency", "from_edges", "from_networkx", "load", "load_run"),
        *("report", "run", "simulate", "start", "sweep", "testing", "worst"),
    ]
    page = Path(__file__).parents[1].joinpath("docs/python.md").read_text()
    documented = {name.rpartition(".")[2] for name in re.findall(r"auto\w+:: ([\w.]+)", page)}
    assert documented == {*hg.__all__, "check_law"} - {"testing"}


def test_every_public_attribute_has_a_docstring() -> None:
    for name in hg.__all__:
        public = getattr(hg, name)
        assert inspect.getdoc(public), name
        for attribute in vars(public) if inspect.isclass(public) and public is not hg.Code else ():
            member = inspect.getattr_static(public, attribute)
            if not attribute.startswith("_") and (callable(member) or isinstance(member, property)):
                assert inspect.getdoc(member), f"{name}.{attribute}"


def stored(public: type) -> Iterator[tuple[str, str, str]]:
    """Yield every public attribute that a class stores, with its annotation and the text that follows it."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(public))).body
    assert isinstance(tree, ast.ClassDef)
    blocks = [tree.body, *(inner.body for inner in tree.body if isinstance(inner, ast.FunctionDef))]
    for statement, after in itertools.chain.from_iterable(itertools.pairwise([*block, ast.Pass()]) for block in blocks):
        if not isinstance(statement, ast.Assign | ast.AnnAssign):
            continue
        for target in statement.targets if isinstance(statement, ast.Assign) else [statement.target]:
            own = isinstance(target, ast.Name) if statement in tree.body else ast.unparse(target).startswith("self.")
            name = ast.unparse(target).removeprefix("self.")
            if own and not name.startswith("_") and "." not in name:
                text = after.value if isinstance(after, ast.Expr) else None
                annotation = ast.unparse(statement.annotation) if isinstance(statement, ast.AnnAssign) else ""
                yield name, annotation, str(text.value) if isinstance(text, ast.Constant) else ""


@pytest.mark.parametrize(
    "public", [hg.Run, RecordedRows, hg.Network, hg.Live, Running, Verdict, Compared, Found, Guarantee]
)
def test_every_stored_attribute_has_a_docstring(public: type) -> None:
    assert not [name for name, _, text in stored(public) if not text]


def test_every_array_of_a_run_has_its_shape() -> None:
    for name, member in (vars(RecordedRows) | vars(hg.Run)).items():
        if isinstance(member, cached_property | property) and not name.startswith("_"):
            read: Any = member.func if isinstance(member, cached_property) else member.fget
            kind = str(inspect.signature(read).return_annotation)
            if kind.startswith(("Array", "Mask", "Index", "NDArray", "Gain")):
                assert re.search(r"\((n|E|K|L|T|2E|,|\+|\s|1|2|M)+\)", inspect.getdoc(member) or ""), name
    flags = {"x", "u", "w", "edge_open", "a_ls", "cost"}
    texts = {name: text for name, _, text in stored(hg.Run)}
    assert flags <= {name for name, text in texts.items() if re.search(r"\(T( \+ 1)?, ?(n|E)?\)", text)}


def test_settings_are_those_of_the_command_line(here: Path) -> None:
    assert hg.load(PAIR, "nodes.p.x0=2", steps=4).nodes["p"].x0 == 2.0
    assert hg.simulate(PAIR, "defaults.x0=2", steps=4).x[0].tolist() == [2.0, 2.0]


STILL = """from hedgerow.agents.law import Minimax


class Still(Minimax):
    def __init__(self, b, candidates, *, share=0.0):
        super().__init__(b, candidates)
        self.share = share

    def act(self, x):
        return self.share * x
"""


def test_a_law_is_a_name_or_a_class(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("still.py").write_text(STILL)
    monkeypatch.syspath_prepend(here)
    Still = importlib.import_module("still").Still
    assert hg.load(PAIR, law=hg.Minimax).law == "minimax"
    still = hg.simulate(PAIR, "defaults.x0=1", law=Still)
    assert not still.u.any()
    assert hg.run(PAIR, "defaults.x0=1", law=Still) == still
    assert hg.simulate(PAIR, "defaults.x0=1", law=functools.partial(Still, share=0.5)).u.any()


def test_a_law_of_the_main_program_cannot_go_to_another_process(here: Path) -> None:
    Path("mine.py").write_text(
        "import hedgerow as hg\nclass Mine(hg.Minimax): pass\n"
        "assert hg.simulate('paper7', law=Mine, steps=5).T == 5\n"
        "try:\n    hg.run('paper7', law=Mine)\nexcept hg.UserError as error:\n    print(error.code.value)\n"
    )
    done = subprocess.run([sys.executable, "mine.py"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [hg.Code.LAW.value]


def test_processes_over_zenoh_give_the_simulated_run(here: Path) -> None:
    run = hg.run(PAIR, processes=1, verify=True)
    assert run.verdict.verdict == "valid"
    assert run.verdict.content["processes"] == 1
    assert run == hg.simulate(PAIR) == hg.load_run(run.folder)
    assert Path("runs").resolve() == run.folder.parent


def test_a_started_network_is_controlled_and_stopped(here: Path) -> None:
    with hg.start("paper7", rate=200, steps=100_000) as live:
        lost = live.fault.drop((2, 4), steps=range(10))
        live.wait_for_step(lost.step + 20)
        run = live.stop()
    assert isinstance(live, hg.Live)
    assert run.missing((2, 4)) == list(range(lost.step, lost.step + 10))
    assert run.verdict.verdict == "unknown"


def test_a_network_that_does_not_start_leaves_no_folder(here: Path) -> None:
    with pytest.raises(hg.UserError), hg.start(PAIR, viewer="nowhere"):
        pass
    with pytest.raises(hg.UserError):
        hg.run(PAIR, viewer="nowhere")
    assert not [*Path("runs").iterdir()]


def test_a_sweep_is_a_table_of_its_runs(here: Path) -> None:
    table = hg.sweep(PAIR, seeds=range(3), law=["minimax", "nominal"], jobs=1, out="swept")
    assert table.num_rows == 6
    assert set(table["verdict"].to_pylist()) == {"valid"}
    assert set(table["law"].to_pylist()) == {"minimax", "nominal"}
    with pytest.raises(hg.UserError):
        hg.sweep(PAIR, seeds=range(0, 9, 2))


def test_a_report_is_of_a_run_or_of_its_name(here: Path) -> None:
    run = hg.simulate(PAIR, run_dir="first")
    page, *figures = hg.report(run, "figures", figures="2", formats=["png"])
    assert (page.name, len(figures)) == ("report.html", 1)
    assert hg.report("first", "again", figures="2", formats=["png"])[1].read_bytes() == figures[0].read_bytes()


def test_a_run_is_short_in_a_message_and_draws_itself(here: Path) -> None:
    run = hg.simulate(PAIR, run_dir="first")
    assert repr(run) == "<Run first: 6 steps of 2 nodes, valid>"
    figure = run.plot("x", "regret", "gain")
    assert [len(axis.lines) for axis in figure.axes] == [2, 2, 1]
    for wrong in ("nothing", "ids", "_lost", "topology"):
        with pytest.raises(hg.UserError):
            run.plot(wrong)
