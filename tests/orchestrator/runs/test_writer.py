"""The recorded part of a run: `record:` of a file selects the nodes and steps with rows, and changes nothing else.

all rows --+--> verdict, metrics, regret: of all nodes and steps, for any selection
           +--> summary.parquet: one row per step, of all nodes
           '--> telemetry, edges, run.rrd: the selected rows, with unchanged bits
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.runs.export import export
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.runs.selection import selection
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies import hinf
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.record import Record
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.test_faults import faulty
from tests.tools.networks import read
from tests.tools.processes import orchestrator, parquet_bytes

FAULTS = "faults=[{kind: drop, link: [2, 4], steps: [3, 9]}, {kind: cut, edge: [3, 5], steps: [5, 8]}]"


def ran(topology: Topology, folder: Path, record: Any = None) -> Verdict:
    if record is not None:
        topology = topology.model_copy(update={"record": Record.model_validate(record)})
    return simulate_into(topology, create(topology, folder), layout(topology, 1), Watching(record=False), Quiet())


def metrics_of(verdict: Verdict) -> dict[str, Any]:
    """All of a verdict but its name and how long it took."""
    return {
        key: value
        for key, value in verdict.content.items()
        if key not in ("run", "elapsed_s", "steps_per_s", "first_step_s")
    }


@st.composite
def records(draw: st.DrawFn, n: int) -> dict[str, Any]:
    nodes: Any = draw(st.one_of(st.just("all"), st.integers(0, n + 1), st.lists(st.integers(0, n - 1), max_size=n)))
    return {"every": draw(st.integers(1, 14)), "nodes": nodes, "summary": draw(st.booleans())}


@given(faulty(), st.data())
@settings(max_examples=25, deadline=None)
def test_the_recorded_part_changes_only_the_amount_of_data(topology: Topology, data: st.DataObject) -> None:
    """The verdict and its metrics are equal, and the recorded rows are those of the whole run, bit for bit."""
    n = len(topology.ids)
    record = data.draw(records(n))
    if isinstance(record["nodes"], list):
        record["nodes"] = [topology.ids[k] for k in record["nodes"]]
    with tempfile.TemporaryDirectory() as scratch:
        whole, some = Path(scratch) / "whole", Path(scratch) / "some"
        assert metrics_of(ran(topology, whole, {"nodes": "all"})) == metrics_of(ran(topology, some, record))
        what = selection(topology.model_copy(update={"record": Record.model_validate(record)}))
        T, ids = topology.steps, [topology.ids[k] for k in what.nodes]
        steps = [t for t in range(T) if t % record["every"] == 0 or t == T - 1]
        of_nodes = pl.read_parquet(whole / "telemetry.parquet")
        expected = of_nodes.filter(pl.col("step").is_in([*steps, T]) & pl.col("node").is_in(ids))
        assert pl.read_parquet(some / "telemetry.parquet").equals(expected)
        of_edges = pl.read_parquet(whole / "edges.parquet")
        at = pl.col("i").is_in(ids) | pl.col("j").is_in(ids)
        assert pl.read_parquet(some / "edges.parquet").equals(of_edges.filter(pl.col("step").is_in(steps) & at))
        assert (some / "summary.parquet").exists() == record["summary"]
        if record["summary"]:
            assert (some / "summary.parquet").read_bytes() == (whole / "summary.parquet").read_bytes()


def test_a_summary_is_the_sum_of_the_rows_of_all_nodes(tmp_path: Path) -> None:
    topology = read((load_text("paper7")), FAULTS)
    ran(topology, tmp_path / "run")
    run = load_run(tmp_path / "run")
    row = run.summary("polars").row(6, named=True)
    assert row["x_sum"] == pytest.approx(np.abs(run.x[6]).sum(), rel=1e-12)
    assert row["x_max"] == np.abs(run.x[6]).max()
    assert row["u_max"] == np.nanmax(np.abs(run.u[6]))
    assert row["regret_max"] == run.regret[6].max()
    assert (row["edges_cut"], row["messages_lost"], row["missing"]) == (1, 2, 0)
    assert row["right"] == (run.ahat[6] == run.a[6]).sum()
    last = run.summary("polars").row(-1, named=True)
    assert (last["step"], last["regret_sum"], last["cost"]) == (30, run.regret_sum[-1], None)


def load_text(name: str) -> str:
    return (Path(__file__).parents[3] / f"topologies/{name}.yaml").read_text(encoding="utf-8")


@pytest.fixture
def thin(tmp_path: Path) -> tuple[Run, Run]:
    """The same run, whole, and with every seventh step of two nodes."""
    topology = resolve(load("paper7"))
    ran(topology, tmp_path / "whole")
    ran(topology, tmp_path / "thin", {"every": 7, "nodes": [2, 6]})
    return load_run(tmp_path / "whole"), load_run(tmp_path / "thin")


def test_the_recorded_rows_are_read_and_the_sums_cover_all_nodes(thin: tuple[Run, Run]) -> None:
    whole, some = thin
    assert (some.T, some.ids) == (30, (2, 6))
    assert some.rows.tolist() == [0, 7, 14, 21, 28, 29, 30]
    columns = [whole.ids.index(2), whole.ids.index(6)]
    for name in ("x", "x_oracle", "regret"):
        assert np.array_equal(getattr(some, name)[some.rows], getattr(whole, name)[some.rows][:, columns])
    assert np.isnan(some.x[1]).all()
    for name in ("a", "candidates", "nominal"):
        value = getattr(whole, name)
        assert np.array_equal(getattr(some, name), value[:, columns] if name == "a" else value[columns], equal_nan=True)
    for name in ("cost", "cost_regret", "gain", "gain_less_x0", "right", "regret_sum", "nominal_regret_sum", "lost"):
        assert np.array_equal(getattr(some, name), getattr(whole, name), equal_nan=True), name
    assert some.metrics == whole.metrics
    named = whole.topology.edges
    touching = [edge for edge in named if {2, 6} & {*edge}]
    shown = [tuple(some.ids[k] if k >= 0 else None for k in pair) for pair in some.edges.tolist()]
    assert shown == [tuple(end if end in (2, 6) else None for end in edge) for edge in touching]


def test_an_array_that_needs_all_rows_explains_how_to_record_them(thin: tuple[Run, Run], tmp_path: Path) -> None:
    _, some = thin
    for needs_all in (lambda: some.a_ls, lambda: report([some], tmp_path / "report"), lambda: some.received):
        with pytest.raises(UserError) as raised:
            needs_all()
        assert raised.value.code == Code.NOT_RECORDED
    export(some, "npz", tmp_path / "some.npz")
    with np.load(tmp_path / "some.npz") as arrays:
        assert "a_ls" not in arrays
        assert arrays["regret_sum"][-1] == some.regret_sum[-1]
        assert arrays["rows"].tolist() == some.rows.tolist()


def test_a_run_can_be_recorded_fully_from_its_folder(here: Path) -> None:
    """The file of a run has the recorded part and the omitted part."""
    done = orchestrator(
        "simulate", "paper7", "--no-record", "--run-dir", "thin", "--set", "record={every: 7, nodes: 2}"
    )
    first, *_ = done.stdout.splitlines()
    assert first.startswith("recorded: every 7th step and the last of 2 of 7 nodes and their edges, and a summary")
    orchestrator("simulate", "paper7", "--no-record", "--run-dir", "whole")
    orchestrator("simulate", "thin", "--no-record", "--run-dir", "again")
    orchestrator("simulate", "thin", "--no-record", "--run-dir", "all", "--set", "record={nodes: all}")
    assert parquet_bytes(here / "again") == parquet_bytes(here / "thin") != parquet_bytes(here / "whole")
    assert parquet_bytes(here / "all") == parquet_bytes(here / "whole")


def test_a_network_of_processes_is_verified_at_all_nodes_though_few_have_rows(here: Path) -> None:
    """By the checksums of the summary; and a run of another seed has others at every step."""
    few = ("--set", "record={every: 10, nodes: 1}")
    up = orchestrator(
        "up", "grid16", "--processes", "2", "--steps", "40", "--viewer", "none", "--no-record", "--verify", *few
    )
    assert up.returncode == 0, up.stdout
    orchestrator("simulate", "grid16", "--steps", "40", "--no-record", "--run-dir", "other", "--seed", "77", *few)
    one, other = (
        pl.read_parquet(folder / "summary.parquet")["checksum"] for folder in (here / "runs/latest", here / "other")
    )
    assert (one[1:] != other[1:]).all()


def test_of_a_large_network_a_sample_has_rows(tmp_path: Path) -> None:
    """The file of the run names the sample, so a later version cannot choose another one."""
    text = "{name: n, b: 0.1, steps: 3, graph: {kind: ring, nodes: 10001}}"
    topology = read(text)
    assert topology.record == Record(nodes=1000)
    verdict = ran(topology, tmp_path / "run")
    assert verdict.verdict == "valid"
    assert pl.read_parquet(tmp_path / "run/telemetry.parquet").height == 4 * 1000
    assert "record: {nodes: 1000}" in (tmp_path / "run/topology.yaml").read_text()
    assert load_run(tmp_path / "run").regret_sum[-1] == verdict.content["metrics"]["regret"]
    assert read(text.replace("10001", "10000")).record == Record()
    assert read(text, "record.nodes=all").record == Record(nodes="all")


@pytest.mark.parametrize(
    ("override", "place"),
    [
        ("record={nodes: [1, 99]}", "record: nodes: 1"),
        ("record={nodes: some}", "record: nodes"),
        ("record={evry: 2}", "record"),
        ("record.every=0", "record: every"),
    ],
)
def test_mistakes_are_refused(override: str, place: str) -> None:
    with pytest.raises(TopologyError) as refused:
        load("paper7", [override])
    assert [problem.place for problem in refused.value.problems] == [place]


@pytest.mark.parametrize("kind", ["ring", "grid", "scale_free"])
def test_of_a_large_network_the_supply_is_known_from_both_sides(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """w'Q^-1 w by its factors is between the bounds of conjugate gradients, for noise and for a slow disturbance."""
    network = read(f"{{name: n, b: 0.1, steps: 1, graph: {{kind: {kind}, nodes: 600, max_degree: 9}}}}").network
    exact = hinf.supply_rate(network.a, network.b, network.graph)
    monkeypatch.setattr(hinf, "FACTORED", 500)
    near = hinf.supply_rate(network.a, network.b, network.graph)
    noise = np.random.default_rng(1)
    for t in range(8):
        w = noise.standard_normal(600) if t % 2 else np.sin(np.arange(600) + 0.01 * t)
        (value, _), (least, more) = exact(w), near(w)
        assert least <= value * (1 + 1e-12)
        assert value <= (least + more) * (1 + 1e-12)
        assert more <= hinf.SUPPLY_RTOL * least
    assert near(np.zeros(600)) == (0.0, 0.0)


def test_json_of_the_schema_knows_record() -> None:
    schema = json.loads(json.dumps(Topology.model_json_schema()))
    assert {*schema["$defs"]["Record"]["properties"]} == {"every", "nodes", "summary"}
