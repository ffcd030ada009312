"""A run in files for other tools: tables as CSV or Parquet, or named arrays as .npz or .mat (docs/data.md)."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow.csv import CSVWriter

from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.orchestrator.runs import guaranteed
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.runs.table import Table
from hedgerow.orchestrator.runs.writer import ROW_GROUP
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.paths import beside, real_path

FORMS = ("csv", "parquet", "npz", "mat")
NAMES = (
    *("name", "law", "verdict", "T", "b", "gamma_star", "ids", "edges", "weights"),
    *("candidates", "nominal", "lost", "rows"),
    *("x", "x_oracle", "x_nominal", "regret", "nominal_gap", "regret_sum", "nominal_regret_sum"),
    *("a", "u", "w", "ahat", "index", "margin", "a_ls", "beta", "identifiable", "right"),
    *("cost", "cost_oracle", "cost_regret", "energy_sum", "gain", "gain_less_x0", "ceiling", "ceiling_slack"),
    *("u_edge", "edge_open", "i_hears", "j_hears"),
)
"""The arrays of a .npz and a .mat, each the attribute of Run with that name."""
OF_ALL = ("a_ls", "beta", "identifiable")
"""Those that take all rows to know."""
TOTALS = (
    *("regret_sum", "nominal_regret_sum", "right", "cost", "cost_oracle", "cost_regret", "energy_sum"),
    *("gain", "gain_less_x0"),
)
"""The arrays that need all rows, or a summary."""
PLACES = ("edges", "index")
"""The arrays of places: from 0, but in a .mat file from 1, as in MATLAB."""
MAT_BYTES = 2**31 - 1
"""The maximum size of one array of a .mat file."""


def export(run: Run, to: str, out: Path | None = None, force: bool = False) -> list[Path]:
    """Write a run in the form `to`, one of FORMS, and return its files; write all of them completely, or none.

    `out` is a folder for tables, otherwise a file. Raise UserError for a mistake, and if the disk is full.
    """
    if to not in FORMS:
        raise UserError(f"--to {to}: is no form of a run; there are {', '.join(FORMS)}", code=Code.OPTION)
    files = _files(run, to, out)
    for file in files:
        if real_path(file) in (table.parquet for table in run.tables.values()):
            raise UserError(f"{file}: is the run's own; --out names another folder", code=Code.OUTPUT)
        if file.is_dir():
            raise UserError(f"{file}: is a folder; --out names the file to write", code=Code.OUTPUT)
        if file.exists() and not force:
            raise UserError(f"{file}: already exists; --force replaces it, --out names another place", code=Code.OUTPUT)
    _write(files)
    return list(files)


def arrays(run: Run) -> dict[str, NDArray[Any]]:
    """Return the arrays of a run by name: numbers, flags and text, never objects; without parts that `record:`
    omits.
    """
    there = NAMES if run.whole else [name for name in NAMES if name not in OF_ALL]
    if not run.whole and not guaranteed.is_recorded(run):
        there = [name for name in there if name != "ceiling_slack"]
    if "summary" not in run.tables and not run.whole:
        there = [name for name in there if name not in TOTALS]
    return {name: _array(getattr(run, name)) for name in there}


def _array(value: Any) -> NDArray[Any]:
    if isinstance(value, Verdict):
        return np.array(value.verdict)
    return np.asarray(value)


Write = Callable[[Path], object]


def _files(run: Run, to: str, out: Path | None) -> dict[Path, Write]:
    """Return each file of a form, with the function that writes it."""
    if to in ("csv", "parquet"):
        folder = out or Path(f"{run.name}-{to}")
        write = _csv if to == "csv" else _parquet
        return {folder / f"{name}.{to}": partial(write, table) for name, table in run.tables.items()}
    return {out or Path(f"{run.name}.{to}"): partial(_npz if to == "npz" else _mat, run)}


def _csv(table: Table, path: Path) -> None:
    """Write CSV with the shortest numbers that are read back to the same bits; null is an empty cell."""
    with CSVWriter(spelled(path), table.schema) as writer:
        for batch in table.batches():
            writer.write_batch(batch)


def _parquet(table: Table, path: Path) -> None:
    """Write the same bytes as the run itself."""
    if table.over:
        shutil.copyfile(table.parquet, path)
    else:
        pq.write_table(table.whole(), spelled(path), row_group_size=ROW_GROUP)


def _npz(run: Run, path: Path) -> None:
    content: dict[str, Any] = arrays(run)
    with path.open("wb") as file:
        np.savez(file, **content)


def _mat(run: Run, path: Path) -> None:
    from scipy.io import savemat  # noqa: PLC0415 (a third of a second)

    content = {name: _of_matlab(name, values) for name, values in arrays(run).items()}
    for name, values in content.items():
        if values.nbytes > MAT_BYTES:
            raise UserError(
                f"--to mat: an array of such a file holds 2 GB at most, and {name} is larger; use npz", code=Code.OPTION
            )
    with path.open("wb") as file:
        savemat(file, content, oned_as="column")


def _of_matlab(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers for MATLAB: doubles, which support all operations; a list of texts becomes cells."""
    match values.dtype.kind:
        case "U" if values.ndim:
            return values.astype(object)
        case "i" if name != "ids":
            return values.astype(np.float64) + (name in PLACES)
    return values


def _write(files: Mapping[Path, Write]) -> None:
    """Write all files beside their places, and move them there only at the end."""
    file = next(iter(files))
    folder = file.parent
    is_new = not folder.exists()
    parts = {file: beside(file) for file in files}
    done = False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, part in parts.items():
            files[file](part)
        for file, part in parts.items():
            part.replace(file)
        done = True
    except (OSError, pa.ArrowInvalid) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{file}: is not written: {reason}; --out names another place", code=Code.OUTPUT) from None
    except MemoryError:
        raise UserError(
            f"{file}: is not written: no memory; csv and parquet are written piece by piece", code=Code.LIMIT
        ) from None
    finally:
        with contextlib.suppress(OSError):
            for part in parts.values():
                part.unlink(missing_ok=True)
            if is_new and not done:
                folder.rmdir()
