"""The figures of a report: the paper's by number, the others by name; each for one run, or for several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from hedgerow.orchestrator.report import network, nodes, totals
from hedgerow.orchestrator.report.curves import BINS, STEPS, as_quantiles
from hedgerow.orchestrator.report.estimates import draw_estimates, has_estimates
from hedgerow.orchestrator.report.timeline import draw_faults, has_faults
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.pages import page

Runs = Sequence[Run]


@dataclass(frozen=True)
class Kind:
    """One figure: its key for `--figures`, its files, its content, and a test for runs with that content."""

    key: str
    file: str
    title: str
    shows: str
    draw: Callable[[Runs], Figure]
    array: str = ""
    """the array with a curve per node"""
    has: Callable[[Runs], bool] = lambda _: True
    more: Callable[[Runs], str] = lambda _: ""
    """further sentences about some runs"""
    on_request: bool = False
    """True if only `--figures` with its key draws it"""

    def caption(self, runs: Runs) -> str:
        """Return the caption for some runs, with the reductions that were made."""
        text = self.shows + self.more(runs)
        if self.array and any(as_quantiles(run, getattr(run, self.array)) for run in runs):
            text += (
                " Quantiles over all nodes replace the lines, because these would overlap; bins also cover their steps."
            )
        if any(run.T > STEPS for run in runs):
            text += f" Runs beyond {STEPS} steps are drawn in {BINS} bins of steps, by the extremes of each."
        return text


FIGURES = (
    Kind(
        key="1",
        file="figure-1-network",
        title="Figure 1: network",
        shows="The graph, and the nodes with a wrong estimate at the end.",
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
        shows="|x_i(t) − x_i*(t)|, the distance of every node from its state under the oracle; the axes are those of"
        " figure 5.",
        draw=nodes.regret,
        array="regret",
        more=lambda runs: nodes.largest(runs, "regret"),
    ),
    Kind(
        key="5",
        file="figure-5-nominal",
        title="Figure 5: nominal gap",
        shows="|x_i*(t) − x_i^nom(t)|, the distance of the controller with a fixed a from the oracle; the axes are"
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
        shows="The estimates, compared with the true a_i. They need not converge: under sinusoids, least squares"
        " tend to a_i + Σ x w / Σ x².",
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
        shows="R(t), the cost so far minus the oracle's. It has a sign: except under the worst disturbance, the oracle"
        " is not the cheapest. So a negative R is neither an error nor a merit.",
        draw=totals.cost,
    ),
    Kind(
        key="gain",
        file="gain",
        title="Gain",
        shows="√(Σ cost / Σ |w|²) so far, without and with V(x(0)) subtracted, the maximum cost of x(0) for the oracle."
        " γ* is the oracle's number, the smallest gain that can be guaranteed if every a is known and no edge is"
        " closed; it is no guarantee for the adaptive law. The line *at most, from x(0) = 0* bounds the"
        " gain of that law in a run that starts at x(0) = 0. A gain with the cost of x(0) may be above it. It holds"
        f" while the line's premise holds ({page('guarantee')}).",
        draw=totals.gain,
        more=totals.beyond,
    ),
    Kind(
        key="slack",
        file="slack",
        title="Slack of the certificate",
        shows="g Σ |w|² + Σ p x(0)² − Σ p x(t+1)² − Σ cost: the part of the certificate that is left at each step,"
        " with the g and p of the bound that is claimed then. It is never negative in a valid run"
        f" ({page('guarantee')}).",
        draw=totals.slack,
        has=totals.has_slack,
    ),
    Kind(
        key="faults",
        file="faults",
        title="Faults",
        shows="The steps when messages of a link were lost, an edge had no flow, an input was missing, or an a jumped.",
        draw=draw_faults,
        has=has_faults,
    ),
)
