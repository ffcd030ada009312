"""Paths as users write them."""

from __future__ import annotations

from pathlib import Path


def user_path(text: str) -> Path:
    """Return the path that an option names; shells leave the `~` of `--option=~/folder` to the program."""
    path = Path(text)
    try:
        return path.expanduser()
    except RuntimeError:  # the home folder is unknown: keep the text
        return path
