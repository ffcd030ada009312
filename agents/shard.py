"""The shard of one agent process: k >= 1 nodes, their law and the messages received.

A shard of one node is not a special case.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np

from hedgerow.agents.float_law import FloatForms, FloatLaw
from hedgerow.agents.law import Array, Law
from hedgerow.agents.law_lines import line_of, place_of, running
from hedgerow.agents.loading import LawError, new_law, reals
from hedgerow.agents.local import asks
from hedgerow.agents.newest import Newest
from hedgerow.agents.peer import Peer
from hedgerow.agents.samples import LateRows, Samples
from hedgerow.agents.view import View
from hedgerow.topologies.graph import Index, all_finite
from hedgerow.wire import crash
from hedgerow.wire.codec import encode_input, encode_link, gather, link_step, pack_link
from hedgerow.wire.message import ALL_UP, LATE, MOST_LATE, REPORT_ROWS, TAKEN, Flag, Link, Mask, Record, Span, State

_TAKEN_OF = bytes(flags & TAKEN for flags in range(256))
_SILENCE = struct.pack("<d", math.nan)
_SEND = int(Flag.SEND)


class Shard:
    """The nodes of one process; at step t they close the sample of t - 1 and act, all at once.

    `receive_message` takes link messages of peers, and `recall` takes the plant's record of nodes that come back. If
    `awaits` is empty, make the `step` of the state and `send` the link messages; `answer` is a step and its inputs.
    Incidences (a node and one of its edges) are ordered by node and then by neighbour, as in the plant. A flow is
    therefore the same sum, bit for bit, in every layout of the network over processes.
    """

    def __init__(self, view: View, law: Law | None = None) -> None:
        """Take the law of the view, or a `law` that is there already."""
        self._view = view
        self._law = new_law(view) if law is None else law
        self.k, self.m = view.k, len(view.row)
        self.degrees: Index = np.bincount(view.row, minlength=self.k)
        self._row = view.row
        ends: Index = np.stack([view.row, view.column])
        """Per incidence: the indices of its two ends in our own inputs followed by the peers' inputs, (2, m)."""
        stops = [self.k, *(self.k + np.cumsum([peer.receives for peer in view.peers], dtype=np.int64)).tolist()]
        outside = np.flatnonzero(view.column >= self.k)
        peer_of = np.searchsorted(stops, view.column[outside], side="right") - 1
        self.peers = [
            Peer(
                nodes=None if np.array_equal(peer.sends, np.arange(self.k)) else peer.sends,
                sends=len(peer.sends),
                receives=peer.receives,
                start=stops[p],
                incidences=outside[peer_of == p].tolist(),
            )
            for p, peer in enumerate(view.peers)
        ]
        everything = [p for p, peer in enumerate(self.peers) if peer.nodes is None]
        self.audience: list[tuple[Index | None, Sequence[int]]] = [(None, everything)] if everything else []
        """Peers that receive the same message: all peers that receive every node share one."""
        self.audience += [(peer.nodes, [p]) for p, peer in enumerate(self.peers) if peer.nodes is not None]
        self._peer_of = {c: peer for peer in self.peers for c in peer.incidences}
        """By incidence: the peer that it leads to."""
        self._up = bytes([ALL_UP]) * self.m
        self._samples = Samples(self._law, view.history, self._row, ends, stops[-1], view.weights)
        self._newest = Newest(view, self._samples) if asks(self._law.act, "now") else None
        """the newest values of the neighbours, for a law that acts on them"""
        self._floats = FloatLaw.of(view, self._law)
        """makes the quiet steps of a few nodes; None for other shards and laws"""
        self._forms = FloatForms(self.k, [None if nodes is None else nodes.tolist() for nodes, _ in self.audience])
        self._record: Record | None = None
        self.t = -1
        """The last step answered."""
        self._x: Array = np.zeros(self.k)
        self._u: Array = np.zeros(self.k)
        self._report: Array = np.full((REPORT_ROWS, self.k), np.nan)
        self._behind = False
        """True while these three are of an older step, and the law in floats has the newest"""
        self.used = b""
        """The used inputs of the step before: Flag bits by incidence; empty if every input was used."""

    # Incoming messages.

    def receive(self, peer: int, link: Link) -> None:
        """Keep a link message of a peer until its step is closed.

        If there are too many, drop the one of the latest step.
        """
        if link.t >= self.t:
            self.peers[peer].keep(link.t, link)

    def receive_message(self, peer: int, message: bytes) -> None:
        """Keep the bytes of a link message, as `receive` does; raise MessageError if they are malformed."""
        own = self.peers[peer]
        if (t := link_step(message, own.receives)) >= self.t:
            own.keep(t, message)

    def recall(self, record: Record) -> None:
        """Keep the plant's record of nodes that come back at `record.t`."""
        if record.t > self.t:
            self._record = record

    def follows(self, state: State) -> bool:
        """Return True if a state is the next to answer; a shard that comes back begins at the step of its record."""
        return state.t == self.t + 1 or (self._record is not None and self._record.t == state.t)

    def awaits(self, state: State) -> list[int]:
        """Return the peers that owe a link message of t - 1: the plant's flags deliver it, and it has not arrived."""
        past, flags = state.t - 1, state.flags
        late = [p for p, peer in enumerate(self.peers) if past not in peer.mail] if state.t else []
        if late and flags:
            late = [p for p in late if any(flags[c] & Flag.RECEIVE for c in self.peers[p].incidences)]
        return late

    # A step.

    def answer(self, state: State) -> Array:
        """Close the sample of t - 1 and return u(t), (k,), for the state of t; call it once no peer is awaited."""
        self.step(state)
        return self.u

    def step(self, state: State) -> None:
        """Make the step of `answer`, and return nothing: arrays of a step in floats would be made for it."""
        t, x, floats = state.t, state.x, self._floats
        if floats is not None and floats.is_active:
            if t == self.t + 1 and self._step_in_floats(state, floats):
                return
            self._leave_floats(floats)
        record = self._record if self._record is not None and self._record.t == t else None
        try:
            if record is not None:
                self._restore(record)
            if t > 0:
                self._close(state, record.returning if record is not None else None)
        except (Exception, SystemExit) as error:
            raise self._raised("learn", error) from error
        self._record = None
        u = self._act(t, x)
        if floats is not None:
            possible = t > 0 and record is None and floats.can_make(state.flags, state.spans)
            floats.enter_after(possible, x, u, self._report, self._samples)

    def answer_quietly(self, message: bytes) -> list[bytes] | None:
        """Return the answer to a state message: one link message per entry of `audience`, and the input message.

        Return None, with nothing changed, if the step is not quiet: then decode the message and call `answer`.
        """
        floats = self._floats
        if floats is None or not floats.is_active or (x := self._forms.states(message, self.t + 1)) is None:
            return None
        if not self._step_quietly(x, floats):
            return None
        return self._forms.pack(self.t, x, floats.u, floats.report)

    def answer_with_gaps(self, message: bytes) -> tuple[list[tuple[Sequence[int], bytes]], bytes] | None:
        """Return the answer to a state message, as `messages` does, if floats can make its step.

        Return None, with nothing changed, if they cannot: then decode the message and call `answer`.
        """
        floats = self._floats
        if floats is None or not floats.is_active:
            return None
        if not floats.waits and len(message) == self._forms.quiet_bytes:
            return None  # a quiet state, often before its link messages: do not take it apart once more
        if (state := self._forms.state(message, self.t + 1, self.m)) is None:
            return None
        x, flags, spans = state
        if not self._step_with_gaps(x, flags, spans, floats):
            return None
        return self._packed(flags, spans, floats) or self.messages(State(self.t, self.x, flags, spans))

    def _step_quietly(self, x: Sequence[float], floats: FloatLaw) -> bool:
        """Make the next step without numpy and return True; False, with nothing changed, if the step is not quiet."""
        past = self.t
        if self._record is not None or floats.waits:
            return False
        links = [peer.mail.get(past) for peer in self.peers]
        if None in links or (inputs := floats.step(x, links, past)) is None:  # type: ignore[arg-type]  # none is None
            return False
        for peer in self.peers:
            del peer.mail[past]
        self._samples.append_learned(floats.states, inputs)
        self.t, self.used, self._behind = past + 1, b"", True
        return True

    def _step_in_floats(self, state: State, floats: FloatLaw) -> bool:
        """Make the next step without numpy and return True; False, with nothing changed, if floats cannot make it."""
        x: list[float] = state.x.tolist()
        if not (state.flags or state.spans or floats.waits):
            return self._step_quietly(x, floats)
        return self._step_with_gaps(x, state.flags, state.spans, floats)

    def _step_with_gaps(self, x: Sequence[float], flags: bytes, spans: Sequence[Span], floats: FloatLaw) -> bool:
        """Make the next step in floats and return True; False, with nothing changed, if they cannot make it."""
        past = self.t
        if self._record is not None:
            return False
        links = [peer.mail.get(past) for peer in self.peers]
        if (taken := floats.step_with_gaps(x, links, past, flags or self._up, spans)) is None:
            return False
        for peer in self.peers:
            peer.mail.pop(past, None)
        self.used, learned = taken
        for row in learned:
            self._samples.append_learned(*row)
        self.t, self._behind = past + 1, True
        return True

    def _leave_floats(self, floats: FloatLaw) -> None:
        """Have the law, the samples and the arrays hold the newest numbers again."""
        self._refresh()
        floats.leave()
        if (waiting := floats.waiting) is not None and waiting.most:
            self._samples.wait(*waiting.leave())

    def _refresh(self) -> None:
        if self._behind and (floats := self._floats) is not None:
            self._x, self._u = np.array(floats.x), np.array(floats.u)
            self._report, self._behind = np.array(floats.report).reshape(REPORT_ROWS, -1), False

    @property
    def x(self) -> Array:
        """Return the states of the last step, (k,)."""
        self._refresh()
        return self._x

    @property
    def u(self) -> Array:
        """Return the inputs of the last step, (k,)."""
        self._refresh()
        return self._u

    @property
    def report(self) -> Array:
        """Return the law's report of the nodes at the last step, (REPORT_ROWS, k)."""
        self._refresh()
        return self._report

    def replace_inputs(self, u: Array) -> None:
        """Continue as if the inputs of the last step had been `u`, (k,)."""
        if self._floats is not None and self._floats.is_active:
            self._leave_floats(self._floats)
        self._u = u

    def _restore(self, record: Record) -> None:
        """Restore the memory of the nodes that come back from the record; keep the mail, because it may be for them."""
        returning = record.returning
        for peer in self.peers:
            for t in [t for t in peer.mail if t < record.t - 1]:
                del peer.mail[t]
        anew = self.t != record.t - 1
        if anew:
            self._x, self._u = np.full(self.k, np.nan), np.full(self.k, np.nan)
        self._samples.restore(record, anew)
        self._x, self._u = self._x.copy(), self._u.copy()
        if self._newest is not None:
            self._newest.forget(np.ones(self.m, dtype=bool) if anew else returning[self._row])
        if len(record.x):
            self._x[returning], self._u[returning] = record.x[-1], record.u[-1]
        else:
            self._x[returning] = self._u[returning] = np.nan

    def _close(self, state: State, returning: Mask | None) -> None:
        """Learn earlier samples that are now complete, then the sample of t - 1."""
        past = state.t - 1
        links = [peer.take(past) for peer in self.peers]
        if not state.flags and not state.spans and self._samples.complete and returning is None:
            self.used = b""
            # The last row of each message is its newest; here it should be the only one.
            last_rows = [
                link.u[-8 * peer.receives :] for link, peer in zip(links, self.peers, strict=True) if link is not None
            ]
            inputs = gather([self._u, *last_rows]) if links else self._u
            states = self._states(links)
            if self._newest is not None and states is not None:
                self._newest.note(past, states, inputs, self._up, ())
            self._samples.take(past, self._x, inputs, state.x, states)
            return
        # The newest row of a link message is that of t - 1, unless the link is late.
        last_rows = [
            _SILENCE * peer.receives if link is None else link.u[-8 * peer.receives :]
            for link, peer in zip(links, self.peers, strict=True)
        ]
        used = bytearray((state.flags or self._up).translate(_TAKEN_OF))
        late_rows: list[LateRows] = []
        for c, late, back, _, _ in state.spans:
            if used[c] & Flag.RECEIVE:
                last = past - late
                late_rows.append(self._received(c, links, last - back, min(last + 1, past)))
                if late:
                    used[c] -= Flag.RECEIVE
        plain = bytes(used)
        # A law that does not learn acts alike under every delay: only this count shows which rows arrived when.
        for c, start, stop, *_ in late_rows:
            used[c] |= min(max(stop - start, 0), MOST_LATE) << LATE
        self.used = bytes(used)
        inputs, states = gather([self._u, *last_rows]), self._states(links)
        if self._newest is not None and states is not None:
            self._newest.note(past, states, inputs, self.used, late_rows)
        self._samples.take_late(past, self._x, inputs, plain, state.x, late_rows, returning, states)

    def _states(self, links: Sequence[Link | None]) -> Array | None:
        """Return our own states followed by the peers' states of the same step, for a law that asks; otherwise None."""
        if self._newest is None and not self._samples.asks:
            return None
        rows = [
            _SILENCE * peer.receives if link is None else link.x[-8 * peer.receives :]
            for link, peer in zip(links, self.peers, strict=True)
        ]
        return gather([self._x, *rows])

    def _received(self, c: int, links: Sequence[Link | None], start: int, stop: int) -> LateRows:
        """Return the rows of steps start to stop - 1 that arrived over an incidence."""
        if (peer := self._peer_of.get(c)) is None or (link := links[self.peers.index(peer)]) is None:
            return LateRows(c, start, stop)
        start, place = max(start, link.first), self._view.column[c] - peer.start
        inputs, states = (
            gather([rows]).reshape(-1, peer.receives)[start - link.first : stop - link.first, place]
            for rows in (link.u, link.x)
        )
        return LateRows(c, start, start + len(inputs), inputs, states)

    def _act(self, t: int, x: Array) -> Array:
        method = "act"
        try:
            now = [] if self._newest is None else [self._newest.at(t)]
            u = reals(self._law.act(x, *now))  # a copy: the shard keeps it, and the law may reuse its array
            method = "report"
            self._report = np.asarray(self._law.report(), dtype=float)
        except (Exception, SystemExit) as error:
            raise self._raised(method, error) from error
        if u.shape != (self.k,) or not all_finite(u):
            u = self._without_blind(x, u)
        if self._report.shape != (REPORT_ROWS, self.k):
            raise self._failed("report", f"has the shape {self._report.shape}, and not {(REPORT_ROWS, self.k)}")
        self.t, self._x, self._u = t, x, u
        return u

    def _without_blind(self, x: Array, u: Array) -> Array:
        """Return the inputs, NaN for nodes without a reading; LawError if another node has no finite input."""
        blind = np.isnan(x)
        if u.shape != (self.k,) or not np.isfinite(u[~blind]).all():
            given, states = (np.array2string(one, threshold=8, max_line_width=2**16) for one in (u, x))
            raise self._failed("act", f"gave {given} for the states {states}, and an input is a finite number per node")
        return np.where(blind, np.nan, u)

    def running(self, thread: int) -> str:
        """Return `, at file:line` of the line of the law that a thread executes; empty if it executes none."""
        where = running(thread, type(self._law))
        return f", at {where}" if where else ""

    def _failed(self, method: str, what: str, where: str | None = None) -> LawError:
        nodes = self._view.ids[:8].tolist()
        more = f" and {self.k - len(nodes)} more" if self.k > len(nodes) else ""
        named = f"node{'s' * (self.k > 1)} {', '.join(map(str, nodes))}{more}"
        problem = f"law {self._view.law}: {method}() of {named} {what}. Correct the law."
        where = line_of(type(self._law), method) if where is None else where
        return LawError(where + problem, method=method, node=nodes[0] if self.k == 1 else None)

    def _raised(self, method: str, error: BaseException) -> LawError:
        law = type(self._law)
        if isinstance(error, SystemExit) and type(error) is not SystemExit:
            raise error  # of a signal handler of ours, and not of the law
        return self._failed(method, f"raised {crash.summary(error)}", place_of(error, law) or line_of(law, method))

    # Outgoing messages.

    @property
    def silence(self) -> tuple[bytes, bytes, bytes]:
        """Return the answer of a shard that cannot answer: no inputs, no reports, no used inputs."""
        nothing = np.full((1 + REPORT_ROWS) * self.k, np.nan).tobytes()
        return nothing[: 8 * self.k], nothing[8 * self.k :], bytes(self.m)

    def messages(self, state: State) -> tuple[list[tuple[Sequence[int], bytes]], bytes]:
        """Return the link messages of the step just answered, each with its receiving peers, and the input message."""
        floats = self._floats
        if floats is not None and floats.is_active:
            if not (state.flags or state.spans):
                *packed, own = self._forms.pack(self.t, floats.x, floats.u, floats.report)
                return [(peers, one) for (_, peers), one in zip(self.audience, packed, strict=True)], own + self.used
            if (packed_rows := self._packed(state.flags, state.spans, floats)) is not None:
                return packed_rows
        links: list[tuple[Sequence[int], bytes]] = [
            (peers, encode_link(link, self.peers[peers[0]].sends)) for peers, link in self.send(state)
        ]
        return links, encode_input(self.t, self.u, self.report, self.used)

    def _packed(
        self, flags: bytes, spans: Sequence[Span], floats: FloatLaw
    ) -> tuple[list[tuple[Sequence[int], bytes]], bytes] | None:
        """Return the result of `messages` from floats; None if a row is due that only the history stores."""
        t, links = self.t, list[tuple[Sequence[int], bytes]]()
        for p, first, last in self._rows_due(flags, spans):
            if not floats.has_rows(t, first):
                return None
            links.append(([p], pack_link(t, first, self.peers[p].sends, *floats.rows(t, first, last, p))))
        return links, self._forms.input(t, floats.u, floats.report) + self.used

    def send(self, state: State) -> list[tuple[Sequence[int], Link]]:
        """Return the link messages of the step just answered, each with its receiving peers."""
        if not state.flags and not state.spans:
            return self._send_now()
        return [
            ([p], self._rows(self.peers[p], first, last)) for p, first, last in self._rows_due(state.flags, state.spans)
        ]

    def _rows_due(self, flags: bytes, spans: Sequence[Span]) -> list[tuple[int, int, int]]:
        """Return the peers that receive a link message of the last step, each with the steps of its rows."""
        t, flags, due = self.t, flags or self._up, list[tuple[int, int, int]]()
        now, steps = (t, t), {c: (t - late - back, t - late) for c, _, _, late, back in spans}
        for p, peer in enumerate(self.peers):
            up = [steps.get(c, now) for c in peer.incidences if flags[c] & _SEND]
            if len(up) == 1:  # min and max of one would take longer than all the rest
                due.append((p, *up[0]))
            elif up:
                due.append((p, min(up)[0], max(last for _, last in up)))
        return due

    def _send_now(self) -> list[tuple[Sequence[int], Link]]:
        """Return messages with the row of this step alone, for every peer."""
        if not self.audience:
            return []
        t, x, u = self.t, self.x, self.u
        return [
            (
                peers,
                Link(t, t, x.tobytes(), u.tobytes())
                if nodes is None
                else Link(t, t, x[nodes].tobytes(), u[nodes].tobytes()),
            )
            for nodes, peers in self.audience
        ]

    def _rows(self, peer: Peer, first: int, last: int) -> Link:
        """Return a link message with the rows of steps first to last, as far as they are stored."""
        nodes = peer.nodes
        if (floats := self._floats) is not None and floats.is_active:
            if floats.has_rows(self.t, first):
                rows = floats.rows(self.t, first, last, self.peers.index(peer))
                return Link(self.t, first, *(np.array(one).tobytes() for one in rows))
            self._leave_floats(floats)  # the history lacks the rows of samples that wait
        x, u = (self.x, self.u) if nodes is None else (self.x[nodes], self.u[nodes])
        if first == last == self.t:
            return Link(self.t, first, x.tobytes(), u.tobytes())
        old_x, old_u = self._samples.sent(first, last + 1)
        if nodes is not None:
            old_x, old_u = old_x[:, nodes], old_u[:, nodes]
        if last < self.t:
            return Link(self.t, last + 1 - len(old_x), old_x.tobytes(), old_u.tobytes())
        return Link(self.t, last - len(old_x), old_x.tobytes() + x.tobytes(), old_u.tobytes() + u.tobytes())
