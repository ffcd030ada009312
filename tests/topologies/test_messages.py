"""Messages show the user's text and its place, a fix that works, and a bounded number of lines."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from hedgerow.topologies import source
from hedgerow.topologies.errors import Code, Problem, Problems, TopologyError
from hedgerow.topologies.load import load, parse
from tests.tools.processes import orchestrator

HEAD = "name: n\nb: 0.1\nsteps: 3\nnodes: [1, 2]\n"


def refused(text: str | bytes, *overrides: str) -> TopologyError:
    text = text.encode() if isinstance(text, str) else text
    with pytest.raises(TopologyError) as caught:
        parse(text, "bad.yaml", Path(), overrides)
    return caught.value


@pytest.mark.parametrize(
    ("old", "new", "column", "written", "cure"),
    [
        ("name: n", "name: 2026", 7, "2026", '"2026"'),
        ("name: n", "name: 1e3", 7, "1e3", '"1e3"'),
        ("name: n", "name: 2.50", 7, "2.50", '"2.50"'),
        ("name: n", "name: true", 7, "true", '"true"'),
        ("b: 0.1", "b: [0.1]", 4, "[0.1]", "without brackets"),
        ("b: 0.1", "b: {value: 0.1}", 4, "0.1", "single number"),
        ("b: 0.1", "b: 0,1", 4, "0,1", "0.1"),
        ("b: 0.1", "b: '0.1'", 4, "0.1", "without quotes"),
        ("b: 0.1", "b: 1.0e+200", 4, "1.0e+200", "smaller"),
        ("b: 0.1", "b:   .5e5x", 6, ".5e5x", "such as"),
        ("steps: 3", "steps: 3.0", 8, "3.0", "write 3"),
        ("steps: 3", "steps: 3.5", 8, "3.5", "whole number"),
        ("steps: 3", "steps: [3]", 8, "[3]", "without brackets"),
        ("steps: 3", "steps: 1_000", 8, "1_000", "1000"),
        ("steps: 3", "steps: '30'", 8, "30", "without quotes"),
    ],
)
def test_a_value_is_shown_as_it_was_written(old: str, new: str, column: int, written: str, cure: str) -> None:
    error = refused(HEAD.replace(old, new))
    (problem,) = error.problems
    assert (problem.line, problem.column) == (HEAD[: HEAD.index(old)].count("\n") + 1, column)
    assert written in problem.what
    assert cure in problem.cure
    assert str(error).startswith(f"bad.yaml:{problem.line}:{column}: ")


@pytest.mark.parametrize("steps", ["1e3", "1E3", "1e+3", "10e2"])
def test_a_whole_number_may_have_an_exponent(steps: str) -> None:
    assert parse(HEAD.replace("steps: 3", f"steps: {steps}").encode(), "n.yaml", Path()).steps == 1000


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "edges: [[1, 2]]\nfaults: [{kind:drop, link: [1, 2]}]\n",
        HEAD + "edges: [[1, 2]]\nfaults:\n  - kind:drop\n",
        HEAD + "faults:\n  - {kind: crash, node: 1, at:1}\n",
        HEAD + "defaults: {x0:1}\n",
        "name:n\nb:0.1\n",
        "name: n\nb:0.1\nsteps: 3\n",
    ],
)
def test_a_colon_without_a_space_is_named(text: str) -> None:
    (problem,) = refused(text).problems
    assert "a space after" in problem.cure or "write `" in problem.cure


@pytest.mark.parametrize(
    ("tag", "cure"),
    [
        ("!!python/tuple [1, 2]", "safe_dump"),
        ("!!python/object/apply:numpy.core.multiarray.scalar [1]", "float(x)"),
        ("!!float 1", "plain value"),
    ],
)
def test_a_tag_is_reported_with_a_form_without_tags(tag: str, cure: str) -> None:
    (problem,) = refused(f"{HEAD}edges: {tag}\n").problems
    assert (problem.code, problem.line, problem.column) == (Code.FILE_FORMAT, 5, 8)
    assert cure in problem.cure


# The command line.


@pytest.mark.parametrize(
    "override",
    ["b=-1", "b=0.5", "nodes.1.a=2", "edges=[[1, 9]]", "bb=1", "b=[1", "nodes.3={x0: many}", "b={x: 1, x: 2}", "law=x"],
)
def test_a_mistake_of_an_option_is_blamed_on_the_option(override: str) -> None:
    """This holds even if it shows at a value of the file that is valid by itself."""
    with pytest.raises(TopologyError) as caught:
        load("paper7", [override])
    assert all(problem.origin == f"--set {override}" for problem in caught.value.problems)
    assert all(line.startswith(f"--set {override}: ") for line in str(caught.value).splitlines())
    assert "paper7" not in caught.value.summary


def test_a_mistake_of_the_file_stays_one_beside_an_option() -> None:
    error = refused(HEAD + "edges: [[1, 9]]\n", "b=-1")
    assert {problem.origin for problem in error.problems} == {"", "--set b=-1"}


def test_a_named_option_is_reported_by_its_name() -> None:
    refusal_of = orchestrator("check", "paper7", "--steps", "0")
    assert refusal_of.returncode == 2
    assert refusal_of.stderr.startswith("--steps 0: steps: 0 ")


@pytest.mark.parametrize(
    ("word", "meant"), [("help", "--help"), ("run", "'up'"), ("list", "'ps'"), ("statsu", "status")]
)
def test_a_word_that_is_no_command_leads_to_the_one_that_was_meant(word: str, meant: str) -> None:
    refusal_of = orchestrator(word)
    assert refusal_of.returncode == 2
    assert meant in refusal_of.stderr
    assert "heal" not in refusal_of.stderr


# Many mistakes.


def test_equal_mistakes_share_a_line() -> None:
    edges = "".join(f"- [1, {k}]\n" for k in range(3, 122))
    error = refused(f"{HEAD}edges:\n{edges}- [2, 2]\n".replace("b: 0.1", "b: 0.01"))
    assert len(error.problems) == error.count == 120
    lines = str(error).splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("bad.yaml:6:3: 119 edges: ")


def test_at_most_20_lines_are_shown_and_the_last_counts_the_others() -> None:
    problems = [Problem(k + 1, "", f"{'x' * (k + 1)} is wrong") for k in range(50)]
    lines = str(TopologyError("bad.yaml", problems)).splitlines()
    assert len(lines) == 20
    assert "31" in lines[-1]
    assert len(str(TopologyError("bad.yaml", problems[:20])).splitlines()) == 20


def test_a_million_mistakes_are_counted_in_bounded_memory() -> None:
    found = Problems(Problem(k, f"edge {k}", f"[1, {k}] leads to {k}, which is no node") for k in range(100_000))
    assert len(found) == 100_000
    assert len(list(found)) == Problems.KEPT
    assert len(found.lines("bad.yaml")) == 1
    other = Problems(Problem(k, "", "x" * (k + 1)) for k in range(2 * Problems.KEPT))
    assert len(other) == 2 * Problems.KEPT
    assert len(list(other)) == Problems.KEPT
    assert len(other.lines("bad.yaml")) == 20


BIG = """
import resource
import sys
from pathlib import Path
from hedgerow.topologies.errors import TopologyError
from hedgerow.topologies.load import parse
resource.setrlimit(resource.RLIMIT_CPU, (15, 15))  # s, also on a busy machine
head = "name: n\\nb: 0.01\\nsteps: 3\\nnodes: [1, 2]\\n"
rows = {"edges": "- [1, {}5]\\n", "faults": "- {{kind: sensr, node: {}}}\\n", "pairs": "- [a b, {}]\\n"}[sys.argv[1]]
key = "faults" if sys.argv[1] == "faults" else "edges"
text = head + key + ":\\n" + "".join(rows.format(k) for k in range(20_000))
try:
    parse(text.encode(), "bad.yaml", Path())
except TopologyError as error:
    assert error.count >= 20_000, error.count
    assert len(str(error)) < 5_000, len(str(error))
    peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    assert int(peak.split()[1]) < 200_000, peak  # kB
    sys.exit(7)
"""


@pytest.mark.parametrize("kind", ["edges", "faults", "pairs"])
def test_very_many_mistakes_take_bounded_time_and_memory(kind: str) -> None:
    """Quadratic work would take far more than the limit of CPU time, and one line for each mistake 2 MB."""
    done = subprocess.run([sys.executable, "-c", BIG, kind], timeout=180, check=False)
    assert done.returncode == 7


# Depth.


@pytest.mark.parametrize("text", [b"[" * 100_000, b"{a: " * 5000, b"- " * 500, b"[" * 40 + b"]" * 40])
def test_depth_is_refused_equally_for_any_bound_of_the_parser(text: bytes) -> None:
    (problem,) = refused(text).problems
    assert (problem.code, problem.line) == (Code.FILE_FORMAT, 1)
    assert str(source.MAX_DEPTH) in problem.what


@pytest.mark.parametrize(
    "raised",
    [
        RecursionError("maximum recursion depth exceeded"),
        yaml.YAMLError("nesting too deep"),
        yaml.scanner.ScannerError("while increasing flow level", None, "exceeded maximum nesting depth", None),
    ],
)
def test_a_parser_with_another_bound_gives_the_same_mistake(raised: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def bounded(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr(yaml, "parse", bounded)
    (problem,) = refused(HEAD).problems
    assert problem.code == Code.FILE_FORMAT
    assert str(source.MAX_DEPTH) in problem.what


def test_a_wrong_kind_is_one_mistake() -> None:
    """The keys of that kind are no mistakes as well."""
    error = refused(HEAD + "edges: [[1, 2]]\ndisturbance: {kind: sinusoid, amplitude: 1, omega: 2}\n")
    assert [problem.place for problem in error.problems if "disturbance" in str(problem.place)] == ["disturbance: kind"]
