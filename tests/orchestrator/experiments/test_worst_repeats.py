"""The end of a search: the runs that repeat its attacks are announced and timed, and faults have a baseline."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hedgerow.orchestrator.experiments.worst import Found, worst
from hedgerow.orchestrator.experiments.worst.hunt import Hunt
from hedgerow.orchestrator.experiments.worst.loop import NONE
from tests.orchestrator.experiments.test_worst import EAGER


def test_the_runs_after_a_search_are_announced_and_timed(tmp_path: Path) -> None:
    messages: list[str] = []
    found = worst(EAGER, 0.2, steps=200, out=tmp_path / "w.yaml", say=messages.append)
    assert found.repeat_seconds > 0
    assert found.without_faults is None
    content = json.loads((tmp_path / "w.json").read_text(encoding="utf-8"))
    assert content["repeat_seconds"] == found.repeat_seconds
    assert f"{found.limit:.4f}" in messages[-1]
    assert len(messages) >= 2


def test_runs_that_repeat_no_larger_gain_for_long_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    hunt, quiet, spoken = Hunt(EAGER, steps=200), list[str](), list[str]()
    hunt.run(0.2, lambda _: None)
    monkeypatch.setattr(Hunt, "steady", lambda *_: (False, True))
    for messages, after in ((quiet, 1e9), (spoken, 0.0)):
        monkeypatch.setattr("hedgerow.orchestrator.experiments.worst.hunt.SILENT_S", after)
        with pytest.raises(Exception, match="no disturbance"):
            hunt.repeated(messages.append)
    assert len(spoken) > len(quiet)


def test_a_signal_ends_the_repeats_after_the_first_run_that_repeats_a_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    hunt = Hunt(EAGER, steps=200)
    hunt.run(0.2, lambda _: None)
    made = list(hunt.attacks())
    tried: list[float] = []

    def steady(self: Hunt, attack: object) -> tuple[bool, bool]:
        tried.append(0.0)
        return True, True

    monkeypatch.setattr(Hunt, "steady", steady)
    monkeypatch.setattr(Hunt, "attacks", lambda _: iter([(1e9, attack) for _, attack in made[:1] * 3]))
    assert hunt.repeated(quit_now=lambda: True)[0].gain > 0
    assert len(tried) == 1


def test_a_search_of_faults_has_the_gain_without_faults(tmp_path: Path) -> None:
    found = worst(EAGER, 1.0, faults=True, steps=200, out=tmp_path / "w.yaml")
    assert found.without_faults is not None
    assert found.without_faults > 1
    content = json.loads((tmp_path / "w.json").read_text(encoding="utf-8"))
    assert content["without_faults"] == found.without_faults
    assert all(gain > found.without_faults for _, gain in found.harmful)


def test_faults_that_do_not_raise_the_gain_are_not_harmful() -> None:
    found = worst(EAGER, 0.2, steps=200)
    given = replace(found, without_faults=3.0, faults={"a": 3.0, "b": 2.5, "c": 3.5, "d": 4.0}, faults_of=9)
    assert given.harmful == [("d", 4.0), ("c", 3.5)]
    assert replace(given, faults={"a": 3.0}).harmful == []
    assert _fault_lines(given) == 3  # without faults, d, c
    assert _fault_lines(replace(given, faults={"a": 3.0})) == 1


def _fault_lines(found: Found) -> int:
    return sum(line.startswith("  ") for line in found.text().splitlines())


def test_a_search_knows_its_gain_without_faults_only_after_a_run() -> None:
    hunt = Hunt(EAGER, steps=200)
    assert hunt.unbroken is None
    hunt.run(0.1, lambda _: None)
    assert hunt.unbroken == pytest.approx(
        max(s for (_, b), (_, s, _) in hunt.state.champions.items() if b == NONE) ** 0.5
    )
