"""Finished runs in a viewer: one run from its run.rrd or its tables; several runs on the same axes."""

from __future__ import annotations

import threading
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from hedgerow.orchestrator.ground.foreign_stderr import foreign_stderr
from hedgerow.orchestrator.ground.signals import Interrupts
from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.files import check_file, find_run, load_resolved
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.round_trips import processes_of
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.views.event_line import event_line
from hedgerow.orchestrator.views.palette import Color, hues
from hedgerow.orchestrator.views.rerun.rrd_file import parts
from hedgerow.orchestrator.views.rerun.stream import APPLICATION, RerunStream
from hedgerow.orchestrator.views.rerun.viewer import Viewer, start
from hedgerow.orchestrator.views.rerun.viewer_version import VERSION_DEADLINE_S, compare
from hedgerow.orchestrator.views.rerun.watch import (
    CLOSE_DEADLINE_S,
    MEMORY,
    READ_STEPS,
    PatientStream,
    as_begun,
    keep_page,
)
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.escape import markdown
from hedgerow.topologies.regular_file import open_regular
from hedgerow.wire.message import TAKEN, End, Telemetry

Say = Callable[[str], None]
Columns = NDArray[np.float64]

CHUNKS = 64
"""the number of chunks between two checks that the viewer reads them"""
FLUSH_DEADLINE_S = 30.0
ROWS = 2**14
"""the rows of a comparison in one chunk"""


def open_runs(runs: Sequence[str], choice: str, say: Say) -> None:
    """Show runs in the chosen viewer, and leave it open; serve a page until Ctrl-C.

    Raise UserError if there is nothing to show, HedgerowError if the viewer fails.
    """
    folders = [find_run(run) for run in runs]
    for folder in folders:
        if any(Path(entry.folder) == folder and not entry.is_over for entry in registry.running()):
            say(f"{folder.name}: is still running: this is as far as it has come; `orchestrator watch` follows it")
    compared = [load_run(folder) for folder in folders] if len(folders) > 1 else []
    if compared:
        common_nodes(compared)
    wake = threading.Event()
    with Interrupts(wake.set) as interrupts:
        viewer = start(choice, MEMORY, MEMORY)
        assert viewer is not None, "nothing opens in no viewer"
        try:
            viewer.wait_until_it_listens()
            compare(viewer, say).join(VERSION_DEADLINE_S)
            if compared:
                _compare(compared, viewer)
            else:
                _open(folders[0], viewer, say, lambda: not interrupts.count)
            say(f"{' and '.join(folder.name for folder in folders)}: shown at {viewer.link or viewer.url}")
            keep_page(viewer, interrupts, wake, say)
        finally:
            viewer.end()


def _open(folder: Path, viewer: Viewer, say: Say, go_on: Callable[[], bool]) -> None:
    files = parts(folder / "run.rrd")
    if why := _unreadable(files):
        say(f"{folder.name}: {why}: shown from its tables")
        _replay(load_run(folder), viewer, say, go_on)
        return
    topology = load_resolved(folder)
    # Use the current layout, not that of the recording.
    made = RerunStream(topology, Observer(topology), folder.name, None, None, processes=processes_of(folder, topology))
    stream = made.opened(rr.GrpcSink(viewer.url))
    with warnings.catch_warnings(action="ignore"):
        for file in files:
            _send(_chunks(file), stream, viewer)
    stream.disconnect()


def _chunks(file: Path) -> Iterator[Any]:
    """Yield the chunks of a recording, up to the last readable one."""
    with foreign_stderr():
        chunks = iter(RrdReader(spelled(file)).stream())
    while True:
        try:
            with foreign_stderr():
                chunk = next(chunks)
        except StopIteration:
            return
        except BaseException as error:
            # A panic of Rerun's reader arrives as an error of a class that cannot be imported.
            if not isinstance(error, RuntimeError | ValueError | OSError) and type(error).__name__ != "PanicException":
                raise
            why = str(error).splitlines()[0]
            raise UserError(
                f"{file}: is damaged ({why}); move it away, and the run is shown from its tables", code=Code.FILE_FORMAT
            ) from None
        yield chunk


def _unreadable(files: Sequence[Path]) -> str:
    """Return the reason why a recording cannot be opened; empty if all can."""
    if not files:
        return "there is no run.rrd"
    for file in files:
        try:
            check_file(file)
            with open_regular(file, file.parent) as opened:
                head = opened.read(8)
        except (UserError, OSError) as error:
            return str(error) if isinstance(error, UserError) else f"{file.name} cannot be read ({error.strerror})"
        if len(head) < 8 or not head.startswith(b"RRF"):
            return f"{file.name} is empty or no recording"
        written, ours = (head[4], head[5]), tuple(int(part) for part in rr.__version__.split(".")[:2])
        if written > ours:
            return f"{file.name} was written by Rerun {head[4]}.{head[5]}, newer than {rr.__version__} here"
        try:
            # The recording of a killed run has no footer, which only costs time.
            with warnings.catch_warnings(action="ignore"), foreign_stderr():
                if not RrdReader(spelled(file)).recordings():
                    raise ValueError("it holds no recording")
        except (RuntimeError, ValueError, OSError) as error:
            return f"{file.name} cannot be read ({error})"
    return ""


def _send(chunks: Iterable[Any], stream: rr.RecordingStream, viewer: Viewer) -> None:
    for number, chunk in enumerate(chunks, 1):
        stream.send_chunks(chunk)
        if number % CHUNKS == 0:
            _flush(stream, viewer)
    _flush(stream, viewer)


def _flush(stream: rr.RecordingStream, viewer: Viewer) -> None:
    """Wait until the viewer has received all data: Rerun would block if it held too much."""
    try:
        stream.flush(timeout_sec=FLUSH_DEADLINE_S)
    except RuntimeError as error:
        if "timed out" in str(error):
            raise HedgerowError(
                f"{viewer.url}: has taken nothing for {FLUSH_DEADLINE_S:g} s: the viewer is frozen; close it, and open"
                " the run again",
                code=Code.VIEWER,
            ) from None
        raise HedgerowError(
            f"{viewer.url}: the viewer was closed ({error}); the run is untouched: open it again",
            code=Code.VIEWER,
        ) from None


def _replay(run: Run, viewer: Viewer, say: Say, go_on: Callable[[], bool]) -> None:
    """Show a run from its tables; compute each metric again."""
    run.need_all("to be shown from its tables")
    begun = as_begun(run.topology, run.folder)
    observer = Observer(begun)
    stream = PatientStream(begun, observer, run.name, viewer, say, run.T)
    observer.change(run.topology)
    for line in filter(None, map(event_line, run.events)):
        stream.event(*line)
    received = run.received.view(np.uint8)
    used = np.full(received.shape[1], TAKEN, np.uint8)
    report = np.stack([run.ahat, run.margin], axis=1)
    steps = np.setdiff1d(np.arange(run.T), run.lost)
    for some in np.array_split(steps, -(-len(steps) // READ_STEPS)):
        if not go_on():
            break
        rows = [
            Telemetry(int(t), run.x[t], run.u[t], run.w[t], report[t], run.edge_open[t], received[t], used)
            for t in some
        ]
        stream.log(observer.take(rows))
        stream.wait(go_on)
    else:
        observer.finish(End(run.T, run.x[-1], 0.0))
        stream.end(observer)
    stream.close(CLOSE_DEADLINE_S)


def common_nodes(runs: Sequence[Run]) -> list[int | str]:
    """Return the nodes that all runs have, in the order of the first; raise UserError if there is none."""
    found = [node for node in runs[0].ids if all(node in run.ids for run in runs)]
    if not found:
        networks = ", ".join(f"{run.name} has {_some(run.ids)}" for run in runs)
        raise UserError(
            f"these runs have no node in common, so no axes: {networks}; open them one by one", code=Code.OPTION
        )
    return found


def _some(ids: Sequence[int | str]) -> str:
    return ", ".join(map(str, ids[:4])) + (", …" if len(ids) > 4 else "")


def labels(runs: Sequence[Run]) -> list[str]:
    """Return a name for each run: its law if all laws differ, otherwise its folder, with a number if that repeats."""
    laws = [run.law for run in runs]
    names = laws if len(set(laws)) == len(runs) else [run.name for run in runs]
    times = Counter(names)
    return [name if times[name] == 1 else f"{name} ({number})" for number, name in enumerate(names, 1)]


SHARED = {
    "x": "States x",
    "regret_sum": "Cumulative regret D = Σ|x − x*|² [x²]",
    "cost_regret": "Cost regret R [x²]",
    "gain": "Gain √(Σcost / Σ|w|²); thin: γ*, the oracle's",
    "nodes_right": "Estimates right [nodes]",
}
"""The quantities of a comparison: an entity in the folder of each run, and the title of the shared panel."""


def _compare(runs: Sequence[Run], viewer: Viewer) -> None:
    names = labels(runs)
    stream = rr.RecordingStream(APPLICATION + " comparison", recording_id=" and ".join(run.name for run in runs))
    stream.set_log_time_enabled(False)
    stream.set_sinks(rr.GrpcSink(viewer.url), default_blueprint=comparison_blueprint(names))
    stream.log("about", rr.TextDocument(_about(runs, names), media_type=rr.MediaType.MARKDOWN), static=True)
    nodes, own = common_nodes(runs), hues(len(runs))
    for place, (run, name) in enumerate(zip(runs, names, strict=True)):
        # The lines of x have the colours of their nodes; those of the first run are the widest.
        width = 2.5 / (1 + place)
        for entity, titles, colors, widths, values in _series(run, name, nodes, own[place], width):
            path = rr.new_entity_path([name, entity])
            stream.log(path, rr.SeriesLines(names=titles, colors=colors, widths=widths), static=True)
            steps = run.rows if entity == "x" else np.arange(len(values))
            for first in range(0, len(steps), ROWS):
                some = steps[first : first + ROWS]
                index, part = rr.TimeColumn("step", sequence=some), values[some]
                stream.send_columns(path, [index], rr.Scalars.columns(scalars=part))
            _flush(stream, viewer)
    stream.disconnect()


Series = tuple[str, list[str], list[Color], list[float], Columns]


def _series(run: Run, name: str, nodes: Sequence[int | str], own: Color, width: float) -> Iterable[Series]:
    """Yield each shared entity of a run: the names, colours and widths of its series, and their values, (steps,
    series).
    """
    places = [run.ids.index(node) for node in nodes]
    yield "x", [f"{name}: {node}" for node in nodes], hues(len(nodes)), [width] * len(nodes), run.x[:, places]
    for entity, values in (
        ("regret_sum", run.regret_sum),
        ("cost_regret", run.cost_regret),
        ("nodes_right", run.right.astype(np.float64)),
    ):
        yield entity, [name], [own], [2.0], values[:, None]
    gains = np.stack([run.gain, np.full(run.T, run.gamma_star)], axis=1)
    yield "gain", [name, f"{name}: γ*"], [own, own], [2.0, 0.75], gains


def comparison_blueprint(names: Sequence[str]) -> rrb.Blueprint:
    """Return a layout with a panel for each shared quantity, with all runs in it, and a page of text."""
    plots = [
        rrb.TimeSeriesView(
            origin="/",
            contents=[rr.new_entity_path([name, entity]) for name in names],
            name=title,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=entity != "x"),
        )
        for entity, title in SHARED.items()
    ]
    words = rrb.TextDocumentView(origin="/about", name="About")
    return rrb.Blueprint(
        rrb.Grid(*plots, words, grid_columns=2),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="paused"),
    )


def _about(runs: Sequence[Run], names: Sequence[str]) -> str:
    """Return a table of the compared runs, in Markdown."""
    lines = [
        f"| {markdown(name)} | {markdown(run.name)} | {markdown(run.topology.name)} | {markdown(run.law)} |"
        f" {run.topology.seed} | {run.T} | {run.regret_sum[-1]:.4g} | {run.cost_regret[-1]:+.4g} |"
        f" {markdown(str(run.verdict.content.get('verdict', '–')))} |"
        for run, name in zip(runs, names, strict=True)
    ]
    head = "| shown as | run | network | law | seed | steps | D | R | verdict |\n|---|---|---|---|---|---|---|---|---|"
    return "\n".join(
        [
            "# Runs compared\n",
            head,
            *lines,
            "\nIn *States* a colour is a node, and the first run has the boldest lines. Elsewhere a colour is a run.",
            "D and R compare each run with the oracle of its *own* disturbances: those of two runs are about the same",
            "thing only if both had the same network, seed and faults.",
        ]
    )
