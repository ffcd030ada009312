"""Water networks: EPANET files, .inp, which wntr reads; it also computes their initial hydraulic state.

The state of a node is x_i = sqrt(c_i) h_i, with the head h_i [m] above the operating point and the storage c_i [m^2],
the area of its water. The balance is c_i dh_i/dt = -leak c_i h_i + sum_j k_ij (u_i - u_j) - (demand above the operating
point). A step of dt seconds makes (1) from it, with b_i = 1/sqrt(c_i), weights k_ij dt [m^2] and a = exp(-leak dt).
"""

from __future__ import annotations

import math
import tempfile
import warnings
from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hedgerow.topologies.errors import Code
from hedgerow.topologies.graph import Array, Index, weighted_sums
from hedgerow.topologies.hinf import satisfies_condition
from hedgerow.topologies.importing.found import Found, pairs, places, refuse
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.power import missing
from hedgerow.topologies.regular_file import read_regular

if TYPE_CHECKING:
    import wntr

GROWTH = 60
"""the memory per byte of a file"""
JUNCTION_STORAGE = 100.0
"""c_i of a junction [m^2]: a file has none"""
SLOWEST = 0.01
"""minimum velocity [m/s] for the linearisation of a pipe: without flow, its conductance would be unbounded"""
STIFF = 100
"""two nodes are merged if the link between them conducts this many times the median"""
SHARE = 0.5
"""the maximum of 8 dt d_i/c_i with the default time step; condition (3) needs less than 1"""
MOST_STEPS = 2000
"""the maximum number of steps of a default run"""


def read(path: Path, options: Options) -> Found:
    """Return the network of an EPANET file at its operating point, the hydraulic state at its start."""
    read_regular(path, growth=GROWTH)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import wntr  # noqa: PLC0415 (some seconds)
    except ImportError:
        raise missing("wntr", "water") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = wntr.network.WaterNetworkModel(str(path))
    except Exception as error:  # wntr passes on the errors of its parser
        text = " ".join(str(error).split())[:200]
        raise refuse(path, f"wntr cannot read it: {text}", "Check it in EPANET") from None
    if not model.num_junctions + model.num_tanks:
        raise refuse(path, "has no junctions and no tanks", "Name a file that holds a network")
    demand = _demand(model)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.options.time.duration = 0
            results = _simulated(model)
    except Exception as error:  # the simulation does not converge, or the model has no source
        raise refuse(path, f"wntr cannot simulate its start: {str(error)[:200]}", "Check it in EPANET") from None
    return _Reading(path, model, results, demand, options).found()


def _simulated(model: wntr.network.WaterNetworkModel) -> Any:
    """Return the hydraulic state at the start, by wntr, or by its EPANET for what wntr cannot simulate."""
    import wntr  # noqa: PLC0415

    try:
        results = wntr.sim.WNTRSimulator(model).run_sim()
        if len(results.link["flowrate"]):
            return results
        # wntr does not converge, and reports this as a warning and no rows. EPANET may find the state.
    except NotImplementedError:  # Darcy-Weisbach head losses, and general-purpose valves
        pass
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        results = wntr.sim.EpanetSimulator(model).run_sim(file_prefix=f"{folder}/start")
    if not len(results.link["flowrate"]):
        raise ValueError("the hydraulic state does not converge")
    return results


def _demand(model: wntr.network.WaterNetworkModel) -> tuple[Array, Any]:
    """Return the times [s] and the demands [m^3/s] of all junctions by the patterns of the file, one column each."""
    import wntr  # noqa: PLC0415

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frame = wntr.metrics.expected_demand(model)
    return np.asarray(frame.index, dtype=float), frame


class _Reading:
    """The numbers of one EPANET file."""

    def __init__(self, path: Path, model: Any, results: Any, demand: tuple[Array, Any], options: Options) -> None:
        self._path, self._model, self._options = path, model, options
        self._times, self._demand = demand
        self._flow = results.link["flowrate"].iloc[0]
        self._head = results.node["head"].iloc[0]
        self._changes: list[str] = []
        self._facts: list[str] = []
        self._assumptions: list[str] = []

    def found(self) -> Found:
        model, options = self._model, self._options
        names: list[Hashable] = [*model.junction_name_list, *model.tank_name_list]
        reservoirs = model.reservoir_name_list
        if options.reservoirs is not None:
            names += reservoirs
            self._assumptions.append(f"A reservoir is a node with the storage {options.reservoirs:g} m²")
        elif reservoirs:
            self._changes.append(
                f"{len(reservoirs)} reservoir{'s' if len(reservoirs) > 1 else ''} dropped with the links to them: a "
                "fixed head is a boundary, and its inflow is part of the operating point"
            )
        ends, conductance, links = self._links(set(names))
        place = {name: k for k, name in enumerate(names)}
        edges = pairs([(place[i], place[j]) for i, j in ends])
        storage, demand = self._storage(names), self._demands(names)
        home, left = self._joined(names, edges, conductance)
        # The storage of a junction is assumed. Beside a tank, the area of the tank is the only known storage.
        tank = np.array([self._model.get_node(str(name)).node_type == "Tank" for name in names])
        tanks = weighted_sums(home, np.where(tank, storage, 0.0), len(left))
        storage = np.where(tanks > 0, tanks, weighted_sums(home, storage, len(left)))
        names = [names[k] for k in left]
        demand = np.stack([weighted_sums(home, row, len(left)) for row in demand])
        apart = np.flatnonzero(home[edges[:, 0]] != home[edges[:, 1]])
        edges, conductance, links = home[edges[apart]], conductance[apart], [links[k] for k in apart]
        load = np.bincount(edges.ravel(), np.repeat(conductance, 2), len(names)) / storage
        step = self._time_step(names, load)
        a = self._a(names, load, step)
        steps = options.steps or int(min(MOST_STEPS, max(1, math.ceil(self._times[-1] / step))))
        samples = self._samples(demand, storage, step, steps)
        return Found(
            source=str(self._path),
            names=names,
            edges=edges,
            labels=None,
            positions=places([self._place(str(name)) for name in names]),
            weights=conductance * step,
            storage=storage,
            a=a,
            b=1.0,
            samples=samples,
            steps=steps,
            edge_names=links,
            facts=self._facts,
            assumptions=self._assumptions,
            changes=self._changes,
        )

    def _place(self, name: str) -> tuple[float, float] | None:
        found = self._model.get_node(name).coordinates
        return None if found is None else (float(found[0]), float(found[1]))

    def _storage(self, names: list[Hashable]) -> Array:
        """Return c_i [m^2]: the area of a tank, and the given storage of a junction."""
        options, model = self._options, self._model
        junction = options.junction_storage or JUNCTION_STORAGE
        storage = np.full(len(names), junction)
        self._assumptions.append(
            f"A junction has the storage {junction:g} m²"
            + (" (--junction-storage): the file has none" if options.junction_storage is None else ", as given")
        )
        for k, name in enumerate(names):
            node = model.get_node(str(name))
            if node.node_type == "Tank":
                storage[k] = math.pi * node.diameter**2 / 4
            elif node.node_type == "Reservoir":
                storage[k] = options.reservoirs
        if model.num_tanks:
            self._facts.append("The storage of a tank is its area π D²/4 [m²]; tanks with a volume curve have D too")
        return storage

    def _links(self, names: set[Hashable]) -> tuple[list[tuple[str, str]], Array, list[str]]:
        """Return the ends, the conductance [m^2/s] and the names of all links that can carry flow between the nodes."""
        ends, conductance, links = [], [], []
        closed = 0
        for name, link in self._model.links():
            i, j = link.start_node_name, link.end_node_name
            if i not in names or j not in names:
                continue
            k = self._conductance(name, link)
            if k is None:
                closed += 1
                continue
            ends.append((i, j))
            conductance.append(k)
            links.append(f"{link.link_type.lower()} {name}")
        if closed:
            self._changes.append(f"{closed} closed link{'s' if closed > 1 else ''} dropped: closed at the start")
        self._facts += [
            "The weight of a pipe is its conductance k = dq/dh at the operating point, the hydraulic state at the "
            "start of the file that wntr computes, times the time step [m²]",
        ]
        self._assumptions.append(
            f"Pipes slower than {SLOWEST:g} m/s are linearised at that velocity: without flow, dq/dh has no bound"
        )
        return ends, np.array(conductance), links

    def _conductance(self, name: str, link: Any) -> float | None:
        """Return dq/dh of an open link at the operating point, or None for a closed one."""
        q = abs(float(self._flow[name]))
        drop = abs(float(self._head[link.start_node_name] - self._head[link.end_node_name]))
        if link.link_type == "Pipe":
            if q < 1e-10 and str(link.status) in ("Closed", "0", "LinkStatus.Closed"):
                return None
            power = 1.852 if self._model.options.hydraulic.headloss == "H-W" else 2.0
            slow = SLOWEST * math.pi * link.diameter**2 / 4
            if q >= slow and drop > 0:
                return q / (power * drop)
            # h = r q^power, by the roughness of the file.
            return float(slow / (power * _head_loss(link, slow, power)))
        if q < 1e-10 or drop <= 0:
            return None
        if link.link_type == "Pump" and link.pump_type == "HEAD":
            _, slope, exponent = link.get_head_curve_coefficients()
            return float(1 / (slope * exponent * q ** (exponent - 1)))
        # A valve loses head with q^2; a pump of constant power adds it with 1/q.
        return q / drop if link.link_type == "Pump" else q / (2 * drop)

    def _time_step(self, names: list[Hashable], load: Array) -> float:
        """Return dt [s]; raise UserError with a suitable value if, with the given one, no a satisfies (3) at a node.

        load: d_i/c_i [1/s], (n,).
        """
        worst = int(load.argmax())
        bound = 1 / (8 * load[worst]) if load[worst] > 0 else 3600.0
        fits = _two_digits(SHARE * bound)
        given = self._options.time_step
        if given is None:
            self._assumptions.append(
                f"The time step is {fits:g} s: half of what condition (3) allows at {names[worst]}, the stiffest node"
            )
            return fits
        if given >= bound:
            raise refuse(
                f"--time-step {given:g}",
                f"no a satisfies condition (3) at node {names[worst]}: 8 dt d/c = {8 * given * load[worst]:.4g} is not "
                f"below 1",
                f"Use --time-step {fits:g}, or a larger --junction-storage",
                Code.TOPOLOGY,
            )
        self._assumptions.append(f"The time step is {given:g} s, as given")
        return given

    def _a(self, names: list[Hashable], load: Array, step: float) -> float | None:
        """Return a = exp(-leak dt), or None if no leak is given; raise UserError if it breaks (3) at a node."""
        leak = self._options.leak
        if leak is None:
            self._assumptions.append("The true a of each node is drawn: a file has no leak; --leak gives one")
            return None
        rate, worst = leak / 3600, float(load.max())
        a = math.exp(-rate * step)
        if not satisfies_condition(a, 1.0, worst * step):
            node = names[int(load.argmax())]
            fits = _fitting_step(rate, worst)
            cure = (
                f"Use --time-step {fits:g}"
                if fits
                else f"No time step would do: use a --leak above {_two_digits(2 * worst * 3600 * 1.1):g}, or a larger "
                "--junction-storage"
            )
            raise refuse(
                f"--leak {leak:g}",
                f"a = exp(-leak dt) = {a:.6g} breaks condition (3) at node {node}: a² + 2 dt d/c = "
                f"{a * a + 2 * step * worst:.6g} is not below a",
                cure,
                Code.TOPOLOGY,
            )
        self._facts.append(f"a = exp(-leak dt) = {a:.6g}, for a leak of {leak:g} per hour")
        return a

    def _demands(self, names: list[Hashable]) -> Array:
        """Return the demands of all nodes [m^3/s], one row per time of the patterns."""
        demand = np.zeros((len(self._times), len(names)))
        for k, name in enumerate(names):
            if name in self._demand:
                demand[:, k] = self._demand[name]
        return demand

    def _joined(self, names: list[Hashable], edges: Index, conductance: Array) -> tuple[Index, Index]:
        """Return the new node of each node, (n,), and the nodes that give the new nodes their names.

        Two nodes are merged if the link between them conducts so well that both have one head.
        """
        from scipy.sparse import coo_array  # noqa: PLC0415 (half a second to load)
        from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

        n = len(names)
        bound = STIFF * float(np.median(conductance)) if len(conductance) else math.inf
        stiff = edges[conductance > bound]
        matrix = coo_array((np.ones(len(stiff), np.int8), (stiff[:, 0], stiff[:, 1])), shape=(n, n))
        _, piece = connected_components(matrix, directed=False)
        # A tank gives its name to its merged node; otherwise the first node does. Keep the order of the file.
        rank = np.lexsort((np.arange(n), [self._model.get_node(str(name)).node_type != "Tank" for name in names]))
        _, first = np.unique(piece[rank], return_index=True)
        left = np.sort(rank[first])
        number = np.empty(len(left), dtype=np.int64)
        number[piece[left]] = np.arange(len(left))
        if joined := n - len(left):
            self._changes.append(
                f"{joined} node{'s' if joined > 1 else ''} joined with a neighbour, the storage of junctions and the "
                f"demands added: the link between them conducts more than {STIFF} times the median, {bound:.3g} m²/s, "
                "so that both have one head"
            )
        return number[piece], left

    def _samples(self, demand: Array, storage: Array, step: float, steps: int) -> Array | None:
        """Return w_i(t) = -(demand above that of the operating point) dt/sqrt(c_i), (n, T); None if it is always 0."""
        hours = self._times[-1] / 3600
        at = np.minimum(np.searchsorted(self._times, np.arange(steps) * step, side="right") - 1, len(self._times) - 1)
        values = -((demand[at] - demand[0]) * step / np.sqrt(storage)).T
        self._facts.append(
            "The disturbance of a junction is its demand above that of the start, by the patterns of the file: "
            f"{steps} steps are {steps * step / 3600:.3g} of {hours:.3g} h"
        )
        if not values.any():
            self._assumptions.append("No demand changes within these steps: the disturbance is 0")
            return None
        return np.ascontiguousarray(values)


def _head_loss(pipe: Any, q: float, power: float) -> float:
    """Return the head loss [m] of a pipe at a flow [m^3/s], by Hazen-Williams, or by a friction factor of 0.02."""
    if power == 1.852:
        return float(10.667 * pipe.length * pipe.roughness**-1.852 * pipe.diameter**-4.871 * q**1.852)
    return float(0.02 * pipe.length / pipe.diameter * (q / (math.pi * pipe.diameter**2 / 4)) ** 2 / (2 * 9.81))


def _two_digits(value: float) -> float:
    """Return a number rounded down to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / unit * (1 + 1e-12)) * unit:.2g}")


def _fitting_step(rate: float, load: float) -> float | None:
    """Return a time step [s] with which a = exp(-rate dt) satisfies (3) with room to spare; None if there is none."""
    steps = np.geomspace(1e-6, 1e6, 241) / max(rate, load)
    a = np.exp(-rate * steps)
    good = np.flatnonzero(a * a + 2 * steps * load < a)
    return _two_digits(0.9 * float(steps[good[-1]])) if len(good) else None
