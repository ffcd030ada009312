"""Mistakes in the faults of a file: each is reported with its line and its fix."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies.errors import TopologyError
from hedgerow.topologies.load import parse
from tests.topologies.test_fault_schema import HEAD


@pytest.mark.parametrize(
    ("fault", "place"),
    [
        ("5", "fault 2"),
        ("~", "fault 2"),
        ("{link: [2, 4]}", "fault 2"),
        ("{kind: dorp}", "fault 2: kind"),
        ("{kind: [1]}", "fault 2: kind"),
        ("{kind: ~}", "fault 2: kind"),
        (
            "{kind: drop, link: [2, 4], step: [1, 2]}",
            "fault 2",
        ),
        ("{kind: cut, link: [2, 4]}", "fault 2"),
        ("{kind: sensor, node: 2, ~: 1}", "fault 2"),
        ("{kind: drop}", "fault 2"),
        ("{kind: drop, from: 2}", "fault 2"),
        ("{kind: drop, from: 2, to: 4, link: [2, 4]}", "fault 2"),
        ("{kind: drop, to: 4, link: [2, 4]}", "fault 2"),
        ("{kind: drop, at: {1: [[2, 4]]}, steps: [1, 2]}", "fault 2"),
        ("{kind: cut, at: {1: [[2, 4]]}, probability: 0.5}", "fault 2"),
        ("{kind: drop, link: [2]}", "fault 2: link"),
        ("{kind: drop, link: [2, 4, 3]}", "fault 2: link"),
        ("{kind: drop, link: 24}", "fault 2: link"),
        ("{kind: drop, link: [2, 4], steps: 3}", "fault 2: steps"),
        ("{kind: drop, link: [2, 4], steps: [3]}", "fault 2: steps"),
        ("{kind: drop, link: [2, 4], steps: [3, 3]}", "fault 2: steps"),
        ("{kind: drop, link: [2, 4], steps: [4, 3]}", "fault 2: steps"),
        ("{kind: drop, link: [2, 4], steps: [-1, 3]}", "fault 2: steps: 0"),
        ("{kind: drop, link: [2, 4], steps: [1, 3.0]}", "fault 2: steps: 1"),
        ("{kind: drop, link: [2, 4], steps: [1, 9223372036854775807]}", "fault 2: steps: 1"),
        ("{kind: drop, link: [2, 4], probability: 1.5}", "fault 2: probability"),
        ("{kind: drop, link: [2, 4], probability: -1}", "fault 2: probability"),
        ("{kind: drop, link: [2, 4], probability: .nan}", "fault 2: probability"),
        ("{kind: drop, link: [2, 4], probability: yes}", "fault 2: probability"),
        ("{kind: drop, at: 5}", "fault 2: at"),
        ("{kind: drop, at: {}}", "fault 2: at"),
        ("{kind: drop, at: {x: [[2, 4]]}}", "fault 2: at: x"),
        ("{kind: drop, at: {1.5: [[2, 4]]}}", "fault 2: at: 1.5"),
        ("{kind: drop, at: {-1: [[2, 4]]}}", "fault 2: at: -1"),
        ("{kind: drop, at: {1: [2, 4]}}", "fault 2: at: 1: 0"),
        ("{kind: drop, link: [3, 4]}", "fault 2: link"),
        ("{kind: drop, link: [2, 2]}", "fault 2: link"),
        ("{kind: drop, link: [2, 9]}", "fault 2: link"),
        ("{kind: drop, from: 1, to: 3}", "fault 2: to"),
        ("{kind: drop, from: 9, to: 3}", "fault 2: from"),
        ("{kind: drop, from: 3, to: x}", "fault 2: to"),
        ("{kind: drop, at: {1: [[2, 4], [1, 4]]}}", "fault 2: at: 1: 1"),
        ("{kind: delay, link: [2, 4]}", "fault 2"),
        ("{kind: delay, link: [2, 4], by: 0}", "fault 2: by"),
        ("{kind: delay, link: [2, 4], by: 1000001}", "fault 2: by"),
        ("{kind: delay, at: {1: [[2, 4]]}, by: 1}", "fault 2"),
        ("{kind: cut, edge: [1, 3]}", "fault 2: edge"),
        ("{kind: cut, at: {1: [[1, 3]]}}", "fault 2: at: 1: 0"),
        ("{kind: partition}", "fault 2"),
        ("{kind: partition, groups: [[1, 2]]}", "fault 2: groups"),
        ("{kind: partition, groups: [[1, 2], []]}", "fault 2: groups: 1"),
        ("{kind: partition, groups: [[1, 2], [3, 2]]}", "fault 2: groups"),
        ("{kind: partition, groups: [[1], [2, 9]]}", "fault 2: groups: 1: 1"),
        ("{kind: partition, groups: [[1], [2]], cut: yes}", "fault 2: cut"),
        ("{kind: partition, groups: [[1], [2]], probability: 0.5}", "fault 2"),
        ("{kind: sensor}", "fault 2"),
        ("{kind: sensor, node: 9}", "fault 2: node"),
        ("{kind: actuator, node: 1.5}", "fault 2: node"),
        ("{kind: crash, at: 3}", "fault 2"),
        ("{kind: crash, node: 2, process: 0, at: 3}", "fault 2"),
        ("{kind: crash, node: 2}", "fault 2"),
        ("{kind: crash, node: 2, at: 3, restart_after: 0}", "fault 2: restart_after"),
        ("{kind: crash, process: 4, at: 3}", "fault 2: process"),
        ("{kind: crash, process: -1, at: 3}", "fault 2: process"),
        ("{kind: jump, node: 2, at: 3}", "fault 2"),
        ("{kind: jump, node: 2, at: 3, a: drawn}", "fault 2: a"),
        (
            "{kind: jump, node: 2, at: 3, a: 0.4}",
            "fault 2: a",
        ),
    ],
)
def test_a_mistake_is_reported_with_its_line_and_its_fix(fault: str, place: str) -> None:
    """It is the second of three faults; the others are good."""
    text = f"{HEAD}faults:\n  - {{kind: sensor, node: 1}}\n  - {fault}\n  - {{kind: sensor, node: 1}}\n"
    with pytest.raises(TopologyError) as caught:
        parse(text.encode(), "star.yaml", Path())
    found = caught.value.problems
    assert place in [problem.place for problem in found]
    assert all(problem.line == 9 and problem.place.startswith("fault 2") for problem in found)


def test_all_mistakes_are_reported_together() -> None:
    """Mistakes of the schema hide no mistakes of the rules, and a line within a fault is named."""
    text = """\
name: star
b: 0.1
steps: 30
processes: 5
defaults: {candidates: [0.3, 0.6]}
nodes: [1, 2, 3, 4]
edges: [[1, 2], [3, 2], [2, 4]]
history: 0
backfill: maybe
faults:
  - {kind: drop, link: [1, 3]}
  - kind: drop
    at:
      10: [[2, 4]]
      11:
        - [2, 4]
        - [1, 4]
  - {kind: dorp}
  - kind: partition
    groups:
      - [1, 2]
      - [3,
         9]
    cut: 1
  - {kind: sensor, node: 7}
"""
    with pytest.raises(TopologyError) as caught:
        parse(text.encode(), "star.yaml", Path())
    assert [(p.line, p.column, p.place) for p in caught.value.problems] == [
        (4, 12, "processes"),
        (8, 10, "history"),
        (9, 11, "backfill"),
        (11, 24, "fault 1: link"),
        (17, 11, "fault 2: at: 11: 1"),
        (18, 12, "fault 3: kind"),
        (24, 10, "fault 4: cut"),
        (25, 26, "fault 5: node"),
    ]
    lines = str(caught.value).splitlines()
    assert [line.split(": ")[0] for line in lines] == [f"star.yaml:{p.line}:{p.column}" for p in caught.value.problems]


def test_a_fault_is_not_blamed_for_an_edge_that_was_refused() -> None:
    """Only the edge is wrong; the link that it was to be is in order."""
    text = HEAD.replace("[3, 2]", "[3, 2, 1]") + "faults: [{kind: drop, link: [2, 3]}, {kind: sensor, node: 9}]\n"
    with pytest.raises(TopologyError) as caught:
        parse(text.encode(), "star.yaml", Path())
    assert [problem.place for problem in caught.value.problems] == ["edge 2", "fault 2: node"]


def test_a_node_without_neighbours_has_no_link_to_drop() -> None:
    text = "{name: n, b: 0.1, steps: 3, nodes: [1, 2], faults: [{kind: cut, edge: [1, 2]}]}"
    with pytest.raises(TopologyError) as refused:
        parse(text.encode(), "n.yaml", Path())
    assert [problem.place for problem in refused.value.problems] == ["fault 1: edge"]
