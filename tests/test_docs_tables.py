"""The tables of docs/errors.md, docs/faults.md and docs/theory.md agree with the code."""

from __future__ import annotations

import json
import re

import yaml

from hedgerow.orchestrator.metrics.fault_accounts import Account
from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.orchestrator.views.rerun.panels import lines, totals
from hedgerow.topologies.errors import Code
from hedgerow.topologies.faults import KINDS
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.documents import table
from tests.tools.networks import observe, simulate


def test_every_error_code_is_in_errors_md() -> None:
    """Each code has a row, and there are no further rows."""
    assert [row["code"] for row in table("errors.md", "Codes")] == [*Code]


def test_every_kind_of_fault_is_in_faults_md() -> None:
    """Each kind has a row, the fault in it is one of that kind, and an account has the fields that are explained."""
    rows = table("faults.md", "Fault kinds")
    assert [row["kind"] for row in rows] == [*KINDS]
    for row in rows:
        fault = yaml.safe_load(row["in a file"])
        written = KINDS[row["kind"]].model_validate(fault).written()
        assert json.loads(json.dumps(written)) == fault
    counted = [name for name in Account._fields if name != "visible"]
    fields = {row["field"] for row in table("faults.md", "Faults that prove they fired")}
    assert fields == {*counted, "beyond"}


def test_every_metric_is_in_the_place_that_theory_md_gives() -> None:
    """Fields, columns and entities exist; the page has every metric of a verdict and every entity of Rerun."""
    topology = resolve(load("paper7"))
    observer, batch = observe(topology, simulate(topology))
    rows = table("theory.md", "Metrics")

    def named(column: str) -> set[str]:
        return {name for row in rows for name in re.findall(r"\w+", row[column].replace("—", ""))}

    assert all(hasattr(batch, name) for name in named("Batch"))
    assert named("verdict.json") == observer.summary().keys()
    shown = {quantity.entity for quantity in [*lines(topology), *totals(topology, observer)]}
    assert named("Rerun") == shown
    fields = {*Batch.__dataclass_fields__, "cost_regret", "ratio", "gain"}
    assert named("Batch") == fields - {"t", "a", "edge_open", "link_up"}
