"""Input that is small on disk and large in memory is refused with the estimate, before it is loaded."""

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hedgerow.agents.view import View
from hedgerow.plant.truth import Truth
from hedgerow.topologies import archive, budget, table
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.samples import columns

PAIR = "{name: pair, b: 0.1, steps: 6, seed: 3, nodes: [p, q], edges: [[p, q]]}"


@pytest.fixture(autouse=True)
def _default_cap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(budget.VARIABLE, raising=False)


def refused(text: str, folder: Path = Path()) -> TopologyError:
    with pytest.raises(TopologyError) as error:
        parse(text.encode(), "t.yaml", folder)
    return error.value


def rule(graph: str) -> str:
    return f"{{name: big, b: 0.01, steps: 3, seed: 1, graph: {graph}}}"


@pytest.mark.parametrize(
    "graph",
    [
        "{kind: ring, nodes: 10000000}",
        "{kind: line, nodes: 9999999}",
        "{kind: star, nodes: 10000000}",
        "{kind: tree, nodes: 10000000}",
        "{kind: grid, nodes: 8000000}",
        "{kind: random_tree, nodes: 10000000}",
        "{kind: random_regular, nodes: 1000000, degree: 1000}",
        "{kind: small_world, nodes: 1000000, degree: 1000}",
        "{kind: scale_free, nodes: 1000000, attach: 1000}",
        "{kind: geometric, nodes: 1000000, mean_degree: 1000}",
    ],
)
def test_a_rule_beyond_the_cap_makes_no_graph(graph: str) -> None:
    error = refused(rule(graph))
    assert error.code == Code.FILE_TOO_LARGE
    assert error.count == 1
    assert budget.VARIABLE in str(error)


def test_a_million_nodes_by_any_rule_are_allowed() -> None:
    from hedgerow.topologies.generators import GENERATORS  # noqa: PLC0415

    for kind, model in GENERATORS.items():
        made = model.model_validate(
            {"kind": kind, "nodes": 10**6, **({"degree": 4} if kind == "random_regular" else {})}
        )
        assert made.memory <= budget.cap(), kind


def test_the_environment_sets_the_cap(monkeypatch: pytest.MonkeyPatch) -> None:
    small = rule("{kind: ring, nodes: 30000}")
    parse(small.encode(), "t.yaml", Path())
    monkeypatch.setenv(budget.VARIABLE, "2")
    assert refused(small).code == Code.FILE_TOO_LARGE
    monkeypatch.setenv(budget.VARIABLE, "9")
    parse(small.encode(), "t.yaml", Path())


@pytest.mark.parametrize("written", ["much", "0", "-5", "1.5", "9" * 30, "٤"])
def test_a_cap_that_is_no_number_of_megabytes_is_the_users_mistake(
    written: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(budget.VARIABLE, written)
    with pytest.raises(UserError) as error:
        budget.cap()
    assert error.value.code == Code.OPTION


def test_values_and_faults_of_a_file_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(budget.VARIABLE, "1")
    many = PAIR[:-1] + ", x: [" + "1," * 3000 + "1]}"
    assert refused(many).code == Code.FILE_TOO_LARGE
    faults = PAIR[:-1] + ", faults: [" + "{kind: drop, link: [p, q], steps: [0, 2]}," * 120 + "]}"
    assert refused(faults).code == Code.FILE_TOO_LARGE
    monkeypatch.setenv(budget.VARIABLE, "3")
    assert len(parse(faults.encode(), "t.yaml", Path()).faults) == 120


def test_a_topology_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    file = tmp_path / "t.yaml"
    file.write_text(PAIR)
    os.truncate(file, 10**12)
    with pytest.raises(UserError) as error:
        load(str(file))
    assert error.value.code == Code.FILE_TOO_LARGE


def test_a_fifo_is_no_topology_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "t.yaml")
    with pytest.raises(UserError) as error:
        load(str(tmp_path / "t.yaml"))
    assert error.value.code == Code.FILE_NOT_REGULAR


def test_samples_are_counted_before_they_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "w.csv").write_text("p,q\n" + "1,2\n" * 6000)
    assert len(columns("w.csv", tmp_path, ["p", "q"])["p"]) == 6000
    monkeypatch.setenv(budget.VARIABLE, "2")
    text = PAIR[:-1] + ", defaults: {disturbance: {kind: samples, file: w.csv}}}"
    assert Code.FILE_TOO_LARGE in {problem.code for problem in refused(text, tmp_path).problems}


def zeros(file: Path, **shapes: tuple[int, ...]) -> None:
    """Write an archive of zeros that is small on disk, without using the memory."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as packed:
        for name, shape in shapes.items():
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(header, {"descr": "<i8", "fortran_order": False, "shape": shape})
            with packed.open(f"{name}.npy", "w", force_zip64=True) as member:
                member.write(header.getvalue())
                left = 8 * int(np.prod(shape))
                while left > 0:
                    member.write(bytes(min(left, 2**22)))
                    left -= 2**22


READERS: list[Callable[[Path], object]] = [archive.read, View.read, Truth.read]


@pytest.mark.parametrize("read", READERS)
def test_an_archive_that_grows_beyond_the_cap_is_refused_unread(
    read: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    zeros(tmp_path / "a.npz", edges=(1_000_000, 2))
    assert (tmp_path / "a.npz").stat().st_size < 100_000
    monkeypatch.setenv(budget.VARIABLE, "15")
    with pytest.raises(UserError) as error:
        read(tmp_path / "a.npz")
    assert error.value.code == Code.FILE_TOO_LARGE


def test_a_table_counts_the_size_of_its_parsed_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    zeros(tmp_path / "a.npz", edges=(1_000_000, 2))
    monkeypatch.setenv(budget.VARIABLE, "100")
    archive.read(tmp_path / "a.npz")
    assert refused("{name: n, b: 0.1, steps: 3, table: a.npz}", tmp_path).code == Code.FILE_TOO_LARGE


def header_of(descr: str, shape: str, data: bytes = b"") -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + data


BROKEN = {
    "no array": b"hello",
    "nothing": b"",
    "header without an end": b"\x93NUMPY\x01\x00\x06\x00(((((\n",
    "header of another type": header_of("3", "(1,)", bytes(8)),
    "header with a list": header_of("'<f8'", "[1]", bytes(8)),
    "elements without bytes": header_of("'<U0'", "(1000000000000,)"),
    "rows without elements": header_of("'<i8'", "(1000000000000, 0)"),
    "more than is there": header_of("'<i8'", "(100000000,)", bytes(8)),
    "fields": header_of("[('i', '<i8')]", "(1,)", bytes(8)),
    "dates": header_of("'<M8[s]'", "(1,)", bytes(8)),
    "complex numbers": header_of("'<c16'", "(1, 2)", bytes(32)),
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN)
@pytest.mark.parametrize("name", ["edges", "ids", "peers", "settings", "nodes"])
def test_a_broken_archive_is_refused_by_every_reader(name: str, content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    with zipfile.ZipFile(file, "w") as packed:
        packed.writestr(f"{name}.npy", content)
        if name != "edges":
            packed.writestr("edges.npy", header_of("'<i8'", "(1, 2)", np.array([0, 1]).tobytes()))
    for read in (View.read, Truth.read):
        with pytest.raises(UserError) as error:
            read(file)
        assert error.value.code == Code.FILE_FORMAT
    assert refused("{name: n, b: 0.1, steps: 3, table: a.npz}", tmp_path).code == Code.FILE_FORMAT


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00", b"\x80\x04N."])
def test_a_file_that_is_no_archive_is_refused(read: Callable[[Path], object], content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(UserError) as error:
        read(tmp_path / "a.npz")
    assert error.value.code == Code.FILE_FORMAT


@pytest.mark.parametrize("read", READERS)
def test_a_fifo_is_no_archive(read: Callable[[Path], object], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.npz")
    with pytest.raises(UserError) as error:
        read(tmp_path / "a.npz")
    assert error.value.code == Code.FILE_NOT_REGULAR


HUGE = 10_000_000
SHAPES: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("a", "x0", "nominal", "b", "layout", "parts", "strange", "w 0 constant value"), (HUGE,)),
    "candidates": (2, HUGE),
    "positions": (HUGE, 2),
    "w 0 samples values": (2, HUGE),
    "edges": (HUGE, 2),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_column_of_any_name_is_refused_by_its_head(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """80 MB of zeros would become some 200 MB to 1 GB."""
    monkeypatch.setenv(budget.VARIABLE, "150")
    zeros(tmp_path / "a.npz", **{"edges": (1, 2), name: SHAPES[name]})
    with monkeypatch.context() as unread:
        unread.setattr(archive, "_array", lambda *_: pytest.fail("an array is unpacked"))
        refused("{name: n, b: 0.1, steps: 3, table: a.npz}", tmp_path)


def test_two_edges_that_imply_very_many_nodes_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", edges=[[0, 10**10]])
    assert refused("{name: n, b: 0.1, steps: 3, table: a.npz}", tmp_path).code == Code.FILE_TOO_LARGE


def test_a_table_of_a_million_nodes_is_allowed(tmp_path: Path) -> None:
    n = 10**6
    heads = {
        "edges": archive.Head((4 * n, 2), np.dtype("i8"), 64 * n),
        "candidates": archive.Head((n, 5), np.dtype("f8"), 40 * n),
        **{name: archive.Head((n,), np.dtype("f8"), 8 * n) for name in ("a", "x0", "nominal", "parts")},
        **{f"w 0 sinusoid {key}": archive.Head((n,), np.dtype("f8"), 8 * n) for key in ("amplitude", "omega", "phase")},
    }
    assert budget.excess(table._memory(heads)) == ""
