"""Mistakes in a user's law: each is refused, or ends the run, with the line of the law."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import hedgerow as hg
from hedgerow.agents.loading import LawError, declared, law_class
from hedgerow.orchestrator.ground.laws import with_defaults
from hedgerow.topologies.errors import Code, Exit, UserError
from hedgerow.topologies.law_choice import LawChoice
from tests.tools.processes import orchestrator

LAWS = """
from __future__ import annotations
import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
import numpy as np
from pydantic import BaseModel, Field
from hedgerow.agents.law import Minimax
if TYPE_CHECKING:
    from numpy.typing import NDArray
    from hedgerow.agents.local import Received, Local

class Counts(Minimax):  # a process has no rows of candidates for the lists of other processes
    def act(self, x):
        return super().act(x) / len(self.candidates)

class Grows(Minimax):
    def __init__(self, b, candidates):
        super().__init__(b, candidates)
        self.past = np.empty((0, candidates.shape[1]))
    @property
    def memory(self):
        return self.past
    @memory.setter
    def memory(self, memory):
        self.past = memory
    def _choose(self):
        self.ahat[:] = 0.5
    def learn(self, x, flow, x_next):
        self.past = np.vstack([self.past, x])

class TurnsToFloats(Grows):
    def __init__(self, b, candidates):
        super().__init__(b, candidates)
        self.past = np.zeros((1, candidates.shape[1]), dtype=int)
    def learn(self, x, flow, x_next):
        self.past = np.where(np.isfinite(flow), x, self.past)

class ChangesCandidates(Minimax):
    def __init__(self, b, candidates):
        super().__init__(b, candidates)
        candidates[:] = 0.5

class Exits(Minimax):
    def act(self, x):
        sys.exit(0)

class ExitsLate(Minimax):
    def act(self, x, now):
        if now.t == 20:
            sys.exit(0)
        return super().act(x)

class IsComplex(Minimax):
    def act(self, x):
        return super().act(x) + 0j

class NoSetter(Minimax):
    @property
    def memory(self):
        return self.J

class WrongText(Minimax):
    def act(self, x):
        return ["a"] * len(x)

class ReportsLate(Minimax):
    def act(self, x, now):
        self.t = now.t
        return super().act(x)
    def report(self):
        if self.t == 20:
            raise ValueError("no")
        return super().report()

class ChangesLate(Minimax):
    def act(self, x, now):
        u = super().act(x)
        if now.t >= 20:
            x *= 2
        return u

class Typed(Minimax):  # its annotations exist for a type checker alone
    def __init__(self, b: float, candidates: NDArray, *, local: Local, share: float = .2, kind: Received | None = None):
        super().__init__(b, candidates)

class ByPosition(Minimax):
    def __init__(self, b, candidates, decay=0.9):
        super().__init__(b, candidates)

class Model(Minimax):
    class Parameters(BaseModel):
        decay: float = Field(0.9, gt=0, le=1)
        gains: list[float] = Field(default_factory=lambda: [1.0, 2.0])
    def __init__(self, b, candidates, parameters):
        super().__init__(b, candidates)
        assert isinstance(parameters.gains, list)

class Data(Model):
    @dataclass
    class Parameters:
        decay: float = 0.9
        gains: list[float] = field(default_factory=lambda: [1.0, 2.0])

@dataclass
class IsData:
    b: float
    candidates: NDArray
    decay: float = field(default=0.9, kw_only=True)
    lags: list[int] = field(default_factory=list, kw_only=True)
    def __post_init__(self):
        self.memory = np.empty((0, self.candidates.shape[1]))
    def act(self, x):
        return -self.decay * 0.1 * x
    def learn(self, x, flow, x_next):
        pass
    def report(self):
        return np.full((2, self.candidates.shape[1]), np.nan)

instance = Minimax(0.1, np.array([[0.5]]))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("laws")
    (folder / "mistaken_laws.py").write_text(LAWS)
    (folder / "leaving_law.py").write_text("raise SystemExit(0)\n")
    return folder


@pytest.fixture(autouse=True)
def here(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(folder)
    return folder


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("Counts", "act"),
        ("Grows", "learn"),
        ("TurnsToFloats", "learn"),
        ("ChangesCandidates", "__init__"),
        ("Exits", "act"),
        ("IsComplex", "act"),
        ("NoSetter", "memory"),
        ("WrongText", "act"),
    ],
)
def test_the_contract_refuses_it_at_a_line_of_the_users_file(name: str, method: str) -> None:
    with pytest.raises(LawError) as refused:
        hg.testing.check_law(f"mistaken_laws:{name}")
    assert refused.value.method == method
    assert re.match(r"\S*mistaken_laws\.py:\d+: ", str(refused.value)), str(refused.value)


@pytest.mark.parametrize(("name", "method"), [("ExitsLate", "act"), ("ReportsLate", "report"), ("ChangesLate", "act")])
def test_a_mistake_after_the_trial_ends_the_run_with_its_method(name: str, method: str) -> None:
    """The states are read-only for a law in this process, as those of a message are in an agent."""
    with pytest.raises(LawError) as failed:
        hg.simulate("paper7", law=f"mistaken_laws:{name}")
    assert failed.value.method == method
    assert re.match(r"\S*mistaken_laws\.py:\d+: ", str(failed.value)), str(failed.value)


def test_a_law_that_exits_is_a_mistake_and_no_success(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(here)
    for law in ("mistaken_laws:ExitsLate", "leaving_law:Law"):
        done = orchestrator("simulate", "paper7", f"--law={law}", "--no-record")
        assert done.returncode == Exit.USER_MISTAKE, done.stdout + done.stderr


def test_a_name_that_is_no_class_is_refused() -> None:
    for name in ("mistaken_laws:instance", "mistaken_laws.py:Counts", "statistics:Law"):
        with pytest.raises(UserError) as refused:
            law_class(name)
        assert refused.value.code == Code.LAW


def test_annotations_for_a_type_checker_alone_are_no_mistake() -> None:
    hg.testing.check_law("mistaken_laws:Typed(share=0.5)")
    with pytest.raises(UserError):
        hg.testing.check_law("mistaken_laws:Typed(share='much')")


@pytest.mark.parametrize("name", ["Model", "Data", "IsData"])
def test_a_default_that_a_factory_makes_is_a_default(name: str) -> None:
    law: Any = law_class(f"mistaken_laws:{name}")
    assert declared(law)["decay"] == 0.9
    assert with_defaults(law, {}, "")[{"IsData": "lags"}.get(name, "gains")] in ([], [1.0, 2.0])
    hg.testing.check_law(f"mistaken_laws:{name}(decay=1)")


@pytest.mark.parametrize("name", ["Model", "Data", "IsData"])
def test_a_parameter_of_another_type_is_refused_and_never_converted(name: str) -> None:
    """The law would receive it as it was written."""
    for value in ("'0.5'", "True", "[0.5]"):
        with pytest.raises(UserError) as refused:
            hg.testing.check_law(f"mistaken_laws:{name}(decay={value})")
        assert refused.value.code == Code.LAW
        assert not isinstance(refused.value, LawError)


def test_a_parameter_by_position_is_refused_with_the_fix() -> None:
    with pytest.raises(UserError) as refused:
        hg.testing.check_law("mistaken_laws:ByPosition(decay=0.5)")
    assert "decay" in str(refused.value)


def test_booleans_and_null_are_read_as_in_yaml_too() -> None:
    one = LawChoice.parse("m:C(a=true, b=False, c=null)")
    assert one.parameters == {"a": True, "b": False, "c": None}
    assert LawChoice.parse(str(one)) == one
