"""The quiet step of a few nodes in Python's floats: equations (6) and (7) without numpy.

A step is quiet if every edge is open, every message of the step before is there, and nothing is learned late. Almost
every step is. An array of one number costs as much as one of a hundred, so a shard of a few nodes makes its quiet steps
here: those of the paper's law below, those of the other laws of the project in agents.quiet_laws. Other steps, and
laws of other classes, use the general path (agents.samples and the law itself); `settle` passes
everything learned to it. Both ways give the same bits, because they do the same operations in the same order.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import inf, isfinite, nan
from typing import NamedTuple

import numpy as np

from hedgerow.agents.law import Array, Law, Minimax
from hedgerow.agents.local import asks
from hedgerow.agents.quiet_rule import Rule, Sample
from hedgerow.agents.view import View
from hedgerow.wire.codec import Form, decode_link
from hedgerow.wire.message import REPORT_ROWS, Kind, Link

FEW_NODES = 4
MOST_INCIDENCES = 24
"""with more, numpy is as fast"""
PATIENCE = 4
"""quiet steps in a row before floats take over; to change over costs as much as two general steps"""


class _Node(NamedTuple):
    """A node: its gain, its models in list order, and its incidences as (own place, neighbour's place, weight)."""

    b: float
    candidates: Sequence[float]
    incidences: Sequence[tuple[int, int, float]]
    rule: Rule | None
    """of a law other than `Minimax`"""


class QuietLaw:
    """The law of a few nodes, and their last states, inputs and reports, in floats."""

    def __init__(self, view: View, law: Law, rules: Sequence[Rule | None]) -> None:
        k, weights = view.k, view.weights
        w = [1.0] * len(view.row) if weights is None else weights.tolist()
        incidences: list[list[tuple[int, int, float]]] = [[] for _ in range(k)]
        for i, j, weight in zip(view.row.tolist(), view.column.tolist(), w, strict=True):
            incidences[i].append((i, j, weight))
        gains = np.broadcast_to(np.asarray(view.b, dtype=float), k).tolist()
        columns = [column[~np.isnan(column)].tolist() for column in view.candidates.T]
        self._nodes = [_Node(*one) for one in zip(gains, columns, incidences, rules, strict=True)]
        self._law, self._height = law, len(law.memory)
        self._receives = [peer.receives for peer in view.peers]
        self._asks = asks(law.learn, "sample")
        self._rows = [struct.Struct(f"<{peer.receives}d") for peer in view.peers]
        self._J: list[list[float]] = []
        self.holds = False
        """True while the newest memory is here, and not in the law"""
        self.x: Sequence[float] = ()
        """states of the last step, (k,)"""
        self.states: Sequence[float] = ()
        """states of the sample learned last: our own, and for a law that asks the peers' behind them"""
        self.u: Sequence[float] = ()
        """inputs of the last step, (k,)"""
        self.report: Sequence[float] = ()
        """ahat and then the margins of the last step, (2k,)"""
        self._quiet = 0
        """number of quiet steps of the general path in a row"""

    @classmethod
    def of(cls, view: View, law: Law) -> QuietLaw | None:
        """Return the quiet law of a view; None if its nodes are too many, or its law is of another class."""
        if view.k > FEW_NODES or len(view.row) > MOST_INCIDENCES:
            return None
        # Python raises an error where numpy divides by zero. Only the end of a candidate list may have padding.
        listed = ~np.isnan(view.candidates)
        if (view.candidates == 1).any() or (listed[1:] & ~listed[:-1]).any() or not listed[0].all():
            return None
        rules: list[Rule | None] = [None] * view.k
        if type(law) is not Minimax:
            if not listed.all():  # the rules of other laws know lists of one length only
                return None
            from hedgerow.agents.quiet_laws import rule_of  # noqa: PLC0415 (it loads every law of the project)

            rules = [rule_of(law, node) for node in range(view.k)]
            if None in rules:
                return None
        return cls(view, law, rules)

    def after(self, was_quiet: bool, x: Array, u: Array, report: Array) -> None:
        """Count a step that the general path made; after some quiet ones, take over its memory, states and inputs."""
        self._quiet = self._quiet + 1 if was_quiet else 0
        if self._quiet < PATIENCE:
            return
        self.x, self.u, self.report = x.tolist(), u.tolist(), report.ravel().tolist()
        if isfinite(sum(self.x) + sum(self.u)):
            memory = self._law.memory.T.tolist()
            self._J = [
                J[: len(node.candidates)] if node.rule is None else J
                for J, node in zip(memory, self._nodes, strict=True)
            ]
            self.holds = True

    def settle(self) -> None:
        """Hand everything learned back to the law."""
        J = np.full((self._height, len(self._nodes)), np.inf)
        for column, own in zip(J.T, self._J, strict=True):
            column[: len(own)] = own
        self._law.memory = J
        self._J, self._quiet, self.holds = [], 0, False

    def step(self, states: Sequence[float], links: Sequence[Link | bytes], past: int) -> Sequence[float] | None:
        """Learn the sample of t - 1, equation (7), and act at t, equation (6), for the states x(t), (k,).

        `past` is t - 1, and `links` are the peers' messages of that step, decoded or not. Return the inputs of t - 1
        that make the flow: our own, then the peers'. Return None, and change nothing, if a number is missing or too
        large.
        """
        row = [*self.u]
        for numbers, link in zip(self._rows, links, strict=False):
            rows = link if isinstance(link, bytes) else link.u
            row += numbers.unpack_from(rows, len(rows) - numbers.size)  # the newest inputs come last in both
        costs, inputs, estimates, margins = [], [], [], []
        for (b, candidates, incidences, rule), J, now, before in zip(
            self._nodes, self._J, states, self.x, strict=False
        ):
            flow = 0.0
            for i, j, weight in incidences:
                flow += weight * (row[i] - row[j])
            moved = now - b * flow
            if rule is not None:
                try:
                    learned, u, ahat, margin = rule(J, Sample(past, before, moved, b * now))
                except (ArithmeticError, ValueError):  # numpy has inf or NaN there
                    return None
                if not isfinite(u + sum(learned)):
                    return None
                costs.append(learned)
                inputs.append(u)
                estimates.append(ahat)
                margins.append(margin)
                continue
            learned = [J_a + (residual := a * before - moved) * residual for J_a, a in zip(J, candidates, strict=False)]
            ordered = sorted(learned)
            least = ordered[0]
            # index() finds the first of equal costs, so a tie goes to the candidate listed first.
            ahat = candidates[learned.index(least)] if isfinite(sum(learned)) else nan
            u = b * now / (ahat - 1.0)
            if not isfinite(u):
                return None
            costs.append(learned)
            inputs.append(u)
            estimates.append(ahat)
            margins.append(ordered[1] - least if len(ordered) > 1 else inf)
        self.states = [*self.x, *self._states_of(links)] if self._asks else self.x
        self._J, self.x, self.u, self.report = costs, states, inputs, estimates + margins
        return row

    def _states_of(self, links: Sequence[Link | bytes]) -> list[float]:
        """Return the peers' newest states in their messages."""
        states: list[float] = []
        for numbers, link, count in zip(self._rows, links, self._receives, strict=True):
            rows = (decode_link(link, count) if isinstance(link, bytes) else link).x
            states += numbers.unpack_from(rows, len(rows) - numbers.size)
        return states


class QuietForms:
    """The messages of a quiet step: a state is taken apart and an answer packed without numpy."""

    def __init__(self, k: int, audience: Sequence[Sequence[int] | None]) -> None:
        """`audience` are, by link message, the nodes in it, None for all."""
        self._state = Form(Kind.STATE, k, k)
        self._input = Form(Kind.INPUT, k, (1 + REPORT_ROWS) * k)
        sizes = [k if nodes is None else len(nodes) for nodes in audience]
        self._links = [(Form(Kind.LINK, n, 2 * n), nodes) for n, nodes in zip(sizes, audience, strict=True)]

    def states(self, message: bytes, t: int) -> Sequence[float] | None:
        """Return the states in a message if it is the state message of t without flags; None if it is not."""
        form = self._state
        if len(message) != form.size:
            return None
        code, step, *states = form.unpack(message)
        return states if code == form.code and step == t else None

    def pack(self, t: int, x: Sequence[float], u: Sequence[float], report: Sequence[float]) -> list[bytes]:
        """Return the link messages of step t, and behind them the input message."""
        messages = []
        for form, nodes in self._links:
            if nodes is None:
                messages.append(form.pack(form.code, t, t, *x, *u))
            else:
                messages.append(form.pack(form.code, t, t, *[x[i] for i in nodes], *[u[i] for i in nodes]))
        messages.append(self._input.pack(self._input.code, t, *u, *report))
        return messages
