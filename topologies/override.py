"""A value of the command line that replaces one of the file, and the option that gave it."""

from __future__ import annotations

import json
from typing import Self

_SHOWN = 80


class Override(str):
    """The text `path=value` of a setting; `origin` is the option as the user wrote it."""

    origin: str

    @classmethod
    def of_option(cls, name: str, value: object) -> Self:
        """Return the setting of an option of its own, such as `--steps 3`."""
        made = cls(f"{name}={json.dumps(value)}")
        made.origin = f"--{name}" if value is True else f"--{name} {value}"
        return made


def origin_of(override: str) -> str:
    """Return the option to blame for a setting."""
    text = override.origin if isinstance(override, Override) else f"--set {override}"
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"
