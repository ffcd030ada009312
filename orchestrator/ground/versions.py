"""The versions that a run depends on."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from functools import cache

from hedgerow.wire.release import release

PACKAGES = ("hedgerow", "eclipse-zenoh", "numpy", "rerun-sdk", "pydantic", "pyarrow", "scipy")


@cache
def versions() -> Mapping[str, str]:
    """Return the version of Python and of each package that a run depends on, by name."""
    return {"python": platform.python_version(), **{name: release(name) for name in PACKAGES}}
