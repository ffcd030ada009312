"""The figures of a report: the paper's by their numbers, ours by name; each of one run, or of several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from hedgerow.orchestrator.report import network, nodes, totals
from hedgerow.orchestrator.report.curves import BINS, STEPS, as_quantiles
from hedgerow.orchestrator.report.estimates import draw_estimates, has_estimates
from hedgerow.orchestrator.report.timeline import draw_faults, has_faults
from hedgerow.orchestrator.runs.run import Run

Runs = Sequence[Run]


@dataclass(frozen=True)
class Kind:
    """One figure: what `--figures` calls it, its files, what it shows, and whether some runs have any of that."""

    key: str
    file: str
    title: str
    shows: str
    draw: Callable[[Runs], Figure]
    array: str = ""
    """of which each node has a curve"""
    has: Callable[[Runs], bool] = lambda _: True
    more: Callable[[Runs], str] = lambda _: ""
    """what is to be said of some runs in particular"""
    on_request: bool = False
    """True if only `--figures` with its key draws it"""

    def caption(self, runs: Runs) -> str:
        """What it shows of some runs, and what was done to make that fit."""
        said = self.shows + self.more(runs)
        if self.array and any(as_quantiles(run, getattr(run, self.array)) for run in runs):
            said += (
                " Quantiles over all nodes stand for lines that could not be told apart, in bins over their steps too."
            )
        if any(run.T > STEPS for run in runs):
            said += f" Runs beyond {STEPS} steps are drawn in {BINS} bins of steps, by the extremes of each."
        return said


FIGURES = (
    Kind(
        key="1",
        file="figure-1-network",
        title="Figure 1: network",
        shows="The graph, and which nodes end with a wrong estimate.",
        draw=network.network,
        more=network.unnamed,
    ),
    Kind(
        key="2",
        file="figure-2-states",
        title="Figure 2: states",
        shows="x_i(t) of every node under the law of the run; the axes are those of figure 3.",
        draw=nodes.states,
        array="x",
    ),
    Kind(
        key="3",
        file="figure-3-oracle",
        title="Figure 3: states of the oracle",
        shows="x_i*(t): the same network, x(0) and disturbances, under the H-infinity controller that knows every a_i;"
        " the axes are those of figure 2.",
        draw=nodes.oracle,
        array="x_oracle",
    ),
    Kind(
        key="4",
        file="figure-4-regret",
        title="Figure 4: trajectory regret",
        shows="|x_i(t) − x_i*(t)|, how far every node is from where the oracle would have it; the axes are those of"
        " figure 5.",
        draw=nodes.regret,
        array="regret",
        more=lambda runs: nodes.largest(runs, "regret"),
    ),
    Kind(
        key="5",
        file="figure-5-nominal",
        title="Figure 5: nominal gap",
        shows="|x_i*(t) − x_i^nom(t)|, how far the controller that assumes a fixed a is from the oracle; the axes are"
        " those of figure 4.",
        draw=nodes.nominal,
        array="nominal_gap",
        more=lambda runs: nodes.largest(runs, "nominal_gap"),
    ),
    Kind(
        key="paper",
        file="figures-2-to-5",
        title="Figures 2 to 5",
        shows="Figures 2 to 5 as the panels (a) to (d) of one figure, as wide as a page with two columns.",
        draw=nodes.paper,
        array="x",
        has=lambda runs: len(runs) == 1,
        on_request=True,
    ),
    Kind(
        key="estimates",
        file="estimates",
        title="Estimates and truth",
        shows="Whether the estimates are the true a_i. They need not become so: under sinusoids least squares tend to"
        " a_i + Σ x w / Σ x².",
        draw=draw_estimates,
        has=has_estimates,
    ),
    Kind(
        key="regret",
        file="regret",
        title="Cumulative regret",
        shows="D(t), the sum of |x − x*|² over all nodes and steps so far, of the run and of its nominal twin.",
        draw=totals.sums,
    ),
    Kind(
        key="cost",
        file="cost-regret",
        title="Cost regret",
        shows="R(t), the cost so far less the oracle's. It has a sign: off the worst disturbance the oracle is not the"
        " cheapest, so that a negative R is no error, and no merit.",
        draw=totals.cost,
    ),
    Kind(
        key="gain",
        file="gain",
        title="Gain",
        shows="√(Σ cost / Σ |w|²) so far, as it is and less V(x(0)), what the start may have cost the oracle. γ* is the"
        " oracle's number, the least gain that can be promised when every a is known and no edge is closed; it is no"
        " guarantee of the adaptive law. That law's own gain from x(0) = 0 is at most the line above, as long as the"
        " line's premise holds (docs/guarantee.md).",
        draw=totals.gain,
        more=totals.beyond,
    ),
    Kind(
        key="faults",
        file="faults",
        title="Faults",
        shows="When messages of a link were lost, an edge carried no flow, a node's input did not come, an a jumped.",
        draw=draw_faults,
        has=has_faults,
    ),
)
