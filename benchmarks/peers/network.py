"""The common parts of all peers: the network, the law of one node, the plant, and the clock.

The law, the dynamics and the disturbances are those of the project. Peers differ only in the transport of messages, so
a trajectory with different bits is a fault of the loop.
"""

from __future__ import annotations

import json
import os
import struct
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.cpu import Usage, between, used_by
from benchmarks.peers.memory import pss_of
from hedgerow.agents.law import Minimax
from hedgerow.plant.disturbance import Disturbance
from hedgerow.plant.world import dynamics
from hedgerow.topologies.graph import Graph
from hedgerow.topologies.network import groups_of, padded

Array = NDArray[np.float64]

PLANT = -1
"""the sender of a state"""
STOP = -1
"""the step of the last message, which ends an agent"""
MESSAGE = struct.Struct("<iqdd")
"""sender, t, x, u: a state (u = 0), an input, or a message to a neighbour"""
BEGAN = "HEDGEROW_BENCHMARK_BEGAN"
"""the environment variable with the start time of the command, monotonic"""
COUNT_CPU = "HEDGEROW_BENCHMARK_CPU"
"""the environment variable that asks for `Done.used`"""


@dataclass(frozen=True)
class Network:
    """A resolved network in plain numbers."""

    file: str
    """its topology file"""
    b: float
    a: Sequence[float]
    x0: Sequence[float]
    candidates: Sequence[Sequence[float]]
    edges: Sequence[Sequence[int]]
    disturbance: Sequence[Sequence[dict[str, Any]]]
    seed: int
    saved: str = ""
    """the file that `read` has read"""

    def __len__(self) -> int:
        return len(self.a)

    def neighbours(self, i: int) -> list[int]:
        """Return the neighbours of a node, ascending: the order in which a flow is summed."""
        return sorted(b if a == i else a for a, b in self.edges if i in (a, b))

    def write(self, path: Path) -> None:
        """Write the network to a file for `read`."""
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def read(cls, path: str | Path) -> Network:
        """Return the network that `write` wrote; floats keep every bit."""
        return cls(**json.loads(Path(path).read_text(encoding="utf-8")) | {"saved": str(path)})


@dataclass(frozen=True)
class Done:
    """The results of a run of `steps` steps."""

    steps_per_s: float
    """the rate from the end of the first step to the end of the last"""
    first_step_s: float
    """the time from the command to the end of the first step"""
    pss_mb: float
    """proportional set size of all its processes together, when all are running"""
    x: Array
    """(steps + 1, n)"""
    u: Array
    """(steps, n)"""
    used: Usage = field(default_factory=dict)
    """by every thread, in the last four fifths of the steps, if COUNT_CPU asks for it"""


class Agent:
    """One node: it closes the sample of t - 1 and acts at t, equations (6) and (7)."""

    def __init__(self, network: Network, i: int) -> None:
        self.neighbours = network.neighbours(i)
        self.u = 0.0
        self._x: Array | None = None
        self._law = Minimax(network.b, padded([network.candidates[i]]))

    def step(self, x: float, heard: Iterable[float]) -> float:
        """Return u(t) from x(t) and the neighbours' u(t - 1), in the order of `neighbours`; at t = 0 `heard` is
        empty.
        """
        now = np.array([x])
        if self._x is not None:
            flow = 0.0
            for other in heard:
                flow += self.u - other
            self._law.learn(self._x, np.array([flow]), now)
        self._x = now
        self.u = float(self._law.act(now)[0])
        return self.u


class Lockstep:
    """An agent with messages in any order: it acts when state(t) and every neighbour's (x, u) of t - 1 have arrived."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._mail: dict[int, dict[int, float]] = {-1: dict.fromkeys(agent.neighbours, 0.0)}
        self._t, self._x = -1, 0.0

    def take(self, sender: int, t: int, x: float, u: float) -> tuple[int, float, float] | None:
        """Return (t, x, u) of the waiting state, if this was the last missing message."""
        if sender == PLANT:
            self._t, self._x = t, x
        else:
            self._mail.setdefault(t, {})[sender] = u
        heard = self._mail.get(self._t - 1, {})
        if self._t < 0 or len(heard) < len(self._agent.neighbours):
            return None
        self._mail.pop(self._t - 1, None)
        now, self._t = self._t, -1
        return now, self._x, self._agent.step(self._x, [heard[j] for j in self._agent.neighbours])


class Plant:
    """The true network in motion, its trajectory, and its time."""

    def __init__(self, network: Network, steps: int) -> None:
        self.t, self.steps = 0, steps
        self.x = np.array(network.x0, dtype=float)
        self._a, self._b = np.array(network.a), network.b
        self._graph = Graph(len(network), np.array(network.edges, dtype=np.int64).reshape(-1, 2))
        self._disturbance = Disturbance(groups_of(network.disturbance, steps), range(len(network)), network.seed)
        self._xs, self._us = [self.x], np.zeros((steps, len(network)))
        self._first = self._last = 0.0
        self._used: Usage = {}

    def step(self, u: Sequence[float] | Array) -> bool:
        """Make the step from t to t + 1 under u(t), (n,), equation (1); return True if there is another step."""
        inputs = self._us[self.t]
        inputs[:] = u
        w = self._disturbance.at(self.t)
        self.x = dynamics(self._a, self._b, self._graph, self.x, inputs, w)
        self._xs.append(self.x)
        self.t += 1
        self._last = time.monotonic()
        if self.t == 1:
            self._first = self._last
        if COUNT_CPU in os.environ and self.t == self.steps // 5:
            self._used = used_by(os.getpid())
        return self.t < self.steps

    def done(self, root: int | None = None) -> Done:
        """Return the results, while all processes, those below `root` [this process], still exist."""
        used = between(self._used, used_by(root or os.getpid())) if COUNT_CPU in os.environ else {}
        return Done(
            steps_per_s=(self.t - 1) / (self._last - self._first),
            first_step_s=self._first - float(os.environ[BEGAN]),
            pss_mb=pss_of(root or os.getpid()),
            x=np.array(self._xs),
            u=self._us,
            used=used,
        )
