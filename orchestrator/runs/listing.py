"""The run folders of a directory, with the verdict of each."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from hedgerow.orchestrator.runs.files import read_verdict
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.paths import real_path

RECENT_S = 3600.0
"""A folder without a verdict that changed less than this ago may belong to a `simulate` that still runs."""
_OWN_FILES = re.compile(
    r"(topology\.yaml|verdict\.json|events\.jsonl|(telemetry|edges|summary|round_trips)\.(parquet|arrows)|run(-\d{3,})?\.rrd"
    r"|soak\.(csv|png|pdf))(\.part)?"
)
_OWN_FOLDERS = {"logs", "processes", "law"}


@dataclass(frozen=True)
class Listed:
    """One run folder."""

    run: str
    """The name of the folder."""
    folder: Path
    began: float
    """Seconds since 1970 at which the folder was made."""
    verdict: str
    """valid, INVALID or unknown; `running`; `none` without a verdict; `unreadable` if verdict.json is damaged."""
    network: str
    """The name of the network; empty without a verdict."""
    law: str
    steps_done: int | None
    steps: int | None
    regret: float | None
    """The regret D at the end."""
    size: int
    """Bytes on disk."""


def listed(directory: Path, running: Collection[str]) -> list[Listed]:
    """Return the run folders of `directory`, newest first. `running` holds the folders of the running networks."""
    try:
        folders = [path for path in directory.iterdir() if _is_run(path)]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise UserError(f"{directory}: {error.strerror}. Name another folder.", code=Code.FILE_MISSING) from None
    found = [_listed(path, str(real_path(path)) in running) for path in folders]
    return sorted(found, key=lambda one: (one.began, one.run), reverse=True)


def _is_run(path: Path) -> bool:
    """Return True if this project made a folder: other tools have a file called topology.yaml too."""
    return not path.is_symlink() and all((path / name).is_file() for name in ("topology.yaml", "events.jsonl"))


def _listed(path: Path, runs: bool) -> Listed:
    files = [one.stat() for one in path.rglob("*") if one.is_file() and not one.is_symlink()]
    try:
        content = read_verdict(path)
        word = content.get("verdict", "none")
    except HedgerowError:
        content, word = {}, "unreadable"
    return Listed(
        run=path.name,
        folder=path,
        began=min((one.st_mtime for one in files), default=path.stat().st_mtime),
        verdict="running" if runs else word,
        network=content.get("name", ""),
        law=content.get("law", ""),
        steps_done=content.get("steps_done"),
        steps=content.get("steps"),
        regret=content.get("metrics", {}).get("regret"),
        size=sum(one.st_size for one in files),
    )


def removable(runs: Sequence[Listed], keep: int) -> list[Listed]:
    """Return the runs after the newest `keep`, except those that are running, or may be."""
    return [one for one in runs[keep:] if one.verdict != "running" and not _may_run(one)]


def _may_run(one: Listed) -> bool:
    if one.verdict != "none":
        return False
    newest = max((path.lstat().st_mtime for path in (one.folder, *one.folder.iterdir())), default=0.0)
    return abs(time.time() - newest) < RECENT_S


def remove(runs: Sequence[Listed], directory: Path) -> list[str]:
    """Remove the files of runs, and `latest` if it points to one of them; return a line for each folder that stays.

    A folder stays if the user has put something into it. Raises UserError if a file cannot be removed.
    """
    stays = []
    for one in runs:
        try:
            stays += _remove(one.folder)
        except OSError as error:
            raise UserError(f"{one.folder}: not removed: {error.strerror}.", code=Code.OUTPUT) from None
    latest = directory / "latest"
    if latest.is_symlink() and not latest.exists():
        latest.unlink()
    return stays


def _remove(folder: Path) -> list[str]:
    for path in list(folder.iterdir()):
        if path.name in _OWN_FOLDERS and path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif _OWN_FILES.fullmatch(path.name) and not path.is_dir():
            path.unlink()
    if others := sorted(path.name for path in folder.iterdir()):
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        return [f"{folder}: stays with {others[0]}{more}, which no run made"]
    folder.rmdir()
    return []


def since(one: Listed) -> str:
    """Return the time at which a run began, in local time."""
    return datetime.fromtimestamp(one.began).strftime("%Y-%m-%d %H:%M:%S")
