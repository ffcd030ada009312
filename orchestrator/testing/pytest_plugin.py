"""The pytest plugin: the fixture `network`, and failure messages with the lost messages (docs/testing.md).

Nothing heavy is imported before a test asks for the fixture.
"""

from __future__ import annotations

import sys
from collections.abc import Generator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hedgerow.orchestrator.testing import Networks, Run

_RESULTS = pytest.StashKey[list["Run"]]()
"""The runs of the current test."""


@pytest.fixture(scope="session")
def network(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Networks:
    """Return the maker of networks: `network("paper7").drop((2, 4), steps=range(10, 20)).run()`; see
    orchestrator.testing.
    """
    from hedgerow.orchestrator.launch import fault_verbs, live, running  # noqa: PLC0415
    from hedgerow.orchestrator.runs import run  # noqa: PLC0415
    from hedgerow.orchestrator.testing import Networks, scenario  # noqa: PLC0415
    from hedgerow.wire import crash  # noqa: PLC0415

    for ours in (fault_verbs, live, run, running, scenario, crash):
        vars(ours)["__tracebackhide__"] = _is_one_line
    results = request.config.stash[_RESULTS]
    return Networks(tmp_path_factory.mktemp, results.append)


def _is_one_line(mistake: pytest.ExceptionInfo[BaseException]) -> bool:
    """Return True if pytest must show the line of the test alone: for a mistake in a test, a run that is not valid, and
    a defect of ours.
    """
    from hedgerow.topologies.errors import Code, HedgerowError, UserError  # noqa: PLC0415

    error = mistake.value
    return isinstance(error, UserError) or (
        isinstance(error, HedgerowError) and error.code in {Code.CRASH, Code.VERDICT}
    )


def pytest_configure(config: pytest.Config) -> None:
    """Provide a place for the runs of a test."""
    config.stash[_RESULTS] = []


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Forget the runs of the previous test."""
    item.config.stash[_RESULTS].clear()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the runs of a failed test to its report: their problems, and their folders."""
    report = yield
    if report.failed and (results := item.config.stash[_RESULTS]):
        report.sections.append(("networks", "\n".join(_described(run) for run in results[-_SHOWN:])))
    return report


_SHOWN = 4


def _described(run: Run) -> str:
    """Return the description of a run; a defect of ours must not end the session of pytest."""
    try:
        return run.describe()
    except Exception as error:
        return _defect(error)


def _defect(error: Exception) -> str:
    from hedgerow.wire import crash  # noqa: PLC0415

    return crash.report(error)


def pytest_assertrepr_compare(left: object, right: object, op: str) -> list[str] | None:
    """Explain why two runs, or their estimates, are not equal."""
    if op != "==" or "hedgerow.orchestrator.runs.run" not in sys.modules:
        return None
    from hedgerow.orchestrator.testing.explanation import explain  # noqa: PLC0415

    try:
        return explain(left, right)
    except Exception as error:
        return [f"{type(left).__name__} == {type(right).__name__}", _defect(error)]
