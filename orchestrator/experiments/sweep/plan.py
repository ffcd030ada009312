"""The plan of a sweep: every combination of the values of its keys, under every seed."""

from __future__ import annotations

import itertools
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from hedgerow.orchestrator.ground import laws
from hedgerow.orchestrator.ground.law_source import LawSource, source_of
from hedgerow.orchestrator.ground.versions import versions
from hedgerow.orchestrator.runs import batch
from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.named import Given, Named, given
from hedgerow.topologies.override import split_setting
from hedgerow.topologies.plain import is_in_script
from hedgerow.topologies.resolve import digest, resolve
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.source import read_source

ENGINES = ("in-process", "zenoh")
MAX_RUNS = 10_000_000
_STEPS_A_CHUNK = 600
LEAST_CHUNKS = 8
"""chunks of a plan with enough seeds, so that several processes share them"""


class Chunk(NamedTuple):
    """Some runs that one process makes in a row: the place of their setting, and their seeds."""

    setting: int
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class Setting:
    """One combination of values."""

    values: tuple[str, ...]
    """one value per key of the sweep, as the command line spells it"""
    topology: Topology
    """not drawn yet: every seed draws its own numbers"""


@dataclass(frozen=True)
class Plan:
    """The runs of a sweep."""

    keys: tuple[str, ...]
    settings: tuple[Setting, ...]
    seeds: range
    engine: str
    folder: Path
    """the folder of the topology's CSV files"""

    @property
    def name(self) -> str:
        """Return the name of the network."""
        return self.settings[0].topology.name

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return len(self.settings) * len(self.seeds)

    @property
    def law_in_script(self) -> bool:
        """Return True if a law is defined in the script or notebook that runs, so that only this process has it."""
        return any(is_in_script(setting.topology.law) for setting in self.settings)

    def label(self, setting: int) -> str:
        """Return a setting in words."""
        values = self.settings[setting].values
        return ", ".join(f"{key}={value}" for key, value in zip(self.keys, values, strict=True)) or self.name

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Return the data that two sweeps must share for one table: everything except the seeds, which may be
        extended.
        """
        values = zip(*(setting.values for setting in self.settings), strict=True)
        sources = {k: source.digest for k, source in enumerate(self.sources) if source.files}
        return {
            **({"laws": [sources.get(k, "") for k in range(len(self.settings))]} if sources else {}),
            "name": self.name,
            "engine": self.engine,
            "set": {key: list(dict.fromkeys(own)) for key, own in zip(self.keys, values, strict=True)},
            "versions": dict(versions()),
            # Drawn with the seed of the file, so that it covers the numbers of CSV files too.
            "networks": [digest(resolve(one.topology, self.folder)) for one in self.settings],
        }

    @cached_property
    def one_by_one(self) -> tuple[str, ...]:
        """Return, by setting, the reason why its runs are made one by one; empty if they are made in batches."""
        if self.engine == "zenoh":
            return ("they run over Zenoh",) * len(self.settings)
        return tuple(batch.why_not(setting.topology) for setting in self.settings)

    @cached_property
    def sources(self) -> list[LawSource]:
        """Return the source of the law of each setting."""
        laws = {setting.topology.law for setting in self.settings}
        known = {law: source_of(law) for law in laws}
        return [known[setting.topology.law] for setting in self.settings]

    def chunks(self, done: Container[tuple[int, int]]) -> Iterator[Chunk]:
        """Yield the runs without those that are `done`: (place of the setting, seed)."""
        pieces = -(-LEAST_CHUNKS // len(self.settings))
        for k, setting in enumerate(self.settings):
            size = 1 if self.engine == "zenoh" else max(1, _STEPS_A_CHUNK // setting.topology.steps)
            if not self.one_by_one[k]:
                size = min(batch.seeds_at_once(setting.topology), -(-len(self.seeds) // pieces))
            lacking = (seed for seed in self.seeds if (k, seed) not in done)
            while seeds := tuple(itertools.islice(lacking, size)):
                yield Chunk(k, seeds)


def plan(network: Named, seeds: str, sets: Sequence[str], engine: str) -> Plan:
    """Return the plan of a command line; raise UserError for a mistake in it, TopologyError for one in the file."""
    if engine not in ENGINES:
        raise UserError(f"--engine {engine}: is neither {' nor '.join(ENGINES)}; choose one of them")
    asked, values = seeds_of(seeds), _values(sets)
    undrawn = given(network)
    undrawn.parse()
    settings = [
        Setting(combination, _with(undrawn, dict(zip(values, combination, strict=True))))
        for combination in itertools.product(*values.values())
    ]
    if len(settings) * len(asked) > MAX_RUNS:
        raise UserError(
            f"{len(settings)} settings with {len(asked)} seeds: at most {MAX_RUNS} runs; ask for fewer",
            code=Code.OPTION,
        )
    settings = [Setting(setting.values, laws.checked(setting.topology, undrawn.folder)) for setting in settings]
    return Plan(tuple(values), tuple(settings), asked, engine, undrawn.folder)


def seeds_of(text: str) -> range:
    """Return the seeds of FIRST:STOP; raise UserError for another text."""
    first, _, stop = text.partition(":")
    if not (first.isdecimal() and stop.isdecimal()):
        raise UserError(f"--seeds {text}: is not FIRST:STOP; write for example 0:1000, which ends with 999")
    seeds = range(int(first), int(stop))
    if not seeds:
        raise UserError(f"--seeds {text}: holds no seed; put the smaller number first, as in 0:1000")
    if seeds.stop > 2**63:
        raise UserError(f"--seeds {text}: goes too far; a seed is below 2^63")
    return seeds


def _values(sets: Sequence[str]) -> dict[str, list[str]]:
    """Return the values of each key."""
    values: dict[str, list[str]] = {}
    for setting in sets:
        key, text = split_setting(setting)
        if not key:
            raise UserError(f"--set {setting}: is not path=value,value; for example --set defaults.x0=0,15")
        if key == "seed":
            raise UserError(f"--set {setting}: seeds are given with --seeds FIRST:STOP")
        if key in values:
            raise UserError(f"--set {setting}: {key} is set twice; give all its values at once, with commas")
        values[key] = split(text)
        for value in values[key]:
            if not value or values[key].count(value) > 1:
                what = f"{value} is there twice" if value else "a value is empty"
                raise UserError(f"--set {setting}: {what}; give each value once, with commas between them")
    return values


def split(text: str, at: str = ",") -> list[str]:
    """Return values in YAML, split at the commas, or another sign, outside brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for sign in text:
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        depth += not quote and (sign in "[{(") - (sign in "]})")
        if sign == at and not quote and depth == 0:
            parts.append("")
        else:
            parts[-1] += sign
    return [part.strip() for part in parts]


def _with(undrawn: Given, values: dict[str, str]) -> Topology:
    """Return the topology with some values replaced; raise UserError, in one line, for an invalid value."""
    try:
        topology = undrawn.with_overrides(*(f"{key}={value}" for key, value in values.items())).parse()
        resolve(topology, undrawn.folder)
    except TopologyError as error:
        sets = " ".join(f"--set {key}={value}" for key, value in values.items())
        raise UserError(f"{sets}: {error.problems[0]}", code=Code.TOPOLOGY) from None
    return topology


def typed(values: Sequence[str]) -> list[Any]:
    """Return the values of a key for a column: numbers or booleans if all of them are, otherwise texts."""
    read = [read_source("--set", value.encode()).value for value in values]
    if all(type(value) is int for value in read) or all(type(value) is bool for value in read):
        return read
    if all(type(value) in (int, float) for value in read):
        return [float(value) for value in read]
    return list(values)
