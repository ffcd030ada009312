"""Public networks that packages of PyPI ship: each becomes a valid topology that runs, or is refused with a fix.

The readers of water and power networks are extras. A test is skipped if its reader is not installed, and fails if the
environment variable HEDGEROW_READERS is set.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest

import hedgerow as hg
from hedgerow.topologies.hinf import condition_holds
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.written import Imported, import_file
from hedgerow.topologies.schema import Topology
from tests.tools.importing import edges_of, needs, shipped
from tests.tools.refusals import refusal

WATER = ("Net1", "Net2", "Net3", "ky4")
BACKBONES = ("sndlib/nobel-eu", "sndlib/germany50", "topozoo/Abilene")
GRIDS = ("case9", "case14", "case_ieee30", "case39", "case57", "case118")


def water(name: str) -> Path:
    return shipped("wntr", "library", "networks", f"{name}.inp")


def grid(name: str) -> Path:
    return shipped("pandapower", "networks", "power_system_test_case_jsons", f"{name}.json")


def checked(found: Imported) -> Topology:
    """Save, load and run a network; its intervals are not empty, and every check of the run holds."""
    path = Path("network.yaml")
    found.save(path, force=True)
    topology = hg.load(path)
    network = topology.network
    assert condition_holds(network.candidates, network.b, network.graph.weighted_degree).all()
    run = hg.simulate(path, steps=min(20, topology.steps))
    assert run.x.shape[0] == 1 + min(20, topology.steps)
    assert np.isfinite(run.x).all()
    return topology


@pytest.mark.parametrize(
    "make", [nx.karate_club_graph, nx.les_miserables_graph, nx.florentine_families_graph, nx.davis_southern_women_graph]
)
def test_a_network_of_networkx(make: Any, here: Path) -> None:
    graph = make()
    graph.graph.clear()  # GraphML has no lists
    nx.write_graphml(graph, "g.graphml")
    found = import_file(Path("g.graphml"), Options())
    topology = checked(found)
    assert len(topology.ids) == len(graph)
    edges = {frozenset(map(str, (i, j))): own.get("weight", 1) for i, j, own in graph.edges(data=True)}
    network = topology.network
    names = [network.name(k) for k in range(len(graph))]
    weights = np.ones(len(edges)) if network.graph.weights is None else network.graph.weights
    ends = [frozenset((names[i], names[j])) for i, j in network.graph.edges.tolist()]
    assert dict(zip(ends, weights.tolist(), strict=True)) == edges


@pytest.mark.parametrize("name", BACKBONES)
def test_a_backbone_of_topohub(name: str, here: Path) -> None:
    path = shipped("topohub", "data", f"{name}.json")
    content = json.loads(path.read_text())
    topology = checked(import_file(path, Options(weight="dist")))
    network = topology.network
    labels = {node["id"]: node["name"] for node in content["nodes"]}
    assert len(set(labels.values())) == len(labels)
    assert network.positions is not None
    assert {network.name(k): tuple(network.positions[k]) for k in range(len(labels))} == {
        node["name"]: tuple(node["pos"]) for node in content["nodes"]
    }
    assert network.graph.weights is not None
    ends = [frozenset(map(network.name, edge)) for edge in network.graph.edges.tolist()]
    assert dict(zip(ends, network.graph.weights.tolist(), strict=True)) == {
        frozenset((labels[edge["source"]], labels[edge["target"]])): edge["dist"] for edge in content["edges"]
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", WATER)
@pytest.mark.filterwarnings("default")
def test_a_water_network(name: str, here: Path) -> None:
    found = import_file(water(name), Options(steps=30))
    topology = checked(found)
    import wntr  # noqa: PLC0415

    model = wntr.network.WaterNetworkModel(str(water(name)))
    areas = {tank: math.pi * model.get_node(tank).diameter ** 2 / 4 for tank in model.tank_name_list}
    b = dict(zip(map(str, topology.ids), topology.network.b, strict=True))  # type: ignore[arg-type]
    found_areas = {tank: 1 / b[tank] ** 2 for tank in areas if tank in b}
    assert found_areas
    assert found_areas == pytest.approx({tank: areas[tank] for tank in found_areas})
    assert topology.network.positions is not None


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_pipe_has_the_conductance_of_the_hydraulic_state(here: Path) -> None:
    import_file(water("Net1"), Options(steps=10, time_step=2.0)).save(Path("net.yaml"))
    import wntr  # noqa: PLC0415

    model = wntr.network.WaterNetworkModel(str(water("Net1")))
    model.options.time.duration = 0
    results = wntr.sim.WNTRSimulator(model).run_sim()
    flow, head = results.link["flowrate"].iloc[0], results.node["head"].iloc[0]
    edges = edges_of(hg.Network.of("net.yaml"))
    compared = 0
    for name, pipe in model.pipes():
        edge = frozenset(map(int, (pipe.start_node_name, pipe.end_node_name)))
        if edge in edges and abs(flow[name]) / (math.pi * pipe.diameter**2 / 4) > 0.01:
            drop = abs(head[pipe.start_node_name] - head[pipe.end_node_name])
            assert edges[edge] == pytest.approx(2.0 * abs(flow[name]) / (1.852 * drop), rel=1e-9)
            compared += 1
    assert compared >= 5


@pytest.mark.filterwarnings("default")
def test_a_time_step_that_is_too_long_is_refused_and_the_one_of_the_message_holds(here: Path) -> None:
    with pytest.raises(hg.UserError) as raised:
        import_file(water("Net1"), Options(time_step=3600.0))
    assert raised.value.code == hg.Code.TOPOLOGY
    cure = float(str(raised.value).split("--time-step ")[-1].split(",")[0])
    assert checked(import_file(water("Net1"), Options(time_step=cure, steps=5))).steps == 5
    with pytest.raises(hg.UserError) as raised:
        import_file(water("Net1"), Options(leak=0.01))
    assert raised.value.code == hg.Code.TOPOLOGY
    rate = 2 * float(str(raised.value).split("--leak above ")[-1].split(",")[0])
    topology = checked(import_file(water("Net1"), Options(leak=rate, time_step=cure / 100, steps=5)))
    assert topology.network.a[0] == pytest.approx(math.exp(-rate / 3600 * cure / 100))


@pytest.mark.slow
@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.filterwarnings("default")
def test_a_grid_of_pandapower(name: str, here: Path) -> None:
    topology = checked(import_file(grid(name), Options()))
    import pandapower  # noqa: PLC0415

    net = pandapower.from_json(str(grid(name)))
    edges = edges_of(hg.Network.of("network.yaml"))
    network = topology.network
    places = {network.ids[k]: k for k in range(len(network.ids))}
    assert len(places) == len(net.bus)
    names = {index: network.ids[k] for k, index in enumerate(net.bus.index)}
    twins = net.line.groupby(["from_bus", "to_bus"]).size()
    compared = 0
    for line in net.line.itertuples():
        if line.in_service and twins[line.from_bus, line.to_bus] == 1 and (line.to_bus, line.from_bus) not in twins:
            ohm = line.x_ohm_per_km * line.length_km / line.parallel
            per_unit = ohm / (net.bus.vn_kv[line.from_bus] ** 2 / net.sn_mva)
            assert edges[frozenset((names[line.from_bus], names[line.to_bus]))] == pytest.approx(1 / per_unit)
            compared += 1
    assert compared >= 5


@pytest.mark.filterwarnings("default")
def test_a_case_of_matpower_has_susceptances_and_a_storage_by_its_demand(here: Path) -> None:
    needs("matpowercaseframes")
    Path("pair.m").write_text(
        "function mpc = pair\nmpc.version = '2';\nmpc.baseMVA = 100;\n"
        "mpc.bus = [\n1 3 40 0 0 0 1 1 0 345 1 1.1 0.9;\n2 1 90 30 0 0 1 1 0 345 1 1.1 0.9;\n"
        "7 1 0 0 0 0 1 1 0 345 1 1.1 0.9;\n];\n"
        "mpc.gen = [\n1 70 0 300 -300 1 100 1 250 10 0 0 0 0 0 0 0 0 0 0 0;\n];\n"
        "mpc.branch = [\n1 2 0 0.05 0 250 250 250 0 0 1 -360 360;\n2 7 0 0.2 0 250 250 250 0.5 0 1 -360 360;\n"
        "1 7 0 0.1 0 250 250 250 0 0 0 -360 360;\n];\n"
    )
    topology = checked(import_file(Path("pair.m"), Options(storage="PD", junction_storage=10.0)))
    edges = edges_of(hg.Network.of("network.yaml"))
    assert edges == {frozenset((1, 2)): pytest.approx(20.0), frozenset((2, 7)): pytest.approx(10.0)}
    b = np.asarray(topology.network.b)
    np.testing.assert_allclose(b / b[0], np.sqrt([1, 40 / 90, 40 / 10]))
    from matpowercaseframes import CaseFrames  # noqa: PLC0415

    assert edges[frozenset((1, 2))] == pytest.approx(1 / CaseFrames("pair.m").branch["BR_X"].iloc[0])


@pytest.mark.filterwarnings("default")
def test_a_series_capacitor_is_refused_by_name(here: Path) -> None:
    import scipy.io  # noqa: PLC0415

    bus = np.array([[k, 1, 0, 0, 0, 0, 1, 1, 0, 345] for k in (1, 2)], dtype=float)
    branch = np.array([[1, 2, 0, -0.02, 0, 0, 0, 0, 0, 0, 1]], dtype=float)
    scipy.io.savemat("c.mat", {"mpc": {"bus": bus, "branch": branch}})
    with refusal(hg.Code.FILE_FORMAT):
        import_file(Path("c.mat"), Options())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["case9", "case300", "case2383wp"])
@pytest.mark.filterwarnings("default")
def test_a_case_that_matpower_ships(name: str, here: Path) -> None:
    path = shipped("matpower", "data", f"{name}.m")
    if name == "case300":  # it has branches of negative reactance
        with refusal(hg.Code.FILE_FORMAT):
            import_file(path, Options())
        return
    topology = checked(import_file(path, Options()))
    from matpowercaseframes import CaseFrames  # noqa: PLC0415

    case = CaseFrames(str(path))
    first = case.branch.iloc[0]
    i, j = (topology.position(int(first[end])) for end in ("F_BUS", "T_BUS"))
    weights = topology.graph.weights
    assert weights is not None
    found = [w for w, edge in zip(weights, topology.graph.edges.tolist(), strict=True) if set(edge) == {i, j}]
    assert found[0] >= 1 / (first["BR_X"] * (first["TAP"] or 1.0)) - 1e-9
