"""The network whose runs are tampered with."""

from __future__ import annotations

from typing import Any

from tests.tools.networks import read
from tests.tools.schedules import with_faults

NODE = 2
"""the id of the changed agent"""


TEXT = """
name: watched
b: 0.1
steps: 30
seed: 7
defaults: {candidates: [0.3, 0.5, 0.7, 0.9], disturbance: {kind: white, std: 0.5}}
nodes:
  1: {a: 0.7, x0: 5}
  2: {a: 0.5, x0: -3}
  3: {a: 0.9, x0: 8}
  4: {a: 0.3, x0: 2}
  5: {a: 0.7, x0: -6}
edges: [[1, 2], [2, 3], [3, 4], [4, 5], [1, 5], [1, 3]]
"""


FAULTS: list[dict[str, Any]] = [
    {"kind": "drop", "from": 1, "to": 2, "steps": [4, 8]},
    {"kind": "delay", "from": 3, "to": 2, "by": 3, "steps": [10, 16]},
    {"kind": "cut", "edge": [1, 2], "steps": [17, 19]},
    {"kind": "sensor", "node": 2, "steps": [19, 21]},
    {"kind": "actuator", "node": 2, "steps": [21, 23]},
    {"kind": "crash", "node": 2, "at": 23, "restart_after": 3},
    {"kind": "jump", "node": 2, "at": 28, "a": 0.9},
]


WATCHED = with_faults(read(TEXT), FAULTS)


FORGETFUL = with_faults(WATCHED, FAULTS, backfill=False)
"""The same network without back-filling: a crashed agent begins with no memory."""


SILENT = with_faults(WATCHED, [{"kind": "drop", "from": 1, "to": 2, "steps": [1, 15]}])
"""The same network with one long gap: many samples are learned late."""


UNLEARNING = [WATCHED.model_copy(update={"law": law}) for law in ("nominal", "hinf")]
"""The same network under laws that learn nothing: no input depends on a delay."""
