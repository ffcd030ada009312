"""`orchestrator export` and frames: the same bits in other tools, and whole files or none."""

from __future__ import annotations

import csv
import importlib
import re
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from scipy.io import loadmat, whosmat

from hedgerow.orchestrator.runs.export import FORMS, NAMES, PLACES, arrays, export
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code
from tests.tools.processes import COMMAND, DEADLINE_S, orchestrator
from tests.tools.recorded import same
from tests.tools.refusals import refusal


def test_frames_equal_the_table(run: Run) -> None:
    """Whole numbers stay whole beside missing ones, and null is the missing value of each library."""
    pandas = importlib.import_module("pandas")
    for arrow, frames in (
        (run.telemetry(), {kind: run.telemetry(kind) for kind in ("pandas", "polars")}),
        (run.edges_table(), {kind: run.edges_table(kind) for kind in ("pandas", "polars")}),
    ):
        assert frames["polars"].to_arrow().cast(arrow.schema).equals(arrow)
        for name in arrow.schema.names:
            column = frames["pandas"][name]
            assert column.isna().to_numpy().tolist() == arrow[name].is_null().to_pylist()
            assert column.dropna().tolist() == arrow[name].drop_null().to_pylist()
    assert isinstance(run.telemetry("pandas").dtypes["index"], pandas.Int32Dtype)


def test_to_record_a_run_loads_no_library_of_frames(here: Path) -> None:
    """An import would take half a second of the first steps."""
    timed = [sys.executable, "-X", "importtime", *COMMAND[1:], "simulate", "paper7", "--no-record"]
    done = subprocess.run(timed, capture_output=True, text=True, check=True, timeout=DEADLINE_S)
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time")}
    assert "hedgerow.orchestrator.runs.writer" in loaded
    assert not {"pandas", "polars"} & loaded


def test_a_frame_of_a_missing_library(paper7: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with refusal(Code.DEPENDENCY):
        paper7.telemetry("pandas")
    with refusal(Code.OPTION):
        paper7.edges_table("excel")


def test_csv_is_read_back_to_the_bit(run: Run, tmp_path: Path) -> None:
    """By Arrow, polars and pandas, and each number by Python's float."""
    pandas, polars = importlib.import_module("pandas"), importlib.import_module("polars")
    files = export(run, "csv", tmp_path / "tables")
    assert [file.name for file in files] == ["telemetry.csv", "edges.csv", "summary.csv"]
    for file, arrow in zip(files, (run.telemetry(), run.edges_table(), run.summary()), strict=True):
        types = pa.csv.ConvertOptions(column_types=arrow.schema, null_values=[""], strings_can_be_null=False)
        if len(arrow):
            assert pa.csv.read_csv(file, convert_options=types).equals(arrow)
        schema = polars.from_arrow(arrow).schema
        assert polars.read_csv(file, schema=schema).to_arrow().cast(arrow.schema).equals(arrow)
        frame = pandas.read_csv(file, keep_default_na=False, na_values=[""])
        for name in arrow.schema.names:
            assert frame[name].dropna().tolist() == arrow[name].drop_null().to_pylist()
        with file.open(encoding="utf-8", newline="") as lines:
            rows = list(csv.DictReader(lines))
        for name in arrow.schema.names:
            printed = [None if row[name] == "" else row[name] for row in rows]
            if pa.types.is_floating(arrow.schema.field(name).type):
                printed = [None if one is None else float(one).hex() for one in printed]
                assert printed == [None if one is None else one.hex() for one in arrow[name].to_pylist()]


@pytest.mark.parametrize("value", [5e-324, -0.0, 0.1, 1e16, 1e22, 123456789.0, 2**53 + 1.0, 1.7976931348623157e308])
def test_a_number_in_csv_is_the_number(value: float, tmp_path: Path) -> None:
    """Arrow writes numbers of any size and sign, and float reads them back."""
    pa.csv.write_csv(pa.table({"x": [value]}), tmp_path / "x.csv")
    assert float((tmp_path / "x.csv").read_text().splitlines()[1]).hex() == value.hex()


def test_parquet_equals_the_tables_of_the_run(run: Run, tmp_path: Path) -> None:
    for file in export(run, "parquet", tmp_path / "tables"):
        assert file.read_bytes() == (run.folder / file.name).read_bytes()


def test_npz_is_read_back_to_the_bit(run: Run, tmp_path: Path) -> None:
    (file,) = export(run, "npz", tmp_path / "run.npz")
    with np.load(file, allow_pickle=False) as content:
        assert tuple(content) == NAMES
        for name in NAMES:
            assert same(content[name], arrays(run)[name]), name
            value = getattr(run, name)
            if isinstance(value, np.ndarray):
                assert same(content[name], value), name
        assert content["ids"].tolist() == [*run.ids] if run.name != "named" else ["upper_dam", "NA", "3"]
        assert (content["name"], content["verdict"], content["T"]) == (run.name, run.verdict.verdict, run.T)
        for k, node in enumerate(run.topology.nodes.values()):
            listed = content["candidates"][k]
            assert tuple(listed[~np.isnan(listed)]) == node.candidates


def test_mat_is_read_back_to_the_bit(run: Run, tmp_path: Path) -> None:
    """Numbers are doubles, flags logical, names cells of text; positions count from 1."""
    (file,) = export(run, "mat", tmp_path / "run.mat")
    kinds = {name: kind for name, _, kind in whosmat(file)}
    content = loadmat(file)
    assert [*kinds] == [*NAMES]
    for name, values in arrays(run).items():
        found = content[name]
        match values.dtype.kind:
            case "b":
                assert (kinds[name], found.shape) == ("logical", values.shape)
                assert same(found.astype(bool), values)
            case "U" if values.ndim:
                assert kinds[name] == "cell"
                assert [cell[0] for (cell,) in found] == values.tolist()
            case "U":
                assert kinds[name] == "char"
                assert found.tolist() == [str(values)]
            case _ if name == "ids":
                assert kinds[name] == "int64"
                assert found[:, 0].tolist() == values.tolist()
            case _ if values.size:
                assert kinds[name] == "double"
                shape = {0: (1, 1), 1: (-1, 1)}.get(values.ndim, values.shape)
                assert same(found - (name in PLACES), values.astype(float).reshape(shape)), name
    index, ahat = content["index"].astype(int), content["ahat"]
    for t, i in zip(*np.nonzero(index), strict=True):
        assert ahat[t, i] == content["candidates"][i, index[t, i] - 1]


def test_every_name_is_one_that_matlab_takes() -> None:
    words = "break case catch classdef continue else elseif end for function global if otherwise parfor persistent"
    for name in NAMES:
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", name)
        assert name not in f"{words} return spmd switch try while".split()


def refused(*arguments: str) -> str:
    """Return the message about a mistake."""
    done = orchestrator("export", *arguments)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr


def test_mistakes_at_the_command_line(paper7: Run, here: Path) -> None:
    assert refused("nix", "--to", "csv").startswith("error: nix: there is no such run; name its folder")
    with refusal(Code.OPTION):
        export(paper7, "xlsx")
    assert not list(here.glob("paper7*[.-]*"))
    first = orchestrator("export", "paper7", "--to", "mat")
    assert (first.returncode, first.stdout) == (0, "30 steps of paper7: paper7.mat\n")
    assert refused("paper7", "--to", "mat").startswith("error: paper7.mat: already exists; --force replaces it")


def test_nothing_is_overwritten_unasked(paper7: Run, here: Path) -> None:
    (here / "tables").mkdir()
    (here / "tables/edges.csv").write_text("mine")
    with refusal(Code.OUTPUT):
        export(paper7, "csv", Path("tables"))
    assert [path.name for path in (here / "tables").iterdir()] == ["edges.csv"]
    assert (here / "tables/edges.csv").read_text() == "mine"
    export(paper7, "csv", Path("tables"), force=True)
    assert (here / "tables/edges.csv").read_text().startswith('"step"')
    before = (paper7.folder / "telemetry.parquet").read_bytes()
    with refusal(Code.OUTPUT):
        export(paper7, "parquet", paper7.folder, force=True)
    assert (paper7.folder / "telemetry.parquet").read_bytes() == before
    with refusal(Code.OUTPUT):
        export(paper7, "npz", Path("tables"), force=True)
    (here / "file").write_text("")
    for to in FORMS:
        with refusal(Code.OUTPUT):
            export(paper7, to, here / "file" / "deeper", force=True)


def small_files_only() -> None:
    """The limit is in the command's process alone, because this process may write a large report."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))


@pytest.mark.parametrize("to", FORMS)
def test_a_full_disk_leaves_nothing_half_written(to: str, paper7: Run, here: Path) -> None:
    """Neither a piece of a new file, nor the loss of an old one."""
    (here / "old").mkdir()
    for name in ("telemetry.csv", "edges.csv", "telemetry.parquet", "edges.parquet", "run.npz", "run.mat"):
        (here / "old" / name).write_text("old")
    for place in (here / "new", here / "old"):
        out = place if to in ("csv", "parquet") else place / f"run.{to}"
        command = [*COMMAND, "export", str(paper7.folder), "--to", to, "--out", str(out), "--force"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=small_files_only)
        assert done.returncode == 2
        assert re.search(r"is not written: .*File too large", done.stderr)
    assert not (here / "new").exists()
    assert len(left := list((here / "old").iterdir())) == 6
    assert all(path.read_text() == "old" for path in left)
