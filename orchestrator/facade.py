"""The functions of `import hedgerow as hg`."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hedgerow.orchestrator.experiments import bounds
from hedgerow.orchestrator.experiments.compare import Compared
from hedgerow.orchestrator.experiments.compare import compare as run_comparison
from hedgerow.orchestrator.experiments.compare.plan import comparison
from hedgerow.orchestrator.experiments.worst import Found
from hedgerow.orchestrator.experiments.worst import worst as search
from hedgerow.orchestrator.ground import law_source
from hedgerow.orchestrator.ground.laws import checked
from hedgerow.orchestrator.launch import simulation
from hedgerow.orchestrator.launch.running import Running, run_to_the_end
from hedgerow.orchestrator.metrics.gain_bound import Method
from hedgerow.orchestrator.metrics.guarantee import Guarantee
from hedgerow.orchestrator.runs.folder import RunFolder, new_folder, reserve, withdraw
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code, HedgerowError, UserError, check_options, check_switches
from hedgerow.topologies.in_python import answers_in_python
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.named import Named, resolved, text_of
from hedgerow.topologies.paths import real_path, user_path
from hedgerow.topologies.plain import is_in_script, plain
from hedgerow.topologies.regular_file import read_regular
from hedgerow.topologies.schema import Topology

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["bound", "compare", "load", "load_run", "report", "run", "simulate", "start", "sweep", "worst"]

_PLAIN = re.compile(r"[A-Za-z_][\w.:-]*")


@answers_in_python
def load(network: Named, *settings: str, **overrides: object) -> Topology:
    """Return a network with all numbers drawn.

    `network` is a bundled name, the path of a file or run folder, the YAML text of a file, a dictionary of the same
    shape, or a Topology. Each setting is `path=value`, as for `--set` on the command line: `"nodes.2.x0=1"`. Each
    keyword replaces a top-level key of the file: `load("paper7", steps=300)`. `law` may also be a class, or a
    `functools.partial` of a class with its parameters.
    Raises TopologyError with all mistakes, or UserError if there is no such file.
    """
    return resolved(network, [*settings, *_settings(overrides)])


@answers_in_python
def simulate(
    network: Named,
    *settings: str,
    run_dir: str | Path | None = None,
    kept_law: bool = False,
    **overrides: object,
) -> Run:
    """Run a network in this process, without Zenoh, and return the run.

    `network`, `settings` and `overrides` are those of `load`. If the file of a law changed since it was loaded, it is
    loaded again. `run_dir` is a new folder for the run, by default one in runs/. Warns if `network` is the folder of a
    run that kept another source of the law; with `kept_law`, the law is loaded from that folder. Raises UserError for a
    mistake, LawError if the law fails, and HedgerowError if no step was made.
    """
    return simulation.simulate(network, *settings, *_settings(overrides), run_dir=run_dir, kept=kept_law)


@answers_in_python
def run(
    network: Named,
    *settings: str,
    rate: float = 0.0,
    verify: bool = False,
    record: bool = False,
    viewer: str = "none",
    run_dir: str | Path | None = None,
    kept_law: bool = False,
    **overrides: object,
) -> Run:
    """Run a network as real processes over Zenoh to its end, as `orchestrator up` does, and return the run.

    `network`, `settings` and `overrides` are those of `load`; `processes=3` packs the nodes into 3 processes. `rate`
    is in steps per second, 0 for as fast as possible. `verify` repeats the run in one process and compares all bits.
    `kept_law` loads the law from the folder of a run that `network` is. `record` writes run.rrd, and `viewer` is
    `native`, `web`, `none` or a URL. Ctrl-C ends the network.
    Raises UserError for a mistake, and HedgerowError if the run has no verdict.
    """
    check_switches(verify=verify, record=record, kept_law=kept_law)
    topology = _importable(load(network, *settings, **overrides))
    options = [*_options(rate, record, viewer), *(["--verify"] if verify else [])]
    kept = law_source.kept_law(text_of(network)[2] / law_source.FOLDER) if kept_law else contextlib.nullcontext()
    with kept, _folder(topology, run_dir) as folder:
        return run_to_the_end(topology, folder.path, *options)


class _Started(Running):
    """A running network; its folder is removed if the network does not start."""

    def __init__(self, topology: Topology, run_dir: str | Path | None, options: Sequence[str]) -> None:
        self._run_dir = run_dir
        super().__init__(topology, Path(), *options)

    def __enter__(self) -> _Started:
        with _folder(self.topology, self._run_dir) as folder:
            self._folder = folder.path
            super().__enter__()
        return self


@answers_in_python
def start(
    network: Named,
    *settings: str,
    rate: float = 0.0,
    deadline_s: float = 10.0,
    record: bool = False,
    viewer: str = "none",
    run_dir: str | Path | None = None,
    **overrides: object,
) -> Running:
    """Return a network of real processes that runs while a `with` block does.

    Arguments are those of `run`; `deadline_s` is how long the plant waits for an agent. In the block, `live.fault`
    injects faults, `live.pause()`, `live.step()` and `live.rate()` control the clock, `live.wait_for_step(100)` waits,
    and `live.stop()` ends the run and returns it. The end of the block ends the network.
    """
    topology = _importable(load(network, *settings, **overrides))
    check_options(deadline=deadline_s)
    return _Started(topology, run_dir, [*_options(rate, record, viewer), "--deadline", str(deadline_s)])


@answers_in_python
def sweep(
    network: Named,
    *settings: str,
    seeds: range,
    out: str | Path | None = None,
    jobs: int | None = None,
    engine: str = "in-process",
    **values: object,
) -> pa.Table:
    """Run a network under every seed and every combination of values, and return one row per run.

    `network` is that of `load`; a Topology of `load` is drawn again by each seed, and that of a run folder is not. Each
    setting is `path=values`, as for `--set` on the command line: `"nodes.2.x0=1,2"`. Each keyword is a top-level key
    with a value or a list of values: `law=["minimax", "nominal"]`. `seeds` is a range with stride 1. Runs in `out` are
    not repeated; the default is a folder in sweeps/. `jobs` is the number of processes, by default one per core. If a
    law is defined in the script or notebook itself, this process makes all runs. Raises UserError for a
    mistake, and HedgerowError if the sweep was interrupted.
    """
    import pyarrow.parquet as pq  # noqa: PLC0415 (Arrow takes a while to load)

    from hedgerow.orchestrator.experiments.sweep import sweep as sweep_into  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.sweep.folder import default_out  # noqa: PLC0415
    from hedgerow.orchestrator.experiments.sweep.plan import plan  # noqa: PLC0415

    _check_seeds(seeds)
    check_options(jobs=jobs)
    sets = [
        *settings,
        *(f"{key}={','.join(_text(key, one) for one in _listed(value))}" for key, value in values.items()),
    ]
    planned = plan(network, f"{seeds.start}:{seeds.stop}", sets, engine)
    folder = default_out(planned) if out is None else user_path(str(out))
    done = sweep_into(planned, folder, jobs, quiet=True)
    table = folder / "sweep.parquet"
    if not table.exists():
        raise HedgerowError(done.line)
    return pq.ParquetFile(io.BytesIO(read_regular(table))).read()


@answers_in_python
def report(
    runs: Run | str | Path | Sequence[Run | str | Path],
    out: str | Path | None = None,
    figures: str | Sequence[str] | None = None,
    *,
    force: bool = False,
    width_in: float | None = None,
    style: str | None = None,
    formats: Sequence[str] = ("pdf", "png"),
) -> list[Path]:
    """Write the figures of one or several runs and a page with all numbers into a folder, and return the files.

    `runs` are runs or the names that `load_run` takes. `figures` picks some, as in `["2", "4", "gain"]`. `force`
    replaces an earlier report in `out`. `width_in` is the width of a figure [in], by default one column. `style` is a
    .mplstyle file or the name of a style of matplotlib. `formats` are of pdf, png, svg and pgf. Raises UserError.
    """
    from hedgerow.orchestrator.report import report as write  # noqa: PLC0415

    several = [runs] if isinstance(runs, Run | str | Path) else [*runs]
    loaded = [one if isinstance(one, Run) else load_run(one) for one in several]
    return write(
        loaded,
        None if out is None else user_path(str(out)),
        figures if figures is None or isinstance(figures, str) else ",".join(map(str, figures)),
        force,
        width_in=width_in,
        style=style,
        formats=[formats] if isinstance(formats, str) else formats,
    )


@contextlib.contextmanager
def _folder(topology: Topology, run_dir: str | Path | None) -> Iterator[RunFolder]:
    """Yield the folder for a run; remove it if the block raises an error before the run begins."""
    if run_dir is None:
        folder = reserve(topology.name)
    else:
        path = user_path(str(run_dir))
        made = not path.exists()
        new_folder(path, f"run_dir={str(run_dir)!r}")
        folder = RunFolder(real_path(path))
        folder.made = made
    try:
        yield folder
    except BaseException:
        if not folder.events.exists():
            withdraw(folder)
        raise


def _options(rate: float, record: bool, viewer: str) -> list[str]:
    check_options(rate=rate)
    return ["--rate", str(rate), "--viewer", viewer, "--record" if record else "--no-record"]


@answers_in_python
def bound(network: Named, *settings: str, full: bool = False, split: bool = False, **overrides: object) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law.

    `network`, `settings` and `overrides` are those of `load`. `full` seeks a full storage matrix, for up to 30 nodes.
    `split` uses one small matrix per node at any size, which may take minutes. A bound that cannot be computed is in
    `not_computed`, with the reason.
    """
    check_switches(full=full, split=split)
    method = Method.FULL if full else Method.SPLIT if split else None
    return bounds.bound(load(network, *settings, **overrides), method)


@answers_in_python
def worst(
    network: Named,
    *settings: str,
    budget: float = 60.0,
    faults: bool = False,
    seed: int = 0,
    out: str | Path | None = None,
    **overrides: object,
) -> Found:
    """Search for `budget` seconds the disturbance with the largest gain, and return it with a network that repeats it.

    `network`, `settings` and `overrides` are those of `load`; `law="hinf"` attacks another law. `faults` searches cuts
    and drops too. `out` is the file of the network. The search keeps its state beside it, and a later call continues
    the search; by default nothing is written. Raises HedgerowError if no disturbance was found.
    """
    check_options(budget=budget)
    check_switches(faults=faults)
    topology = checked(load(network, *settings, **overrides))
    return search(topology, budget, faults, seed, out=None if out is None else user_path(str(out)))


@answers_in_python
def compare(
    network: Named,
    laws: str | Sequence[str | type[Any] | functools.partial[Any]] = ("minimax",),
    disturbances: str | Mapping[str, object] | Sequence[str | Mapping[str, object]] = ("file",),
    seeds: range = range(50),
    *,
    settings: Sequence[str] = (),
    out: str | Path | None = None,
    jobs: int = 1,
    **overrides: object,
) -> Compared:
    """Run every law under every disturbance and seed, hinf and nominal too; return their means, tests and findings.

    `laws` are as in a file, or classes, also with parameters: `["minimax", "forgetting(decay=0.98)", MyLaw,
    partial(MyLaw, p0=10)]`. A disturbance is `file`, the name of a preset (`sinusoid`, `white`, `ar1`, `constant`,
    `confuse`, `none`), names joined by `+`, or a mapping as in a file.
    `settings` and `overrides` are those of `load`. `out` is the folder of the results, which the same call finds again.
    With `jobs` above 1, processes share the runs, unless a law is defined in the script or notebook itself. Raises
    UserError for a mistake.
    """
    _check_seeds(seeds)
    check_options(jobs=jobs)
    plan = comparison(
        network,
        [*map(_law, [laws] if isinstance(laws, str) else laws)],
        [disturbances] if isinstance(disturbances, str | Mapping) else disturbances,
        seeds,
        [*settings, *_settings(overrides)],
    )
    found = run_comparison(plan, None if out is None else user_path(str(out)), jobs, quiet=True)
    if found is None:
        raise KeyboardInterrupt
    return found


def _check_seeds(seeds: object) -> None:
    if not isinstance(seeds, range) or seeds.step != 1:
        raise UserError(f"seeds={seeds!r}: give a range without a stride, such as range(50)", code=Code.OPTION)


def _settings(overrides: Mapping[str, object]) -> list[str]:
    return [f"{key}={json.dumps(plain(value, f'{key}: '))}" for key, value in overrides.items()]


def _law(law: object) -> str:
    """Return a law as the text of a LawChoice; UserError if it is neither a text, nor a class, nor a partial of one."""
    found = plain(law, "law: ")
    try:
        if isinstance(found, dict):
            name = found.pop("class", None) or found.pop("name")
            return str(LawChoice.of(name, found))
    except (KeyError, ValueError) as error:
        raise UserError(f"laws: {law!r} {error}. Correct it.", code=Code.OPTION) from None
    if isinstance(found, str):
        return found
    raise UserError(f"laws: {law!r} is neither a text nor a class. Give one of both.", code=Code.OPTION)


def _text(key: str, value: object) -> str:
    """Return a value as the command line spells it."""
    found = plain(value, f"{key}: ")
    return found if isinstance(found, str) and _PLAIN.fullmatch(found) else json.dumps(found)


def _listed(value: object) -> Sequence[object]:
    return value if isinstance(value, Sequence) and not isinstance(value, str) else [value]


def _importable(topology: Topology) -> Topology:
    """Return a topology with a law that another process can import. Raises UserError."""
    law = topology.law
    if is_in_script(law):
        name = law.partition(":")[2]
        where = getattr(sys.modules["__main__"], "__file__", None) or "this notebook or prompt"
        raise UserError(
            f"law: {name} is defined in {where}, which an agent process cannot import. Move the class to a module,"
            " or use hedgerow.simulate.",
            code=Code.LAW,
        )
    return topology
