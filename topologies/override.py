"""A value on the command line that replaces a value of the file, and its option."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import dataclass
from typing import Any, Self

from hedgerow.topologies.base import node_id

_SHOWN = 80


class Override(str):
    """The text `path=value` of a setting; `origin` is the option as the user wrote it."""

    origin: str

    @classmethod
    def of_option(cls, name: str, value: object) -> Self:
        """Return the setting of a named option, such as `--steps 3`."""
        made = cls(f"{name}={json.dumps(value)}")
        made.origin = f"--{name}" if value is True else f"--{name} {value}"
        return made


@dataclass(frozen=True)
class Step:
    """One word of a path, between two points; a word in quotes is a key by itself, points included."""

    text: str
    quoted: bool = False


_QUOTED = re.compile(r"""(?:"([^"]*)"|'([^']*)')(?=[.=]|$)""")


def split_setting(setting: str) -> tuple[str, str]:
    """Return path and value of `path=value`; the path is empty if `setting` has another form.

    Quotes may contain a `=`.
    """
    at = 0
    while at < len(setting) and setting[at] != "=":
        starts = at == 0 or setting[at - 1] == "."
        quoted = _QUOTED.match(setting, at) if starts else None
        at = quoted.end() if quoted else at + 1
    return (setting[:at], setting[at + 1 :]) if at < len(setting) else ("", "")


def steps_of(path: str) -> list[Step]:
    """Return the words of a path such as `nodes.7.x0`, `nodes.J-1.2.x0` or `nodes."J-1.2".x0`."""
    steps, at = [], 0
    while True:
        if found := _QUOTED.match(path, at):
            steps.append(Step(found[1] if found[1] is not None else found[2], quoted=True))
            end = found.end()
        else:
            end = point if (point := path.find(".", at)) >= 0 else len(path)
            steps.append(Step(path[at:end]))
        if end == len(path):
            return steps
        at = end + 1


def next_key(at: object, steps: list[Step]) -> tuple[Any, list[Step]]:
    """Return the next key of a path from `at`, and the steps after it.

    A key of the file can contain points. The longest existing key is taken: with nodes `J` and `J.1`, `J.1.x0` is a
    setting of the second. Quotes mark the end of a key.
    """
    if isinstance(at, dict) and not steps[0].quoted:
        plain = list(itertools.takewhile(lambda step: not step.quoted, steps))
        for count in range(len(plain), 1, -1):
            key = node_id(".".join(step.text for step in plain[:count]))
            if key in at:
                return key, steps[count:]
    return node_id(steps[0].text), steps[1:]


def origin_of(override: str) -> str:
    """Return the option to blame for a setting."""
    text = override.origin if isinstance(override, Override) else f"--set {override}"
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"
