"""The verdict of a run's folder, and the checks in it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

CHECKS = {
    "dynamics",
    "estimates",
    "contraction",
    "oracle_certificate",
    "missing_inputs",
    "links",
    "faults",
    "plan",
    "law",
    "deaths",
    "information",
    "gain_estimates",
    "gain_edges",
    "gain_jumps",
}
OF_THE_PAPERS_LAW = {"estimates", "contraction", "gain_estimates", "gain_edges", "gain_jumps"}
"""checks that are claimed of laws that act by (6) on the list"""


def verdict_of(folder: Path = Path("runs/latest")) -> dict[str, Any]:
    """Return the content of the verdict's file in the folder of a run, by default of the last one."""
    verdict: dict[str, Any] = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))
    return verdict
