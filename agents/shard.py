"""The mind of one agent process: k >= 1 nodes, their law, and what they heard; a shard of one is not special."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.law import Array, Law, Minimax
from agents.view import View
from topologies.errors import HedgerowError, UserError
from wire.codec import ALL_UP, REPORT_WIDTH, Flag

Index = NDArray[np.int64]

_OPEN, _HEAR = np.uint8(Flag.OPEN), np.uint8(Flag.HEAR)


class LawError(HedgerowError):
    """A law that failed while it ran."""


def new_law(view: View) -> Law:
    """The law of a view, with no sample seen yet; UserError when there is none such, LawError when it cannot begin."""
    law = law_class(view.law)
    try:
        return law(view.b, [node.candidates for node in view.nodes])
    except Exception as error:
        raise LawError(f"law {view.law}: cannot begin: {type(error).__name__}: {error}; mend it") from error


def law_class(name: str) -> type[Law]:
    """The class of a law: `minimax`, or `package.module:Class` (looked for in the working directory too)."""
    if name == "minimax":
        return Minimax
    module, _, attribute = name.partition(":")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    try:
        law: type[Law] = getattr(importlib.import_module(module), attribute)
    except Exception as error:
        raise UserError(
            f"law {name}: cannot be loaded: {type(error).__name__}: {error}; "
            "give package.module:Class, importable here (docs/laws.md)"
        ) from error
    if missing := [method for method in ("act", "learn", "report") if not callable(getattr(law, method, None))]:
        raise UserError(f"law {name}: has no {', '.join(missing)}(); a law has act, learn and report (docs/laws.md)")
    return law


def _all_or(k: int, nodes: list[int]) -> Index | None:
    return None if nodes == list(range(k)) else np.array(nodes, dtype=np.int64)


class Shard:
    """Closes the sample of t - 1 and acts at t, for all its nodes at once.

    Incidences (a node and one of its edges) are ordered by node and then by neighbour, as in the plant, so that
    a flow is the same sum, bit for bit, in every layout of the network over processes.
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self._law = new_law(view)
        self.k = len(view.nodes)
        own = {node.id: i for i, node in enumerate(view.nodes)}
        heard = [node for peer in view.peers for node in peer.hear]
        column = own | {node: self.k + i for i, node in enumerate(heard)}
        home = {node: p for p, peer in enumerate(view.peers) for node in peer.hear}
        incidences = [(i, j) for i, node in enumerate(view.nodes) for j in node.neighbours]
        self.m = len(incidences)
        self._row: Index = np.array([i for i, _ in incidences], dtype=np.int64)
        self._ends: Index = np.array([self._row, [column[j] for _, j in incidences]], dtype=np.int64)
        """Per incidence: where the inputs of its two ends stand among our own and the heard ones, (2, m)."""
        self._peer: Index = np.array([home.get(j, -1) for _, j in incidences], dtype=np.int64)
        self.say = [_all_or(self.k, [own[node] for node in peer.say]) for peer in view.peers]
        """Per peer: which of our nodes stand in a link message to it; None for all of them, in order."""
        self._everybody: Sequence[int] = range(len(view.peers))
        self._up = bytes([ALL_UP]) * self.m
        self.x: Array = np.zeros(self.k)
        self.u: Array = np.zeros(self.k)
        self.report: Array = np.full((self.k, REPORT_WIDTH), np.nan)
        """What the nodes say of themselves at the last step."""

    def start(self, x: Array) -> Array:
        """u(0): there is no sample to close yet."""
        return self._act(x)

    def step(self, x: Array, flags: bytes, u: Array) -> Array:
        """u(t), (k,), from x(t) (k,), the Flag bits of t - 1 (m,), and the inputs of t - 1.

        `u`, (k + h,), holds our own inputs and then those heard from all peers. One that was not heard is NaN: so is
        the flow that it enters, and a sample without its flow is skipped.
        """
        own, other = u.take(self._ends)
        if flags != self._up:
            bits = np.frombuffer(flags, np.uint8)
            own = np.where(bits & _OPEN, own, 0.0)
            other = np.where(bits & _OPEN, np.where(bits & _HEAR, other, np.nan), 0.0)
        difference = own - other
        try:
            flow: Array = np.bincount(self._row, difference, self.k)  # type: ignore[assignment]  # weighted: floats
            self._law.learn(self.x, flow, x)
        except Exception as error:
            raise self._failed("learn", f"raised {type(error).__name__}: {error}") from error
        return self._act(x)

    def _act(self, x: Array) -> Array:
        try:
            u = np.asarray(self._law.act(x), dtype=float)
            self.report = np.asarray(self._law.report(), dtype=float)
        except Exception as error:
            raise self._failed("act", f"raised {type(error).__name__}: {error}") from error
        if u.shape != (self.k,) or not math.isfinite(np.add.reduce(u)):
            raise self._failed("act", f"gave {u} for the states {x}, and an input is a number a node")
        if self.report.shape != (self.k, REPORT_WIDTH):
            raise self._failed("report", f"has the shape {self.report.shape}, and not {(self.k, REPORT_WIDTH)}")
        self.x, self.u = x, u
        return u

    def _failed(self, method: str, what: str) -> LawError:
        nodes = ", ".join(str(node.id) for node in self._view.nodes[:8])
        return LawError(f"law {self._view.law}: {method}() of node {nodes} {what}")

    def peers_with(self, bit: Flag, flags: bytes) -> Sequence[int]:
        """Peers to whom at least one incidence has `bit` set."""
        if flags == self._up:
            return self._everybody
        marked = np.frombuffer(flags, np.uint8) & np.uint8(bit) != 0
        return [int(p) for p in np.unique(self._peer[marked]) if p >= 0]
