"""The results of a benchmark: one row per size, printed as soon as it is known, or all as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping


def show(measured: Iterable[Mapping[str, float]], width: int, as_json: bool) -> None:
    """Print rows with the same columns, each with this width."""
    rows = []
    for row in measured:
        rows.append(row)
        if not as_json:
            if len(rows) == 1:
                print("".join(f"{name:>{width}}" for name in row))
            print("".join(f"{value:>{width}.4g}" for value in row.values()), flush=True)
    if as_json:
        print(json.dumps(rows, indent=2))
