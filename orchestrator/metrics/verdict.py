"""The verdict of a run: valid, INVALID or unknown, with the checks and the numbers, all computed in that run."""

from __future__ import annotations

import contextlib
import math
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hedgerow.orchestrator.ground.law_source import source_of
from hedgerow.orchestrator.ground.versions import versions
from hedgerow.orchestrator.metrics.checks import Worst
from hedgerow.orchestrator.metrics.deaths import CLAIM as DEATHS
from hedgerow.orchestrator.metrics.deaths import Survivor
from hedgerow.orchestrator.metrics.gain_bound import Bound, Premise
from hedgerow.orchestrator.metrics.gain_certificate import CLAIMS as GAIN_CLAIMS
from hedgerow.orchestrator.metrics.gain_certificate import Track
from hedgerow.orchestrator.metrics.guarantee import rounded_up
from hedgerow.orchestrator.metrics.message_audit import CLAIM, Audit
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.replay import CLAIMS as REPLAYED
from hedgerow.orchestrator.metrics.replay import Replay
from hedgerow.topologies.describe import describe
from hedgerow.topologies.errors import Code, Exit, HedgerowError, UserError
from hedgerow.topologies.escape import escape
from hedgerow.topologies.law_choice import is_listed
from hedgerow.topologies.partition import cut, parts_of
from hedgerow.topologies.schema import Topology
from hedgerow.wire import crash
from hedgerow.wire.limits import limit_reached

DIVERGED = 1e12
"""The ratio of the cost to the oracle's above which a run has diverged."""
VALID, INVALID, UNKNOWN = "valid", "INVALID", "unknown"
EXIT_CODES = {VALID: Exit.VALID, INVALID: Exit.INVALID, UNKNOWN: Exit.UNKNOWN}

CLAIMS = {
    "dynamics": "every x(t+1) is equation (1) of x, u, w and the open edges, bit for bit",
    "estimates": "every ahat is one of its candidates, and every received u is equation (6) of it, bit for bit",
    "contraction": "|x(t+1)| <= rho |x(t)| + |w(t)| at every step, |x| = sum abs(x_i) / b_i",
    "oracle_certificate": "sum (|x*|^2 + |u*_e|^2) <= sum w'Q^-1 w + V(x(0)) - V(x*(t+1)) at every step"
    " before the first at which an edge is closed or an a jumps",
    "missing_inputs": "an edge carries flow only where both its ends sent an input",
    "links": "every node reports the inputs of a step that were open and delivered in that step",
    "faults": "every fault fired as scheduled, was seen where it struck, and nothing else went wrong",
}
_UNDER = {
    Premise.ESTIMATES: "for this truth and any estimates from the lists",
    Premise.EDGES: "for this truth, any estimates from the lists and any closed edges",
    Premise.JUMPS: "for any a(t) and any estimates from the lists, and any closed edges",
}
"""The premise of the limit of the law, in the verdict line."""
_OF_THE_LAW = {"estimates", "contraction"}
"""Checks for laws that act by (6) on an estimate from the list, not for other laws."""


@dataclass(frozen=True)
class Comparison:
    """The outcome of a comparison with the in-process reference."""

    equal: bool | None
    """True or False bit for bit; None if it could not be made."""
    step: int | None = None
    """The first step that differs."""
    cause: str = ""
    """The first difference, or the reason why there was no comparison."""


@dataclass
class Ending:
    """The end of a run, and its circumstances."""

    run: str
    engine: str
    processes: int
    first_step_s: float | None = None
    """the time from the start of the command to the first telemetry [s]"""
    stopped: str = ""
    """the reason for an early end; empty without one"""
    comparison: Comparison | None = None
    """the comparison with the in-process reference; None if not requested"""
    restarts: int = 0
    """the number of restarts of processes"""
    replay: Replay | None = None
    """the replay of the run by the file and the law; None without one"""
    not_replayed: str = ""
    """the reason for a missing replay"""
    survivors: list[Survivor] | None = None
    """processes that a crash fault should have ended; None in a run without processes"""
    losses: set[int] = field(default_factory=set)
    """numbers, from 0, of the faults that record a lost agent"""
    audit: Audit | None = None
    """the audit of the messages; None without counts"""
    round_trips: dict[str, dict[str, float | int | None]] | None = None
    """the answer times of each process; None in a run without Zenoh"""
    down: list[str] = field(default_factory=list)
    """processes that ended unplanned and stayed down, each in words"""
    crashed: bool = False
    """True if a defect of this project ended the run"""
    mistaken: bool = False
    """True if a mistake of the user, in the law, ended the run"""
    error: HedgerowError | None = None
    """the error of the law that ended a run in this process"""

    def end_by(self, error: BaseException, log: Path) -> None:
        """Record the exception that ended the run; write the traceback of an unexpected one to `log`."""
        reached = limit_reached(error)
        if reached is None and not isinstance(error, HedgerowError | OSError):
            self.crashed = True
            self.stopped = crash.report(error, log)
        else:
            if isinstance(error, UserError) and error.code == Code.LAW:
                self.mistaken, self.error = True, error
                log_cause(error, log)
            self.crashed |= getattr(error, "code", None) == Code.CRASH
            self.stopped = str(reached or error)


@dataclass(frozen=True)
class Verdict:
    """The verdict as in verdict.json."""

    verdict: str
    """`valid`, `INVALID` or `unknown`; empty if there is no verdict yet"""
    content: dict[str, Any]
    """the keys of verdict.json (docs/run-folder.md)"""
    error: HedgerowError | None = None
    """the error of the law that ended a run in this process"""

    def __repr__(self) -> str:
        return f"<Verdict {self.line()}>" if self.content else "<Verdict: none yet>"

    @property
    def exit_code(self) -> int:
        """Return the exit code of the command."""
        return int(self.content["exit_code"])

    def line(self) -> str:
        """Return the last line on the screen."""
        c, m = self.content, self.content["metrics"]
        numbers = [f"{c['steps_done']} of {c['steps']} steps"]
        if c["diverged"]:
            numbers.append(f"diverged (cost above {DIVERGED:.0e} times the oracle's)")
        if c["steps_per_s"]:
            numbers.append(f"{c['steps_per_s']:.0f} steps/s")
        for what, thing in (
            ("restarts", "restart"),
            ("missing_inputs", "missing input"),
            ("lost_messages", "lost message"),
        ):
            if number := c[what]:
                numbers.append(f"{number} {thing}{'s' if number > 1 else ''}")
        if m and m["disturbance_energy"] == 0 and m["cost"] == 0:
            numbers.append("at rest (x(0) = 0 and no disturbance; `defaults:` sets both)")
        elif m:
            # A number that is not finite grew too large; but with a zero disturbance, the gain is undefined.
            large = math.nan if m["disturbance_energy"] == 0 else math.inf
            gain, less = (large if m[name] is None else m[name] for name in ("gain", "gain_less_x0"))
            numbers += [
                f"regret D {_number(m['regret'])} (nominal {_number(m['regret_nominal'])})",
                f"cost regret {_number(m['cost_regret'], '+')}",
                gain_text(
                    gain,
                    less,
                    m["gamma_star"],
                    c["checks"]["oracle_certificate"]["steps"] == c["steps_done"],
                    _limit_text(c),
                ),
                estimates_text(c["real_estimates"], m["nodes_right"], c["nodes"], m["estimate_error"]),
            ]
        if "law" in c["checks"] and (replayed := c["checks"]["law"]["nodes"]) < c["nodes"]:
            numbers.append(f"{replayed} of {c['nodes']} nodes replayed")
        if c["checks"].get("reference", {}).get("ok"):
            numbers.append("compared with a run in one process: equal")
        why = f" ({'; '.join(c['reasons'])})" if c["reasons"] else ""
        return f"{self.verdict}{why}: {', '.join(numbers)}"


def estimates_text(real: bool, right: int, nodes: int, error: float | None) -> str:
    """Return the quality of the estimates in words: the number of right ones, or the mean error of real numbers."""
    if real and error is not None:
        return f"mean |ahat - a| {error:.4g}"
    return f"{right} of {nodes} estimates right"


def law_limit(content: Mapping[str, Any]) -> tuple[Premise, float] | None:
    """Return the smallest bound on the gain with a premise that held in the whole run, and the premise.

    Of bounds that print alike, the first has the strongest premise, which takes the fewest words.
    """
    bounds = content["gain_bounds"].get("bounds", {})
    held = [(Premise(name), entry["gain"]) for name, entry in bounds.items() if entry.get("held") and "gain" in entry]
    return min(held, key=lambda limit: float(rounded_up(limit[1])), default=None)


def _limit_text(content: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return the limit of the law in words, and its premise."""
    limit = law_limit(content)
    return (f"at most {rounded_up(limit[1])}", _UNDER[limit[0]]) if limit else None


def gain_text(
    gain: float, less: float, gamma_star: float, faultless: bool, limit: tuple[str, str] | None = None
) -> str:
    """Return the gain in words, with the limit of the law, which holds from x(0) = 0, and with gamma*.

    `less` is the gain less V(x(0)). If it differs from `gain`, the gain has the cost of x(0), which no limit has. Then
    gamma* is left out: the two are not comparable. Numbers are NaN where they are undefined or not known yet.
    """
    if not math.isnan(gain) and less != gain:
        return f"gain {gain:.4g} with x(0)" + (f" ({limit[0]} from x(0) = 0, {limit[1]})" if limit else "")
    of = [" ".join(limit)] if limit else []
    if not math.isnan(gamma_star):
        of.append(f"gamma* {gamma_star:.4g} of the oracle{'' if faultless else ' without faults'}")
    shown = "gain undefined" if math.isnan(gain) else f"gain {gain:.4g}"
    return shown + (f" ({'; '.join(of)})" if of else "")


def _number(value: float | None, sign: str = "") -> str:
    return "too large" if value is None else f"{value:{sign}.4g}"


def judge(topology: Topology, observer: Observer, ending: Ending) -> Verdict:
    """Return the verdict of a run: INVALID if a check failed, unknown after an early end or lost rows, otherwise
    valid.
    """
    claimed = {
        name: worst for name, worst in observer.checks.items() if is_listed(topology.law) or name not in _OF_THE_LAW
    }
    checks = {name: _check(name, worst, topology) for name, worst in claimed.items()}
    if ending.replay is not None:
        checks |= {name: _replayed(name, ending.replay) for name in REPLAYED}
    if ending.survivors is not None:
        checks["deaths"] = _deaths(ending.survivors)
    adaptive = observer.adaptive
    if adaptive is not None and adaptive.known is not None:
        for premise, track in adaptive.tracks.items():  # not the order in which the bounds were found
            if (bound := adaptive.known.bounds.get(premise)) is not None and track.check.steps:
                checks[f"gain_{premise}"] = _gain(premise, track, bound)
    if ending.audit is not None:
        checks["information"] = {"ok": not ending.audit.wrong, "claim": CLAIM, "why": ending.audit.wrong}
    comparison = ending.comparison
    if comparison is not None and comparison.equal is not None:
        checks["reference"] = {
            "ok": comparison.equal,
            "claim": "telemetry equals the in-process reference, bit for bit",
        }
        if not comparison.equal:
            step = {} if comparison.step is None else {"step": comparison.step}
            checks["reference"] |= {**step, "why": [comparison.cause]}
    failed = [
        f"{name} fails"
        + (f" at step {check['step']}" if check.get("step") is not None else "")
        + (f": {_first_of(check)}" if check.get("why") else "")
        for name, check in checks.items()
        if not check["ok"]
    ]
    doubts = []
    if ending.stopped:
        doubts.append(ending.stopped)
    if comparison is not None and comparison.equal is None:
        doubts.append(f"not compared with the reference: {comparison.cause}")
    if observer.lost:
        doubts.append(f"{len(observer.lost)} steps of telemetry lost, the first {observer.lost[0]}")
    doubts += _doubts_of(ending, observer)
    doubts += [f"stayed down: {one}" for one in ending.down]
    if observer.end is None and not doubts:
        doubts.append("the final state is missing")
    faults = _faults(topology, observer)
    doubts += [
        f"fault {k + 1} ({faults[k]['what']}) could not fire: {why}"
        for k, why in observer.schedule.idle(topology.steps).items()
    ]
    # After a defect of this project, a failed check proves nothing about the run.
    verdict = UNKNOWN if ending.crashed else INVALID if failed else UNKNOWN if doubts else VALID
    done = observer.end.t if observer.end is not None else observer.next_step
    elapsed_s = observer.end.elapsed_s if observer.end is not None else None
    metrics = observer.summary() if done else {}
    content = {
        "verdict": verdict,
        "exit_code": _exit_code(verdict, ending),
        "reasons": [escape(why) for why in (doubts + failed if ending.crashed else failed + doubts)],
        "run": ending.run,
        "name": topology.name,
        "law": topology.law,
        "law_source": source_of(topology.law).digest or None,
        "real_estimates": observer.real_estimates,
        "seed": topology.seed,
        "engine": ending.engine,
        "processes": ending.processes,
        "process_edges": cut(observer.graph, parts_of(observer.graph, ending.processes or 1, topology.layout)),
        "nodes": observer.graph.n,
        "edges": len(observer.graph.edges),
        "steps": topology.steps,
        "steps_done": done,
        "elapsed_s": elapsed_s,
        "steps_per_s": done / elapsed_s if elapsed_s else None,
        "first_step_s": ending.first_step_s,
        "round_trips": ending.round_trips,
        "lost_rows": len(observer.lost) * observer.graph.n,
        "refused_rows": observer.refused * observer.graph.n,
        "missing_inputs": observer.fault_accounts.missing_inputs,
        "lost_messages": observer.fault_accounts.lost_messages,
        "forgotten_rows": observer.end.forgotten if observer.end is not None else 0,
        "restarts": ending.restarts,
        "down": ending.down,
        "faults": faults,
        "checks": checks,
        "information": ending.audit.to_dict() if ending.audit is not None else None,
        "gain_bounds": {"not_computed": observer.not_certified} if adaptive is None else adaptive.to_dict(done),
        "diverged": _diverged(metrics),
        "metrics": {name: _finite(value) for name, value in metrics.items()},
        "versions": versions(),
    }
    return Verdict(verdict, content, ending.error)


def _exit_code(verdict: str, ending: Ending) -> int:
    """Return the exit code of a run; a failed law is a mistake of its user."""
    if ending.crashed:
        return Exit.CRASH
    return Exit.USER_MISTAKE if ending.mistaken and verdict == UNKNOWN else EXIT_CODES[verdict]


def log_cause(error: BaseException, log: Path) -> None:
    """Append the traceback of the exception that an error came from to a log, if the disk has room."""
    if error.__cause__ is not None:
        with contextlib.suppress(OSError), log.open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write("".join(traceback.format_exception(error.__cause__)))


def _faults(topology: Topology, observer: Observer) -> list[dict[str, Any]]:
    """Return the outcome of each fault as in verdict.json."""
    if not topology.faults:
        return []

    done = observer.end.t if observer.end is not None else observer.next_step
    return [
        {
            "fault": k,
            "kind": fault.kind,
            "what": describe(fault),
            "scheduled": account.scheduled,
            "fired": account.fired,
            "masked": account.masked,
            "seen": account.seen if fault.LOSSY else None,
            "beyond": beyond,
        }
        for k, (fault, account, beyond) in enumerate(
            zip(topology.faults, observer.fault_accounts, observer.schedule.beyond(done), strict=True), 1
        )
    ]


def _first_of(check: dict[str, Any]) -> str:
    """Return the reason for a failed check, for the screen: only the first node; verdict.json has the others."""
    why: list[str] = check["why"]
    if "node" not in check:
        return "; ".join(why[:8])
    return why[0] + (f" (and {len(why) - 1} more)" if len(why) > 1 else "")


def _replayed(name: str, replay: Replay) -> dict[str, Any]:
    """Return a check of the replay, which ends at the first difference in any of its checks."""
    finding = replay.finding if replay.finding is not None and replay.finding.check == name else None
    return {
        "ok": finding is None,
        "claim": REPLAYED[name],
        "steps": replay.steps,
        "nodes": replay.nodes,
        "step": finding.step if finding is not None else None,
        "node": finding.node if finding is not None else None,
        "why": finding.why if finding is not None else [],
    }


def _deaths(survivors: list[Survivor]) -> dict[str, Any]:
    """Return the check that crash faults end processes."""
    first = min(survivors, key=lambda one: one.step) if survivors else None
    return {
        "ok": first is None,
        "claim": DEATHS,
        "step": first.step if first is not None else None,
        "node": first.node if first is not None else None,
        "why": [str(one) for one in survivors],
    }


def _doubts_of(ending: Ending, observer: Observer) -> list[str]:
    """Return the reasons why some steps were not replayed; lost telemetry is reported elsewhere."""
    replay = ending.replay
    if ending.not_replayed:
        return [f"not replayed: {ending.not_replayed}"]
    if replay is None or observer.lost or replay.finding is not None:
        return []
    if replay.doubt:
        return [replay.doubt]
    return [f"replayed up to step {replay.steps} only"] if replay.steps < observer.next_step else []


def _gain(premise: Premise, track: Track, bound: Bound) -> dict[str, Any]:
    """Return the check of one certificate of the adaptive law, at the steps that its premise covers."""
    worst = track.check
    return {
        "ok": bool(worst.excess <= 0),
        "claim": GAIN_CLAIMS[premise],
        "steps": worst.steps,
        "step": worst.step,
        "excess": _finite(worst.excess),
        "gain": bound.gain,
    }


def _check(name: str, worst: Worst, topology: Topology) -> dict[str, Any]:
    node = topology.ids[worst.node] if worst.node >= 0 else None
    named = {} if node is None else {"node": node, "why": [f"node {node}: {worst.why}"]}
    return {
        "ok": bool(worst.excess <= 0),
        "claim": CLAIMS[name],
        "steps": worst.steps,
        "step": worst.step,
        "excess": _finite(worst.excess),
        **named,
    }


def _diverged(metrics: Mapping[str, float | int | None]) -> bool:
    """Return True if the cost left the range of floats, or of what a law may cost, and the oracle's cost did not."""
    cost, cost_oracle = metrics.get("cost"), metrics.get("cost_oracle")
    if cost is None or cost_oracle is None or not math.isfinite(cost_oracle):
        return False
    return not math.isfinite(cost) or cost > DIVERGED * cost_oracle > 0


def _finite(value: float | int | None) -> float | int | None:
    """Return a number that JSON can hold, or None."""
    return value if value is not None and math.isfinite(value) else None
