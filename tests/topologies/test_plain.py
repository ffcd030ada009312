"""Values of Python and numpy in a network, and arguments of the wrong type."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.topologies.faults import Drop
from hedgerow.topologies.plain import plain
from hedgerow.topologies.resolve import to_yaml

PAIR: dict[str, Any] = {"name": "pair", "b": 0.1, "steps": 6, "nodes": ["p", "q"], "edges": [["p", "q"]]}


class Half(hg.Minimax):
    def __init__(self, b: Any, candidates: Any, p: Any = 2) -> None:
        super().__init__(b, candidates)
        self.p = p

    def act(self, x: Any) -> Any:
        return super().act(x) / self.p


@pytest.mark.parametrize(
    ("given", "in_a_file"),
    [
        ({"steps": np.int64(6)}, {}),
        ({"b": np.float64(0.1)}, {}),
        ({"b": np.array(0.1)}, {}),
        ({"edges": {("p", "q")}}, {}),
        ({"edges": np.array([["p", "q"]])}, {}),
        ({"nodes": {"p", "q"}}, {}),
        ({"nodes": {"p": {"x0": np.float32(0.5)}, "q": None}}, {"nodes": {"p": {"x0": 0.5}, "q": None}}),
        ({"law": hg.Minimax}, {"law": "minimax"}),
        ({"law": Half}, {"law": f"{__name__}:Half"}),
        ({"law": functools.partial(Half, p=np.int64(3))}, {"law": {"class": f"{__name__}:Half", "p": 3}}),
        (
            {"faults": [{"kind": "drop", "link": ("p", "q"), "steps": range(2, 4)}]},
            {"faults": [{"kind": "drop", "link": ["p", "q"], "steps": [2, 4]}]},
        ),
        (
            {"faults": [Drop(link=("p", "q"), steps=(2, 4))]},
            {"faults": [{"kind": "drop", "link": ["p", "q"], "steps": [2, 4]}]},
        ),
    ],
    ids=lambda given: "" if isinstance(given, dict) and not given else " ".join(given),
)
def test_values_of_python_are_those_of_a_file(given: dict[str, Any], in_a_file: dict[str, Any]) -> None:
    expected = to_yaml(hg.load({**PAIR, **in_a_file}))
    assert to_yaml(hg.load({**PAIR, **given})) == expected
    assert to_yaml(hg.Network(**{**PAIR, **given}).topology) == expected
    if "law" not in given:
        assert to_yaml(hg.load(PAIR, **given)) == expected


def itself() -> dict[str, Any]:
    cycle: dict[str, Any] = {**PAIR}
    cycle["defaults"] = cycle
    return cycle


@pytest.mark.parametrize(
    "call",
    [
        lambda: hg.load(itself()),
        lambda: hg.load(PAIR, law=itself),
        lambda: hg.load(PAIR, law=Half(0.1, np.array([[0.5, 0.5]]))),
        lambda: hg.load(PAIR, faults=[object()]),
        lambda: hg.load(PAIR, steps=b"6"),
        lambda: hg.load({("p",): 3}),  # type: ignore[dict-item]
        lambda: hg.load(None),  # type: ignore[arg-type]
        lambda: hg.sweep(PAIR, seeds=5),  # type: ignore[arg-type]
        lambda: hg.sweep(PAIR, seeds=[1, 2]),  # type: ignore[arg-type]
        lambda: hg.sweep(PAIR, seeds=range(0, 8, 2)),
        lambda: hg.sweep(PAIR, seeds=range(2), jobs=0),
        lambda: hg.compare(PAIR, seeds=3),  # type: ignore[arg-type]
        lambda: hg.compare(PAIR, seeds=range(2), jobs=-1),
        lambda: hg.worst(PAIR, budget=0),
        lambda: hg.worst(PAIR, budget=float("nan")),
        lambda: hg.worst(PAIR, budget="5s"),  # type: ignore[arg-type]
        lambda: hg.run(PAIR, rate="fast"),  # type: ignore[arg-type]
        lambda: hg.run(PAIR, run_dir="/dev/null/runs"),
        lambda: hg.start(PAIR, deadline_s="1 s"),  # type: ignore[arg-type]
        lambda: hg.load_run(None),  # type: ignore[arg-type]
    ],
)
def test_a_wrong_argument_is_the_users_mistake(
    call: Callable[[], object], tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(hg.UserError):
        call()
    assert not list(tmp_path.iterdir())


def test_a_set_has_one_order() -> None:
    ids = [f"n{k}" for k in range(20)]
    assert plain(set(ids)) == sorted(ids)
