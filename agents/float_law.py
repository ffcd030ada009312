"""The step of a few nodes in Python's floats: equations (6) and (7) without numpy.

A step is quiet if every edge is open, every message of the step before is there, and nothing is learned late. Almost
every step is. An array of one number costs as much as one of a hundred. So a shard of a few nodes makes its quiet steps
here. The paper's law is below, and the other laws of the project are in agents.float_rules. With the law of the paper,
steps with dropped or late messages are made here too (agents.waiting). Other steps, and laws of other classes, use the
general path (agents.samples and the law itself). `leave` passes everything to the general path. Both ways give the
same bits, because they do the same operations in the same order.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import inf, isfinite, nan
from typing import NamedTuple

import numpy as np

from hedgerow.agents.float_rule import Rule, Sample
from hedgerow.agents.law import Array, Law, Minimax
from hedgerow.agents.local import asks
from hedgerow.agents.samples import Samples
from hedgerow.agents.view import View
from hedgerow.agents.waiting import MOST_WAITING, Row, Waiting
from hedgerow.wire.codec import Form, decode_link, decode_spans
from hedgerow.wire.message import REPORT_ROWS, Flag, Kind, Link, Span

FEW_NODES = 8
MOST_INCIDENCES = 24
"""with more, numpy is as fast"""
STEPS_BEFORE = 4
"""steps in a row that the general path made and floats could have made, before floats take over; to change over costs
as much as two general steps
"""


class _Node(NamedTuple):
    """A node: its gain, its models in list order, and its incidences as (own place, neighbour's place, weight)."""

    b: float
    candidates: Sequence[float]
    incidences: Sequence[tuple[int, int, float]]
    rule: Rule | None
    """of a law other than `Minimax`"""


class FloatLaw:
    """The law of a few nodes, and their last states, inputs and reports, in floats."""

    def __init__(self, view: View, law: Law, rules: Sequence[Rule | None]) -> None:
        k, weights = view.k, view.weights
        w = [1.0] * len(view.row) if weights is None else weights.tolist()
        incidences: list[list[tuple[int, int, float]]] = [[] for _ in range(k)]
        for i, j, weight in zip(view.row.tolist(), view.column.tolist(), w, strict=True):
            incidences[i].append((i, j, weight))
        gains = view.b.tolist() if isinstance(view.b, np.ndarray) else [float(view.b)] * k
        columns = [column[~np.isnan(column)].tolist() for column in view.candidates.T]
        self._nodes = [_Node(*one) for one in zip(gains, columns, incidences, rules, strict=True)]
        self._law, self._height = law, len(law.memory)
        self._receives = [peer.receives for peer in view.peers]
        self._sends: list[list[int]] = [peer.sends.tolist() for peer in view.peers]
        self._asks = asks(law.learn, "sample")
        self._rows = [struct.Struct(f"<{peer.receives}d") for peer in view.peers]
        self._J: Sequence[list[float]] = ()
        self.is_active = False
        """True while the steps are made here: the newest costs J are here, and not in the law"""
        self.x: Sequence[float] = ()
        """states of the last step, (k,)"""
        self.states: Sequence[float] = ()
        """states of the sample learned last: our own, and for a law that asks the peers' behind them"""
        self.u: Sequence[float] = ()
        """inputs of the last step, (k,)"""
        self.report: Sequence[float] = ()
        """ahat and then the margins of the last step, (2k,)"""
        self.waiting = Waiting(view) if view.history > MOST_WAITING and isinstance(law, Minimax) else None
        """the samples that wait for rows; None for other laws and short histories, which wait in the general path"""
        self._nothing = [nan] * (sum(self._receives))
        self._possible = 0
        """number of steps of the general path in a row that could have been made here"""

    @classmethod
    def of(cls, view: View, law: Law) -> FloatLaw | None:
        """Return the law of a view in floats; None if its nodes are too many, or its law is of another class."""
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
            from hedgerow.agents.float_rules import rule_of  # noqa: PLC0415 (it loads every law of the project)

            rules = [rule_of(law, node) for node in range(view.k)]
            if None in rules:
                return None
        return cls(view, law, rules)

    @property
    def waits(self) -> bool:
        """Return True if a sample waits for a row."""
        return self.waiting is not None and self.waiting.most > 0

    def can_make(self, flags: bytes, spans: Sequence[Span]) -> bool:
        """Return True if the step after a state with these flags and spans can be made here."""
        if not flags and not spans:
            return True
        return self.waiting is not None and all(bits & Flag.OPEN for bits in flags)

    def enter_after(self, possible: bool, x: Array, u: Array, report: Array, samples: Samples | None = None) -> None:
        """Count a step that the general path made; after some possible ones in a row, make the next steps here.

        A step is possible if it could be made here. The samples that wait in `samples` come here, too.
        """
        self._possible = self._possible + 1 if possible else 0
        if self._possible < STEPS_BEFORE or not isfinite(sum(x.tolist()) + sum(u.tolist())):
            return
        if samples is not None and not self._enter_waiting(samples):
            return
        self.x, self.u, self.report = x.tolist(), u.tolist(), report.ravel().tolist()
        memory = self._law.memory.T.tolist()
        self._J = [
            J[: len(node.candidates)] if node.rule is None else J for J, node in zip(memory, self._nodes, strict=True)
        ]
        self.is_active = True

    def _enter_waiting(self, samples: Samples) -> bool:
        """Take the samples that wait; return False, with nothing changed, if that is impossible."""
        if self.waiting is None:
            return samples.complete
        learned = None if samples.complete else samples.unlearned
        if not self.waiting.enter(samples.last(MOST_WAITING), learned):
            return False
        samples.forget_last(self.waiting.most)
        return True

    def leave(self) -> None:
        """Hand what was learned back to the law; `waiting` still holds the samples that wait."""
        J = np.full((self._height, len(self._nodes)), np.inf)
        for column, own in zip(J.T, self._J, strict=True):
            column[: len(own)] = own
        self._law.memory = J
        self._J, self._possible, self.is_active = (), 0, False

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
        made = []
        for node, J, now, before in zip(self._nodes, self._J, states, self.x, strict=False):
            if node.rule is None:
                learned = _learned(node, J, row, before, now)
                u, ahat, margin = _acted(node, learned, now)
            else:
                try:
                    moved = now - node.b * _flow(node, row)
                    learned, u, ahat, margin = node.rule(J, Sample(past, before, moved, node.b * now))
                except (ArithmeticError, ValueError):  # numpy has inf or NaN there
                    return None
            if not isfinite(u + sum(learned)):
                return None
            made.append((learned, u, ahat, margin))
        self.states = [*self.x, *self._states_of(links)] if self._asks else self.x
        if self.waiting is not None:
            self.waiting.rows.append(Row(self.x, row))
        self._J, self.u, estimates, margins = zip(*made, strict=False)
        self.x, self.report = states, estimates + margins
        return row

    def step_with_gaps(
        self,
        states: Sequence[float],
        links: Sequence[Link | bytes | None],
        past: int,
        flags: bytes,
        spans: Sequence[Span],
    ) -> tuple[bytes, list[Row]] | None:
        """Learn all samples that are complete now, and act, as `step` does, if rows are missing or arrive late.

        `flags` (m,) and `spans` are those of the state message. Return the Flag bits of the inputs used, and the rows
        in which no sample waits any more. Return None, and change nothing, if the general path has to make the step.
        """
        waiting = self.waiting
        if waiting is None or not isfinite(sum(states)):
            return None
        if (arrivals := waiting.arrivals(past, links, flags, spans)) is None:
            return None
        rows = waiting.rows
        rows.append(Row(self.x, [*self.u, *self._nothing]))
        missing, used = waiting.fill(arrivals)
        counts = waiting.counts_with(missing)
        made = []
        for i, (node, J, now) in enumerate(zip(self._nodes, self._J, states, strict=True)):
            learned = J
            # An example, with k as the index in `rows`, where -1 is the row of t - 1:
            #   two samples waited before this step (`waiting.counts`): those of -3 and -2
            #   one waits after it (`counts`): that of -1
            #   so those of -3 and -2 are learned now: range(-1 - 2, -1)
            for k in range(-1 - waiting.counts[i], -counts[i]):
                x, row = rows[k]
                learned = _learned(node, learned, row, x[i], now if k == -1 else rows[k + 1].x[i])
            u, ahat, margin = _acted(node, learned, now)
            if not isfinite(u + sum(learned)):
                rows.pop()
                return None
            made.append((learned, u, ahat, margin))
        most = max(counts)
        learned_rows = [rows[k] for k in range(-1 - waiting.most, -most)]
        waiting.missing, waiting.counts, waiting.most = missing, counts, most
        self._J, self.u, estimates, margins = zip(*made, strict=False)
        self.x, self.report = states, estimates + margins
        return used, learned_rows

    def has_rows(self, t: int, first: int) -> bool:
        """Return True if our rows from step `first` to t - 1 are here, and t is the last step."""
        return first == t or (self.waiting is not None and t - first <= len(self.waiting.rows))

    def rows(self, t: int, first: int, last: int, peer: int) -> tuple[list[float], list[float]]:
        """Return the states and inputs of steps first to last for a peer, row by row; t is the last step made."""
        nodes = self._sends[peer]
        if first == last == t:
            return [self.x[i] for i in nodes], [self.u[i] for i in nodes]
        x: list[float] = []
        u: list[float] = []
        for step in range(first, last + 1):
            row_x, row_u = (self.x, self.u) if step == t or self.waiting is None else self.waiting.rows[step - t]
            x += [row_x[i] for i in nodes]
            u += [row_u[i] for i in nodes]
        return x, u

    def _states_of(self, links: Sequence[Link | bytes]) -> list[float]:
        """Return the peers' newest states in their messages."""
        states: list[float] = []
        for numbers, link, count in zip(self._rows, links, self._receives, strict=True):
            rows = (decode_link(link, count) if isinstance(link, bytes) else link).x
            states += numbers.unpack_from(rows, len(rows) - numbers.size)
        return states


def _flow(node: _Node, inputs: Sequence[float]) -> float:
    """Return the flow of a node, from all inputs of a row."""
    flow = 0.0
    for i, j, weight in node.incidences:
        flow += weight * (inputs[i] - inputs[j])
    return flow


def _learned(node: _Node, J: Sequence[float], inputs: Sequence[float], x: float, x_next: float) -> list[float]:
    """Return the costs after one more sample, equation (7)."""
    moved = x_next - node.b * _flow(node, inputs)
    return [J_a + (residual := a * x - moved) * residual for J_a, a in zip(J, node.candidates, strict=False)]


def _acted(node: _Node, J: list[float], x: float) -> tuple[float, float, float]:
    """Return the input of equation (6), ahat and the margin."""
    ordered = sorted(J)
    least = ordered[0]
    # index() finds the first of equal costs, so a tie goes to the candidate listed first.
    ahat = node.candidates[J.index(least)]
    return node.b * x / (ahat - 1.0), ahat, ordered[1] - least if len(ordered) > 1 else inf


class FloatForms:
    """The messages of a quiet step: a state is taken apart and an answer packed without numpy."""

    def __init__(self, k: int, audience: Sequence[Sequence[int] | None]) -> None:
        """`audience` are, by link message, the nodes in it, None for all."""
        self._state = Form(Kind.STATE, k, k)
        self.quiet_bytes = self._state.size
        """the size of a state message without flags"""
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

    def state(self, message: bytes, t: int, m: int) -> tuple[Sequence[float], bytes, Sequence[Span]] | None:
        """Return the states, flags and spans in a message if it is the state message of t, with m flags or none.

        Return None if it is not.
        """
        form, stop = self._state, self._state.size + m
        if len(message) not in (form.size, stop) and len(message) < stop:
            return None
        spans = decode_spans(message, stop, m) if len(message) > stop else []
        if spans is None:
            return None
        code, step, *states = form.unpack_from(message)
        return (states, message[form.size : stop], spans) if code == form.code and step == t else None

    def pack(self, t: int, x: Sequence[float], u: Sequence[float], report: Sequence[float]) -> list[bytes]:
        """Return the link messages of step t, and behind them the input message."""
        messages = []
        for form, nodes in self._links:
            if nodes is None:
                messages.append(form.pack(form.code, t, t, *x, *u))
            else:
                messages.append(form.pack(form.code, t, t, *[x[i] for i in nodes], *[u[i] for i in nodes]))
        messages.append(self.input(t, u, report))
        return messages

    def input(self, t: int, u: Sequence[float], report: Sequence[float]) -> bytes:
        """Return the input message of step t, without Flag bits."""
        return self._input.pack(self._input.code, t, *u, *report)
