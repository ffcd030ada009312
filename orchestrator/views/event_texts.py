"""The sentences of the live view: the state of the network, and the meaning of the panels."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.runs.selection import selection
from hedgerow.topologies.escape import markdown
from hedgerow.topologies.graph import Index, Mask
from hedgerow.topologies.law_choice import is_listed
from hedgerow.topologies.network import span
from hedgerow.topologies.schema import Topology

_AGENTS = {
    "minimax": "Its agent does not know a_i and acts on an\nestimate â_i.",
    "hinf": "Its agent knows a_i: the law is the oracle's.",
    "nominal": "Its agent does not know a_i and acts on a\nfixed guess of it.",
}
"""The action of the agents under each law of the paper"""
_OTHERS = "The law determines what its agent does."
SOME = 6
"""the maximum length of a list; a longer one ends with the number of further names"""


class Now:
    """The texts about a step, in Markdown: problems, failures, wrong models, and costs."""

    def __init__(self, topology: Topology, observer: Observer) -> None:
        self._ids, self._graph = topology.ids, topology.graph
        self._limit = _gamma_star(topology, ".3g")
        self._law, self._steps = topology.law, topology.steps
        self._observer = observer

    def texts(self, batch: Batch, rows: Index) -> list[str]:
        """Return one text per row."""
        gain = batch.gain()
        return [self._text(batch, row, float(gain[row])) for row in rows.tolist()]

    def _edge(self, k: int) -> str:
        i, j = map(self._node, self._graph.edges[k].tolist())
        return f"{i}–{j}"

    def _link(self, k: int) -> str:
        return f"{self._node(int(self._graph.neighbour[k]))}→{self._node(int(self._graph.node[k]))}"

    def _node(self, k: int) -> str:
        return markdown(str(self._ids[k]))

    def _text(self, batch: Batch, k: int, gain: float) -> str:
        x, regret = np.abs(batch.x[k]), batch.regret[k]
        top, worst = int(x.argmax()), int(regret.argmax())
        missing, dead, wrong = batch.missing[k], batch.dead[k], batch.wrong[k]
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
                f"**Step {batch.t[k]}**, {batch.t[k] + 1} of {self._steps} made",
                f"- **Largest:** node **{self._node(top)}**, |x| = {x[top]:.3g};"
                f" largest regret: node **{self._node(worst)}**, {regret[worst]:.2g}",
                f"- **Down:** {'; '.join(down) or 'nothing'}",
                f"- **Wrong model:** {_listed(models, int((wrong & ~dead).sum()))}",
                f"- **Costs:** D = {batch.regret_sum[k]:.4g} (nominal law {batch.nominal_regret_sum[k]:.4g}),"
                f" R = {batch.cost_regret[k]:+.3g}, gain {gain:.3g}"
                f"{' with x(0)' if float(self._observer.v0) > 0 else ''}"
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
    return (", ".join(some) or "none") + (f" and {count - len(some)} more" if count > len(some) else "")


def about(topology: Topology, observer: Observer, large: bool, pictures_hz: float, group: int = 1) -> str:
    """Return the explanation of the panels for newcomers, in Markdown; `group` nodes are one dot of the picture."""
    what = selection(topology)
    lines = "every node" if what.all_nodes else f"{len(what.nodes)} of the nodes, evenly chosen or by the file"
    if what.every > 1:
        lines += f", at every {what.every}th step"
    dots = (
        ""
        if group == 1
        else f"""
A dot of the picture is a **group** of up to {group} neighbouring nodes, named after the first one. Its |x| is
the largest, a failure of one node marks the group, and its model is wrong if more than half of its nodes are wrong.
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
    b, edge_weights = topology.network.b, topology.graph.weights
    weights = "" if edge_weights is None else f"weights {span(edge_weights)}, "
    k, edge_cost = ("", "|u_e|²") if edge_weights is None else ("k_ij ", "Σ k_e u_e²")
    gain, norm = ("b", "Σ |x_i|") if isinstance(b, float) else ("b_i", "Σ |x_i| / b_i")
    flow = f"{gain} Σ {k}(u_i − u_j)"
    bound = (
        f"Whatever the estimates: |x(t+1)| ≤ ρ |x(t)| + |w(t)|, |x| = {norm}.\n\n" if is_listed(topology.law) else ""
    )
    return f"""\
# {markdown(topology.name)}

law **{markdown(str(topology.law))}**, {len(topology.ids)} nodes, {len(topology.edges)} edges, T = {topology.steps},
b = {span(b)}, {weights}γ\\* = {_gamma_star(topology, ".4g")}, ρ = {observer.rho:.4g}, seed {topology.seed}

Each node is a reservoir: x_i(t+1) = a_i x_i(t) + {flow} + w_i(t). {_AGENTS.get(topology.law, _OTHERS)}
The *oracle* is the same network with the same disturbances, x(0) and closed edges, but its nodes know their true a.
*nominal* is the same network with a fixed guess of a.
{many}
- **Network**: the fill of a node is its |x|, from blue to yellow, relative to the recent maximum. A pink ring is a
  wrong model. The thickness and brightness of an edge show its flow. The picture and *Now* show up to {pictures_hz:g}
  steps per second. The plots and the faults show every step.
- **States** x [x], and paler the oracle's x\\*. A node has one colour in all plots, the colour of its name in the
  picture. *Steady* shows the same without the start, where a large x(0) dwarfs the rest.
- **Inputs** u [u]. *Flows*: edge (i, j) shows u_j − u_i [u].
- **Estimates** â [1], and paler the truth a. *Error* is |â − a|, *a_LS* the least-squares estimate, *Margin* J₂ − J₁
  [x²], *Right* the number of right estimates.
- **Regret** |x − x\\*| [x] of each node; *Nominal gap* |x\\* − x_nom| [x]. **Regret D** [x²] is the sum of its squares
  over nodes and steps, beside D of the nominal law. *Cost R* [x²] is the cost minus the oracle's cost, and may be
  negative. *Ratio* is the cost divided by the oracle's cost.
- **Gain** √(Σ cost / Σ |w|²) of the disturbance so far; the cost of a step is |x|² + {edge_cost}. *at most, from
  x(0) = 0* is a bound on the gain of a run that starts at x(0) = 0, for the truth of this network. After a cut edge, a
  larger bound holds; after a jump of an a, one for any a(t) within the lists. A gain *with x(0)* has the cost of the
  initial states too, so it may start far above the lines. The axis ends at 4 γ\\*.
- **Faults**: lost messages, cut edges and dead agents in telemetry.
- **Round trips**: the time of each process to answer a step, by the plant's clock [ms]; over Zenoh only.

Wrong conclusions to avoid:
- **γ\\* is the oracle's number**, the smallest gain that can be guaranteed if every a is known. It is no guarantee for
  the adaptive law, which may exceed it.
- **Estimates need not converge to the truth.** Under sinusoids, least squares tend to a + Σxw / Σx², and may get worse.
- **Regret need not tend to 0.** It continues while a model is wrong.

{bound}x, u, w in the units of the file; [x] and [x²] are in units of x and their square; t in steps.
"""
