"""Paths as users write them."""

from __future__ import annotations

from pathlib import Path

from hedgerow.topologies import leftovers
from hedgerow.topologies.errors import Code, UserError


def user_path(text: str) -> Path:
    """Return the path that an option names; shells leave the `~` of `--option=~/folder` to the program.

    Raises UserError for a text that is no path of any file.
    """
    if "\0" in str(text):  # typer hands over a default as a path
        raise UserError("a path has a zero byte. Name another one.", code=Code.OPTION)
    path = Path(text)
    try:
        return path.expanduser()
    except RuntimeError:  # the home folder is unknown: keep the text
        return path


def beside(path: Path, end: str = ".part") -> Path:
    """Return a new path in the folder of `path`, for a file or folder that exists for a short time.

    Its name is short, because a name as long as the file system allows has no room for more. No other file has it:
    `.x.yaml` beside a folder `x` may be the user's. The first call for a folder removes what killed processes left
    there (topologies/leftovers.py).
    """
    leftovers.remove(path.parent)
    return path.with_name(leftovers.new_name() + end)


def real_path(path: Path) -> Path:
    """Return the whole path with all symbolic links followed; raise UserError for links that lead in a circle."""
    try:
        return path.resolve()
    except RuntimeError:  # Python before 3.13 raises it for a circle
        raise UserError(
            f"{path}: symbolic links lead in a circle. Replace the link by a file or a folder.",
            code=Code.FILE_UNREADABLE,
        ) from None


def why_no_folder(error: OSError) -> str:
    """Return the reason why a folder cannot be made, in words: a file in its place is the user's, and stays."""
    if isinstance(error, FileExistsError):
        return "is a file, not a folder"
    if isinstance(error, NotADirectoryError):
        return "a part of the path is a file, not a folder"
    return error.strerror or str(error)
