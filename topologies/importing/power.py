"""Power grids: MATPOWER cases, .m and .mat, and pandapower networks.

A node is a bus, an edge a branch that is in service. Its weight is the susceptance 1/(x tap) per unit, which turns a
difference of angles into a flow of power.
"""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Array
from hedgerow.topologies.importing import matrices
from hedgerow.topologies.importing.found import Found, as_number, places, refuse, storage_of
from hedgerow.topologies.importing.options import Options
from hedgerow.topologies.importing.simple import only
from hedgerow.topologies.paths import real_path
from hedgerow.topologies.regular_file import read_regular

if TYPE_CHECKING:
    import pandapower

GROWTH = 60
"""the memory per byte of a file"""
F_BUS, T_BUS, BR_X, TAP, BR_STATUS = 0, 1, 3, 8, 10
BUS_I, BUS_TYPE, BASE_KV = 0, 1, 9
ISOLATED = 4
BUS_COLUMNS = ("BUS_I", "BUS_TYPE", "PD", "QD", "GS", "BS", "BUS_AREA", "VM", "VA", "BASE_KV")
TRUSTED = {"pandapower", "pandas", "numpy", "networkx", "shapely", "geopandas"}
"""modules allowed in a pandapower file: pandapower's reader imports every module that the file names"""


_CHANGE = re.compile(rb"^[ \t]*(?:[^%\n]*[;,])?[ \t]*(mpc\.(bus|branch)[ \t]*\([^\n%]*\)[ \t]*=)", re.MULTILINE)


def read_m(path: Path, options: Options) -> Found:
    """Return the grid of a MATPOWER case, .m."""
    text = read_regular(path, growth=GROWTH)
    if b"mpc" not in text:
        raise refuse(path, "is no MATPOWER case: it sets no field of `mpc`", "Name a case file")
    # The reader uses the tables as they are written: a statement that changes one would be ignored silently.
    if (change := _CHANGE.search(text)) is not None:
        line = text.count(b"\n", 0, change.start(1)) + 1
        raise refuse(
            f"{path}:{line}",
            f"a statement changes mpc.{change[2].decode()}, and this reader runs none",
            f"Save the case that MATPOWER or Octave loads: savecase('{path.stem}.mat', loadcase('{path.stem}'))",
        )
    try:
        from matpowercaseframes import CaseFrames  # noqa: PLC0415
    except ImportError:
        raise missing("matpowercaseframes", "power") from None
    try:
        case = CaseFrames(str(real_path(path)))
        bus, branch = case.bus, case.branch
        names = getattr(case, "bus_name", None)
    except Exception as error:  # the reader passes on all errors of its expressions and of pandas
        raise refuse(path, f"is no MATPOWER case that can be read: {str(error)[:200]}", "Check its format") from None
    labels = None if names is None else [str(name).strip() or None for name in names]
    return of_case(path, np.asarray(bus, dtype=float), np.asarray(branch, dtype=float), options, labels)


_MAT = """
import io, sys
import numpy as np
import scipy.sparse
from scipy.io import loadmat
content = loadmat(io.BytesIO(sys.stdin.buffer.read()))
mpc = content.get("mpc")
if mpc is not None and mpc.dtype.names and {"bus", "branch"} <= set(mpc.dtype.names):
    arrays = {"mpc " + key: np.asarray(mpc[key].item(), dtype=float) for key in ("bus", "branch")}
else:
    arrays = {}
    for name, value in content.items():
        if not name.startswith("__") and getattr(value, "ndim", 0) == 2 and value.shape[0] == value.shape[1] > 1:
            if value.dtype.kind == "c":
                sys.exit(f"`{name}` holds complex numbers")
            coo = scipy.sparse.coo_array(value)
            arrays[name] = np.stack([*coo.coords, coo.data], axis=1).astype(float)
            arrays["n " + name] = np.array(value.shape[0])
file = io.BytesIO()
np.savez(file, **arrays)
sys.stdout.buffer.write(file.getvalue())
"""
"""Reads a MATLAB file, and writes its arrays: damaged ones can end the process of SciPy."""
DEADLINE_S = 120.0


def read_mat(path: Path, options: Options) -> Found:
    """Return the grid of a MATPOWER case, .mat, or the graph of the one square matrix in the file."""
    data = read_regular(path, growth=GROWTH)
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-W", "ignore", "-c", _MAT],
            input=data,
            capture_output=True,
            timeout=DEADLINE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise refuse(path, f"was not read within {DEADLINE_S:g} s", "Save it with -v7") from None
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines() or ["it is damaged"]
        if "complex" in lines[-1]:
            raise refuse(path, lines[-1][:200], "Save the moduli, or the real parts")
        raise refuse(path, f"is no MATLAB file that SciPy can read: {lines[-1][:200]}", "Save it with -v7")
    with np.load(io.BytesIO(done.stdout)) as archive:
        arrays = dict(archive)
    if "mpc bus" in arrays:
        return of_case(path, arrays["mpc bus"], arrays["mpc branch"], options)
    return matrices.of_mat(arrays, path, options)


def of_case(
    path: Path, bus: Array, branch: Array, options: Options, labels: Sequence[str | None] | None = None
) -> Found:
    """Return the grid of the tables `bus` and `branch` of a case."""
    if bus.ndim != 2 or branch.ndim != 2 or bus.shape[1] <= BASE_KV or branch.shape[1] <= TAP:
        raise refuse(path, "has no tables `bus` and `branch` of a MATPOWER case", "Name a case file")
    place = {int(number): k for k, number in enumerate(bus[:, BUS_I])}
    if len(place) < len(bus):
        numbers, count = np.unique(bus[:, BUS_I], return_counts=True)
        raise refuse(path, f"bus {numbers[count.argmax()]:.0f} is twice in `bus`", "Give each bus its own number")
    ends = [(int(i), int(j)) for i, j in branch[:, [F_BUS, T_BUS]]]
    for i, j in ends:
        if i not in place or j not in place:
            raise refuse(path, f"branch {i} - {j} leads to a bus that is not in `bus`", "Add the bus")
    edges = np.array([(place[i], place[j]) for i, j in ends], dtype=np.int64).reshape(-1, 2)
    closed = branch[:, BR_STATUS] > 0 if branch.shape[1] > BR_STATUS else np.ones(len(branch), dtype=bool)
    changes = []
    if (open_ := int((~closed).sum())) > 0:
        changes.append(f"{open_} branch{'es' if open_ > 1 else ''} out of service dropped")
    tap = np.where(branch[:, TAP] == 0, 1.0, branch[:, TAP])
    with np.errstate(divide="ignore"):
        weights = 1 / (branch[:, BR_X] * tap)
    fact = "The weight of a branch is its susceptance 1/(x tap) [p.u.]"
    if options.weight is not None:
        if (number := as_number(options.weight)) is None:
            raise refuse(f"--weight {options.weight}", "a branch has its susceptance", "Give a number", Code.OPTION)
        weights, fact = np.full(len(branch), number), f"Every branch has the weight {number:g}, by the option"
    attributes = [dict(zip(BUS_COLUMNS, row, strict=False)) for row in bus.tolist()]
    storage, of_storage = storage_of(str(path), options.storage, attributes, options.junction_storage, "bus")
    found = Found(
        source=str(path),
        names=list(place),
        edges=edges[closed],
        labels=labels if labels is not None and len(labels) == len(place) else None,
        weights=weights[closed],
        storage=storage,
        edge_names=[f"branch {k + 1}" for k in np.flatnonzero(closed)],
        sign=_sign,
        facts=[fact, *([of_storage] if of_storage else [])],
        changes=changes,
    )
    if storage is None:
        found.assumptions.append("Every bus has the same storage: a case has no inertia; --storage gives one")
    if not (connected := bus[:, BUS_TYPE] != ISOLATED).all():
        found.changes.append(f"{int((~connected).sum())} isolated buses (type 4) dropped")
        found = only(found, np.flatnonzero(connected))
    return found


def _sign(weight: float) -> str:
    """Return the meaning of a branch with a weight that is not above 0."""
    if np.isinf(weight):
        return "a branch without reactance: a bus tie or a switch"
    return "a series capacitor, or the star point of a three-winding transformer" if weight < 0 else "no reactance"


def read_pandapower(path: Path, options: Options) -> Found:
    """Return the grid of a pandapower file, .json, by pandapower's own conversion to a MATPOWER case."""
    content = read_regular(path, growth=GROWTH)
    _check_modules(path, content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import pandapower  # noqa: PLC0415 (a second)
            from pandapower.converter.pypower.to_ppc import to_ppc  # noqa: PLC0415
    except ImportError:
        raise missing("pandapower", "power") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            net = pandapower.from_json_string(content.decode())
            # Without the check of connectivity, parts without a supply remain: they are a network too.
            case = to_ppc(net, init="flat", calculate_voltage_angles=True, mode="pf", check_connectivity=False)
    except Exception as error:  # the conversion passes on all errors of its parts
        raise refuse(
            path, f"pandapower cannot read it: {str(error)[:200]}", "Open and save it with pandapower"
        ) from None
    bus, branch = (np.asarray(case[key]).real.astype(float) for key in ("bus", "branch"))
    lookup = net._pd2ppc_lookups["bus"]
    first = {int(number): k for k, number in enumerate(bus[:, BUS_I])}
    members: dict[int, list[Any]] = {}
    for index in net.bus.index:
        # Buses out of service have no place in the case.
        if (at := first.get(int(lookup[index]))) is not None:
            members.setdefault(at, []).append(index)
    labels = [_label(net, members.get(k, []), k) for k in range(len(bus))]
    found = of_case(path, bus, branch, options, None)
    firsts = [first[int(str(name))] for name in found.names]
    found.labels = [labels[k] for k in firsts]
    found.names = [members[k][0] if members.get(k) else f"aux_{k}" for k in firsts]
    found.positions = places([_place(net, members.get(k, [])) for k in firsts])
    if out := len(net.bus) - sum(map(len, members.values())):
        found.changes.append(
            f"{out} bus{'es' if out > 1 else ''} dropped: out of service, or without a branch in service"
        )
    if auxiliary := sum(str(name).startswith("aux_") for name in found.names):
        found.assumptions.append(
            f"{auxiliary} node{'s' if auxiliary > 1 else ''} aux_… made by pandapower: star points of transformers, "
            "and open ends of lines"
        )
    fused = sum(len(own) - 1 for own in members.values())
    if fused:
        found.changes.append(f"{fused} bus{'es' if fused > 1 else ''} fused with others: closed switches join them")
    return found


def _label(net: pandapower.pandapowerNet, buses: Sequence[Any], k: int) -> str | None:
    if not buses:
        return f"auxiliary node {k}"
    name = net.bus.at[buses[0], "name"]
    return str(name) if name is not None and name == name and str(name).strip() else None  # noqa: PLR0124


def _place(net: pandapower.pandapowerNet, buses: Sequence[Any]) -> tuple[float, float] | None:
    """Return the position of a bus, which pandapower holds as a GeoJSON point."""
    if not buses or "geo" not in net.bus or not isinstance(geo := net.bus.at[buses[0], "geo"], str):
        return None
    try:
        x, y = json.loads(geo)["coordinates"][:2]
        return float(x), float(y)
    except (ValueError, KeyError, TypeError):
        return None


def _check_modules(path: Path, content: bytes) -> None:
    """Raise UserError for a file that names other modules than those of its tools: pandapower would import them all."""
    try:
        waiting = [json.loads(content)]
    except (ValueError, RecursionError):
        raise refuse(path, "is no JSON", "Check its format") from None
    while waiting:
        at = waiting.pop()
        if isinstance(at, dict):
            module = at.get("_module")
            if module is not None and str(module).partition(".")[0] not in TRUSTED:
                raise refuse(
                    path, f"names the module {str(module)[:60]!r}, which its reader would import", "Remove that object"
                )
            waiting += at.values()
        elif isinstance(at, list):
            waiting += at
        elif isinstance(at, str) and "_module" in at:
            try:
                waiting.append(json.loads(at))
            except (ValueError, RecursionError):
                continue


def missing(package: str, extra: str) -> UserError:
    """Return the error for a missing reader, for the caller to raise."""
    return UserError(
        f"{package}: is not installed, and reads this file. Install it: pip install 'hedgerow[{extra}]'.",
        code=Code.OPTION,
    )
