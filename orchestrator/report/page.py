"""The page report.html: figures, numbers, network, faults and the commands to repeat the run, in one file."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

import matplotlib as mpl
import numpy as np

from hedgerow.orchestrator.metrics.summary import _shown
from hedgerow.orchestrator.report.compare import notices
from hedgerow.orchestrator.report.curves import letter
from hedgerow.orchestrator.report.figures import Kind
from hedgerow.orchestrator.report.markup import Markup, join, listed, table, tag
from hedgerow.orchestrator.report.reading import METRICS, growth, metrics, number, sentences
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.escape import command
from hedgerow.topologies.network import span
from hedgerow.topologies.nodes import Nodes
from hedgerow.topologies.resolve import text_beside_table

Runs = Sequence[Run]
NODES = 200
"""the maximum number of rows in the table of nodes"""
YAML_BYTES = 2**20
"""the maximum size of a topology in the page; larger ones stay in the folder of the run"""
WITHOUT = "none yet"
"""the verdict of a run that has not ended, or was killed"""
_COUNTS = ("scheduled", "fired", "masked", "seen", "beyond")


def page(runs: Runs, drawn: Mapping[Kind, bytes]) -> str:
    """Return the whole page; `drawn` holds each figure as SVG."""
    names = " and ".join(run.name for run in runs)
    css = resources.files("hedgerow.orchestrator.report").joinpath("report.css").read_text(encoding="utf-8")
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width"),
        tag("title", f"{names}: report"),
        tag("style", Markup(css)),
    )
    body = [*_opening(runs, names), *_figures(runs, drawn), *_numbers(runs)]
    for k, run in enumerate(runs):
        body += _run(run, letter(k) if len(runs) > 1 else "")
    body += _repeat(runs)
    spaced = (piece for part in body for piece in (part, "\n"))
    return f"<!DOCTYPE html>\n{tag('html', head, Markup(chr(10)), tag('body', *spaced), lang='en')}\n"


def _opening(runs: Runs, names: str) -> list[Markup]:
    parts = [tag("h1", names)]
    if len(runs) == 1:
        return [*parts, tag("p", _verdict(runs[0]), f" {_size(runs[0])}"), listed(sentences(runs[0]))]
    for k, run in enumerate(runs):
        parts.append(tag("p", tag("strong", f"{letter(k)}: {run.name}. "), _verdict(run), f" {_size(run)}"))
    comparable, notes = notices(runs)
    if not comparable:
        warning = "These runs are not comparable: the networks differ, and every number below depends on that. "
        parts.append(tag("p", tag("strong", warning), " ".join(notes), class_="warning"))
    else:
        parts.append(listed(notes))
    return parts


def _verdict(run: Run) -> Markup:
    verdict = str(run.verdict.content.get("verdict", WITHOUT))
    reasons = f" ({'; '.join(run.verdict.content['reasons'])})" if run.verdict.content.get("reasons") else ""
    return tag("span", f"Verdict: {verdict}{reasons}.", class_=verdict if run.verdict.content else "unknown")


def _size(run: Run) -> str:
    topology = run.topology
    text = f"Network {topology.name}, law {run.law}, {len(run.ids)} nodes, {len(run.edges)} edges, b = {span(run.b)}, "
    if topology.graph.weights is not None:
        text += f"weights {span(run.weights)}, "
    text += f"{run.T} of {topology.steps} steps, seed {topology.seed}."
    return text + (f" The telemetry of {len(run.lost)} steps was lost." if len(run.lost) else "")


def _ends(last: float, truth: float, wrong: bool) -> str:
    """Return the last estimate of a node, and right or wrong; or the error, if it is not a candidate."""
    if np.isnan(last):
        return "—"
    word = "wrong" if wrong else "right" if last == truth else f"off by {last - truth:+.2g}".replace("-", "−")
    return f"{last:.4f}, {word}"


def _numbers(runs: Runs) -> list[Markup]:
    of_runs = [metrics(run) for run in runs]
    names = [letter(k) for k in range(len(runs))] if len(runs) > 1 else ["value"]
    rows: list[list[object]] = [
        [words, *(number(of_run[name]) for of_run in of_runs)] for name, words in METRICS.items()
    ]
    rows[0][1:] = [f"{right} of {len(run.ids)}" for right, run in zip(rows[0][1:], runs, strict=True)]
    counted = [
        ("missing_inputs", "inputs that did not come"),
        ("lost_messages", "messages lost"),
        ("forgotten_rows", "rows that could not be back-filled"),
        ("restarts", "processes started again"),
        ("steps_per_s", "steps a second"),
    ]
    if all(run.verdict.content for run in runs):
        rows += [[words, *(number(run.verdict.content[name]) for run in runs)] for name, words in counted]
    parts = [tag("h2", "Numbers"), table(["", *names], rows, "numbers")]
    for k, run in enumerate(runs):
        if checks := run.verdict.content.get("checks"):
            parts += [tag("h3", " ".join(["Checks", *([letter(k)] if len(runs) > 1 else [])])), _checks(checks)]
    return parts


def _checks(checks: Mapping[str, Any]) -> Markup:
    rows = [
        [
            name,
            tag("span", "holds" if check["ok"] else "FAILS", class_="valid" if check["ok"] else "INVALID"),
            check["claim"],
            *("—" if check.get(field) is None else number(check[field]) for field in ("steps", "step", "excess")),
        ]
        for name, check in checks.items()
    ]
    return table(["check", "", "claim", "steps", "closest at step", "excess [share of the bound]"], rows)


def _figures(runs: Runs, drawn: Mapping[Kind, bytes]) -> list[Markup]:
    shown = [
        tag(
            "figure",
            tag("img", src=f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}", alt=kind.title),
            tag(
                "figcaption", tag("strong", f"{kind.title}. "), kind.caption(runs), " ", tag("code", f"{kind.file}.pdf")
            ),
        )
        for kind, svg in drawn.items()
    ]
    note = (
        "Figures 1 to 5 are those of the paper. [units of x] are those in which the file gives x(0) and w."
        " The oracle, x*, is the same network with the same x(0), disturbances and open edges, and knows every a."
    )
    return [tag("h2", "Figures"), tag("p", note), tag("div", *shown, class_="figures")]


def _run(run: Run, name: str) -> list[Markup]:
    behind = f" of {name}" if name else ""
    return [tag("h2", f"Network{behind}"), *_nodes(run), *_faults(run, behind)]


def _nodes(run: Run) -> list[Markup]:
    topology, of_node = run.topology, np.nansum(run.regret**2, axis=0)
    shown = np.sort(np.argsort(-of_node, kind="stable")[:NODES])
    neighbours: dict[Any, list[str]] = {node: [] for node in run.ids}
    weights = topology.graph.weights
    unequal = weights is not None or not isinstance(run.b, float)
    weighed = [""] * len(topology.edges) if weights is None else [f" ({weight:.4g})" for weight in weights.tolist()]
    for (i, j), weight in zip(topology.pairs, weighed, strict=True):
        neighbours[i].append(f"{j}{weight}")
        neighbours[j].append(f"{i}{weight}")
    gains = np.broadcast_to(run.b, len(run.ids)).tolist()
    rows = []
    for k in shown.tolist():
        node, own = run.ids[k], topology.nodes[run.ids[k]]
        parts = own.disturbance if isinstance(own.disturbance, tuple) else (own.disturbance,)
        last = run.ahat[-1, k]
        ends = _ends(last, run.a[-1, k], run.wrong[-1, k])
        rows.append(
            [
                topology.network.title(k),
                ", ".join(neighbours[node]) or "none",
                *([f"{gains[k]:.4g}"] if unequal else []),
                _truth(run, k),
                ", ".join(f"{value:.4f}" for value in own.candidates or ()),
                ends,
                f"{of_node[k]:.4g}",
                number(own.x0),
                " + ".join(_shown(part) for part in parts if part is not None) or "none",
            ]
        )
    own_numbers = ["neighbours (weights)", "gain b"] if unequal else ["neighbours"]
    headings = ["node", *own_numbers, "true a", "candidates", "estimate at the end", "Σ r²", "x(0)", "disturbance"]
    parts_ = [table(headings, rows)]
    if len(run.ids) > NODES:
        parts_.insert(
            0, tag("p", f"The {NODES} of {len(run.ids)} nodes with the largest regret, in the order of the file.")
        )
    return parts_


def _truth(run: Run, k: int) -> str:
    """Return the a of a node, and its values after jumps."""
    a = run.a[:, k]
    jumps = np.flatnonzero(a[1:] != a[:-1]) + 1
    return ", ".join([f"{a[0]:.4f}", *(f"{a[t]:.4f} from step {t}" for t in jumps)])


def _faults(run: Run, behind: str) -> list[Markup]:
    faults = run.topology.faults
    if not faults:
        return []
    outcomes = run.verdict.content.get("faults") or [{"what": str(fault.written())} for fault in faults]
    rows = [
        [k, account["what"], *("—" if account.get(c) is None else account[c] for c in _COUNTS), grew]
        for k, (account, grew) in enumerate(zip(outcomes, growth(run), strict=True), 1)
    ]
    note = (
        "An instance is one target at one step. It fired if it took effect, and was masked if there was nothing to"
        " lose. It was seen if the process that misses something reports it. The last column is the part of D"
        " from the steps of the fault, of any cause; a wrong estimate may also cost later."
    )
    return [tag("h2", f"Faults{behind}"), table(["", "fault", *_COUNTS, "growth of D"], rows), tag("p", note)]


def _repeat(runs: Runs) -> list[Markup]:
    parts = [tag("h2", "To repeat it")]
    for run in runs:
        text, name = text_beside_table(run.topology).encode(), f"{run.name}.yaml"
        if len(text) <= YAML_BYTES and not isinstance(run.topology.nodes, Nodes):
            link = f"data:text/yaml;base64,{base64.b64encode(text).decode()}"
            where = join([tag("a", name, download=name, href=link), " holds every number that was drawn."])
        else:
            where = join([tag("code", name), " is topology.yaml of the run's folder: too large for this page."])
        stopped = ["--steps", run.T] if run.topology.steps > run.T else []
        processes = ["--processes", run.verdict.content["processes"]] if run.verdict.content.get("processes") else []
        simulated = command(["orchestrator", "simulate", name, *stopped])
        commands = f"{simulated}\n{command(['orchestrator', 'up', name, *stopped, *processes])}"
        own = f" The law is {run.law}, which must be importable." if ":" in run.law else ""
        parts += [
            tag("p", where, " With the same versions either command gives the same trajectory, to the bit.", own),
            tag("pre", commands),
        ]
    reported = command(["orchestrator", "report", *(run.name for run in runs)])
    parts += [tag("p", "And this report of the runs' folders:"), tag("pre", reported)]
    for run in runs:
        if run.verdict.content:
            versions = {**run.verdict.content["versions"], "matplotlib (this report)": mpl.__version__}
            listing = ", ".join(f"{package} {version}" for package, version in versions.items())
            whole = tag("pre", json.dumps(run.verdict.content, indent=2, ensure_ascii=False))
            parts += [
                tag("p", f"{run.name} was made with {listing}."),
                tag("details", tag("summary", "verdict.json"), whole),
            ]
    return parts
