"""The folder of a run."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from hedgerow.orchestrator.ground.law_source import FOLDER as LAW
from hedgerow.orchestrator.ground.law_source import source_of
from hedgerow.orchestrator.ground.spelling import shown
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.escape import echo
from hedgerow.topologies.paths import beside, real_path, why_no_folder
from hedgerow.topologies.resolve import save
from hedgerow.topologies.schema import Topology

T = TypeVar("T")


class RunFolder:
    """`runs/<name>-<time>/`, and `runs/latest` that points to it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topology = path / "topology.yaml"
        self.recording = path / "run.rrd"
        self.verdict = path / "verdict.json"
        self.events = path / "events.jsonl"
        self.logs = path / "logs"
        self.processes = path / "processes"
        """the config of each process"""
        self.law = path / LAW
        """a copy of the source of the law, if it is not one of the project"""
        self.made = True
        """True if `create` made the folder; otherwise it existed and was empty."""
        self.latest_before: str | None = None
        """The run that runs/latest pointed to before this one."""
        self.note = ""
        """a convenience that failed, in one line"""

    @property
    def name(self) -> str:
        """Return the run's name: that of its folder, with an escape for each byte that is not UTF-8."""
        return shown(self.path.name)

    def event(self, kind: str, **details: Any) -> None:
        """Append one line to events.jsonl, if the disk has room; the recorder of the run reports a full disk."""
        line = {
            "time": datetime.now().astimezone().isoformat(timespec="milliseconds"),
            "event": kind,
            **details,
        }
        with contextlib.suppress(OSError), self.events.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def new_folder(folder: Path, shown: str, mode: int = 0o777) -> None:
    """Make a folder, or accept an empty one; raise UserError if it is not empty.

    `shown` is the name in the user's words.
    """
    try:
        folder.mkdir(mode, parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{shown}: {why_no_folder(error)}; name another folder", code=Code.OUTPUT) from error
    if any(folder.iterdir()):
        raise UserError(f"{shown}: holds something already; name a new folder", code=Code.OUTPUT)


@contextlib.contextmanager
def whole_folder(folder: Path, shown: str, mode: int = 0o777) -> Iterator[Path]:
    """Provide a folder to fill, beside the final one; it becomes the final one if the block succeeds, and is removed
    otherwise.
    """
    made = not folder.exists()
    new_folder(folder, shown, mode)
    # Keep an existing folder: the user may be in it, or have mounted it there.
    part = beside(folder if made else folder / folder.name)
    try:
        part.mkdir(mode)
        yield part
        if made:
            part.replace(folder)
        else:
            for one in part.iterdir():
                one.replace(folder / one.name)
            part.rmdir()
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):  # the user has put something into it
                folder.rmdir()
        raise


def create(topology: Topology, directory: Path | None) -> RunFolder:
    """Return a new folder for a run of the resolved `topology`: `directory`, new or empty, or one in runs/."""
    try:
        made = directory is not None and not directory.exists()
        if directory is not None:
            new_folder(directory, f"--run-dir {directory}")
            folder = RunFolder(real_path(directory))
        else:
            folder = _new_in(Path("runs"), topology.name)
            made = True
        _claim(folder)
        try:
            folder.processes.mkdir()
            if (source := source_of(topology.law)).files:
                source.write(folder.law)
            save(topology, folder.topology)
        except BaseException:
            _empty(folder.path)
            if made:
                folder.path.rmdir()
            raise
        folder.made = made
        if directory is None:
            latest = folder.path.parent / "latest"
            folder.latest_before = os.readlink(latest) if latest.is_symlink() else None
            folder.note = _point_latest(folder.path.parent, folder.path)
    except OSError as error:
        raise UserError(
            f"no run folder: {error.filename or directory or 'runs'}: {why_no_folder(error)};"
            " choose another with --run-dir",
            code=Code.OUTPUT,
        ) from None
    return folder


def _claim(folder: RunFolder) -> None:
    """Make the first entry of a run folder; raise UserError if another run has made it, and leave that run's files."""
    try:
        folder.logs.mkdir()
    except FileExistsError:
        raise UserError(f"--run-dir {folder.path}: another run has it. Name a new folder.", code=Code.OUTPUT) from None


def reserve(name: str) -> RunFolder:
    """Make an empty folder in runs/ for a run of the network `name`, and point runs/latest to it."""
    try:
        folder = _new_in(Path("runs"), name)
    except OSError as error:
        raise UserError(
            f"no run folder: runs: {why_no_folder(error)}. Give a folder with run_dir.", code=Code.OUTPUT
        ) from None
    latest = folder.path.parent / "latest"
    folder.latest_before = os.readlink(latest) if latest.is_symlink() else None
    folder.note = _point_latest(folder.path.parent, folder.path)
    return folder


def begun_or_withdrawn(folder: RunFolder, begin: Callable[[], T]) -> T:
    """Return `begin()`; if the system or a HedgerowError refuses it, or a signal ends it, undo `create` first.

    A folder that stays is named on standard error: it holds rows, or logs that may explain the error.
    """
    try:
        return begin()
    except (HedgerowError, OSError, KeyboardInterrupt) as error:
        withdraw(folder, logs=isinstance(error, KeyboardInterrupt))
        with contextlib.suppress(OSError):
            if any(folder.path.iterdir()):
                echo(f"run folder {folder.path}", error=True)
        raise


def withdraw(folder: RunFolder, logs: bool = False) -> None:
    """Undo `create` for a run that was refused before it began: its folder goes, and runs/latest points back.

    `logs` removes what processes of this run wrote, too; otherwise a folder with logs stays.
    """
    if any(path.suffix in (".arrows", ".parquet", ".json") for path in folder.path.iterdir()):
        return  # it began: the second Ctrl-C may come at any moment
    if logs:
        for path in (folder.logs, folder.processes):
            shutil.rmtree(path, ignore_errors=True)
    _empty(folder.path)
    with contextlib.suppress(OSError):
        if folder.made:
            folder.path.rmdir()  # fails if the user has put a file into it
        runs, name = folder.path.parent, folder.path.name
        latest = runs / "latest"
        if latest.is_symlink() and os.readlink(latest) == name:
            if folder.latest_before is None:
                latest.unlink()
            else:
                _point_latest(runs, runs / folder.latest_before)


def _empty(folder: Path) -> None:
    """Remove the files that `create` wrote into a folder."""
    shutil.rmtree(folder / LAW, ignore_errors=True)
    for path in (folder / "topology.yaml", folder / "events.jsonl", folder / "logs", folder / "processes"):
        with contextlib.suppress(OSError):
            path.rmdir() if path.is_dir() else path.unlink(missing_ok=True)


def _new_in(runs: Path, name: str) -> RunFolder:
    runs.mkdir(exist_ok=True)
    stamp = time.strftime("%Y%m%d-%H%M%S")
    number = 1
    while True:
        path = real_path(runs) / f"{name}-{stamp}{f'-{number}' if number > 1 else ''}"
        try:
            path.mkdir()
        except FileExistsError:
            number += 1
            continue
        return RunFolder(path)


def _point_latest(runs: Path, path: Path) -> str:
    """Point runs/latest to a run; return the reason for a failure in one line, otherwise an empty text."""
    # Replace it by a rename, so that `latest` exists at every moment while other runs start.
    link = runs / f".latest-{os.getpid()}"
    latest = runs / "latest"
    if latest.exists() and not latest.is_symlink():
        return "runs/latest: does not point to this run: it is no link. Move what is there away, or name the run."
    try:
        link.symlink_to(path.name, target_is_directory=True)
        link.replace(latest)
    except OSError as error:
        with contextlib.suppress(OSError):
            link.unlink(missing_ok=True)
        return f"runs/latest: does not point to this run: {error.strerror}. Move that file away, or name the run."
    return ""


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file completely or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        part.rename(path)
    finally:
        part.unlink(missing_ok=True)
