"""The installed release of a package."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

UNKNOWN = "unknown"


@cache  # the look-up reads the disk
def release(package: str) -> str:
    """Return the release of a package; `unknown` without metadata, as in a frozen program or a copied folder."""
    try:
        return version(package) or UNKNOWN
    except PackageNotFoundError:
        return UNKNOWN
