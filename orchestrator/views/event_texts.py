"""What the live view says in words: how the network fares now, and what its panels show."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.runs.selection import kept
from hedgerow.topologies.escape import markdown
from hedgerow.topologies.graph import Index, Mask
from hedgerow.topologies.schema import LAWS, Topology

_AGENTS = {
    "minimax": "Its agent does not know a_i and acts on an\nestimate â_i.",
    "hinf": "Its agent knows a_i: the law is the oracle's.",
    "nominal": "Its agent does not know a_i and acts on a\nfixed guess of it.",
}
"""What the agents of each law of the paper do"""
_OTHERS = "What its agent does is the law's own."
SOME = 6
"""longer lists are cut short, and say so"""


class Now:
    """Says of a step who struggles, what is down, who is wrong and what that costs; in Markdown."""

    def __init__(self, topology: Topology, observer: Observer) -> None:
        self._ids, self._graph = topology.ids, topology.graph
        self._limit = _gamma_star(topology, ".3g")
        self._law, self._steps = topology.law, topology.steps
        self._observer = observer

    def texts(self, batch: Batch, rows: Index) -> list[str]:
        """A text a row."""
        gain, less = batch.gain(), batch.gain(float(self._observer.v0))
        return [self._text(batch, row, float(gain[row]), float(less[row])) for row in rows.tolist()]

    def _edge(self, k: int) -> str:
        i, j = map(self._node, self._graph.edges[k].tolist())
        return f"{i}–{j}"

    def _link(self, k: int) -> str:
        return f"{self._node(int(self._graph.neighbour[k]))}→{self._node(int(self._graph.node[k]))}"

    def _node(self, k: int) -> str:
        return markdown(str(self._ids[k]))

    def _text(self, batch: Batch, k: int, gain: float, less: float) -> str:
        x, regret = np.abs(batch.x[k]), batch.regret[k]
        top, worst = int(x.argmax()), int(regret.argmax())
        missing, wrong = np.isnan(batch.u[k]), batch.ahat[k] != batch.a[k]
        dead = missing & np.isnan(batch.ahat[k])
        down = [
            *_those("edge cut:", self._edge, ~batch.edge_open[k]),
            *_those("message lost:", self._link, ~batch.link_up[k]),
            *_those("agent dead:", self._node, dead),
            *_those("no input from", self._node, missing & ~dead),
        ]
        models = [
            f"{self._node(i)} (â {batch.ahat[k, i]:.4g}, a {batch.a[k, i]:.4g})"
            for i in (wrong & ~dead).nonzero()[0][:SOME].tolist()
        ]
        return "\n".join(
            [
                f"**Step {batch.t[k]} of {self._steps}**",
                f"- **Struggles:** node **{self._node(top)}**, |x| = {x[top]:.3g};"
                f" most regret: node **{self._node(worst)}**, {regret[worst]:.2g}",
                f"- **Down:** {'; '.join(down) or 'nothing'}",
                f"- **Wrong model:** {_listed(models, int((wrong & ~dead).sum()))}",
                f"- **Costs:** D = {batch.regret_sum[k]:.4g} (nominal law {batch.nominal_regret_sum[k]:.4g}),"
                f" R = {batch.cost_regret[k]:+.3g}, gain {gain:.3g}, less x(0) {less:.3g}"
                f" (γ\\* = {self._limit} is the oracle's{'' if np.isfinite(batch.slack[k]) else ' without faults'})",
            ]
        )


def _gamma_star(topology: Topology, digits: str) -> str:
    found = topology.network.gamma_star_now
    return "(in verdict.json)" if math.isnan(found) else f"{found:{digits}}"


def _those(what: str, name: Callable[[int], str], which: Mask) -> list[str]:
    found = which.nonzero()[0]
    return [f"{what} **{_listed(map(name, found[:SOME].tolist()), len(found))}**"] if len(found) else []


def _listed(names: Iterable[str], count: int) -> str:
    some = list(names)
    return (", ".join(some) or "nobody") + (f" and {count - len(some)} more" if count > len(some) else "")


def about(topology: Topology, observer: Observer, large: bool, pictures_hz: float, group: int = 1) -> str:
    """What a newcomer needs to read the panels, in Markdown; `group` nodes are one dot of the picture."""
    what = kept(topology)
    lines = "every node" if what.all_nodes else f"{len(what.nodes)} of the nodes, evenly chosen or by the file"
    if what.every > 1:
        lines += f", at every {what.every}th step"
    dots = (
        ""
        if group == 1
        else f"""
A dot of the picture is a **group** of up to {group} neighbouring nodes, called after its first: its |x| is the largest,
something is down in it where it is for one of them, and its model wrong where those of more than half are.
"""
    )
    many = (
        f"""
With {len(topology.ids)} nodes the panels in front are **aggregated**: the largest, the 90 % and the median over the
nodes at each step; the heat map joins nodes and steps, and shows the largest |x| of each patch. The picture names the
nodes with the largest |x|. The plots behind, and run.rrd, have {lines}. The timeline has lanes for the first links
and nodes with a fault; the counts beside it have all.
{dots}"""
        if large
        else ""
    )
    bound = "Whatever the estimates: |x(t+1)|₁ ≤ ρ |x(t)|₁ + |w(t)|₁.\n\n" if topology.law in LAWS else ""
    return f"""\
# {markdown(topology.name)}

law **{markdown(topology.law)}**, {len(topology.ids)} nodes, {len(topology.edges)} edges, T = {topology.steps},
b = {topology.b:g}, γ\\* = {_gamma_star(topology, ".4g")}, ρ = {observer.rho:.4g}, seed {topology.seed}

Each node is a reservoir: x_i(t+1) = a_i x_i(t) + b Σ (u_i − u_j) + w_i(t). {_AGENTS.get(topology.law, _OTHERS)}
The *oracle* is the same network, with the same disturbances, x(0) and closed edges, whose nodes know
their true a; *nominal* is the same again with a fixed guess of a.
{many}
- **Network**: the fill of a node is its |x|, from blue to yellow, against the largest of late; a pink ring is a
  wrong model. An edge is the thicker and the brighter, the more flows. Picture and *Now* show up to {pictures_hz:g}
  steps a second; the plots and the faults have every step.
- **States** x, and paler the oracle's x\\*. A node has one colour in all plots: that of its name in the picture.
- **Inputs** u; edge (i, j) carries u_j − u_i.
- **Estimates** â, and paler the truth a.
- **Regret** |x − x\\*| of each node. **Cumulative regret** D: its squares, summed over nodes and steps; beside it the
  same of the nominal law. *Cost regret* R is the cost less the oracle's, and may be negative.
- **Gain** √(Σ cost / Σ |w|²) of the disturbance so far; the cost of a step is |x|² + |u_e|². *Less x(0)* leaves out
  what x(0) may have cost the oracle; what it cost another law may be more.
- **Faults**: what telemetry says was lost, cut or dead, whatever was planned.
- **Round trips**: how long each process took to answer a step's states, by the plant's clock [ms]; over Zenoh only.

What may **not** be concluded:
- **γ\\* is the oracle's number**, the least gain that can be promised when every a is known. It is no guarantee of the
  adaptive law, which may exceed it.
- **Estimates need not become the truth.** Under sinusoids least squares tend to a + Σxw / Σx², and may get worse.
- **Regret need not tend to 0.** It lasts while a model is wrong.

{bound}x, u, w in the units of the file; [x] and [x²] are in units of x and their square; t in steps.
"""
