"""A defect of ours in a test of a user: one line at the line of the test, and a file with the traceback."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

DEFECTS = """
def fail(*_):
    raise LookupError("planted")

def test_of_a_file(network, monkeypatch):
    monkeypatch.setattr("hedgerow.topologies.named.parse", fail)
    network("paper7")

def test_of_a_run(network, monkeypatch):
    monkeypatch.setattr("hedgerow.orchestrator.testing.scenario.reference.run", fail)
    network("paper7").run()

def test_of_a_comparison(network, monkeypatch):
    monkeypatch.setattr("hedgerow.orchestrator.testing.explanation.explain", fail)
    assert network("paper7").run(steps=2) == network("paper7").run(steps=3)

def test_of_a_report(network, monkeypatch):
    network("paper7").run(steps=2)
    monkeypatch.setattr("hedgerow.orchestrator.runs.run.Run.describe", fail)
    assert 0

def test_after_the_defects(network):
    assert network("paper7").run(steps=2).steps == 2
"""
LINE = re.compile(r"defect of hedgerow: LookupError: planted; the traceback is in (\S+)")


def test_a_defect_does_not_end_the_session(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(pytester.path))
    pytester.makepyfile(DEFECTS)
    done = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    done.assert_outcomes(passed=1, failed=4)
    printed = done.stdout.str()
    files = {found[1] for found in LINE.finditer(printed)}
    assert len(files) == 4
    for file in files:
        assert "LookupError: planted" in Path(file).read_text()
    assert "reference.py" not in printed
    assert "INTERNALERROR" not in printed
