"""The page of a report: the numbers of the verdict, names as text, faults, and the file to run again."""

from __future__ import annotations

import base64
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.report.reading import METRICS, number
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.load import parse
from hedgerow.topologies.resolve import resolve
from tests.tools.figures import DRAWN, Page, page, ran


def test_the_page_has_the_numbers_of_the_verdict(paper: Run, written: dict[str, Path]) -> None:
    """The page has a table of all metrics and checks, and the complete verdict.json."""
    shown = page(written["report.html"])
    for name, words in METRICS.items():
        value = paper.verdict.content["metrics"][name]
        assert shown.row(words)[0] == (f"{value} of 7" if name == "nodes_right" else number(value))
    for name, check in paper.verdict.content["checks"].items():
        assert shown.row(name)[:2] == ["holds", check["claim"]]
    assert METRICS.keys() == paper.verdict.content["metrics"].keys()
    (verdict,) = (text for text in shown.text if text.startswith('{\n  "verdict"'))
    assert json.loads(verdict) == paper.verdict.content
    text = " ".join(shown.text)
    for sentence in (
        "Verdict: valid.",
        "6 of 7 estimates are the truth after 30 steps",
        "gain with γ* = 2.97",
        "numpy",
    ):
        assert sentence in text


def test_the_page_asks_for_nothing(written: dict[str, Path]) -> None:
    """Every picture is in it, and neither the page nor a picture in it fetches anything."""
    content = written["report.html"].read_text(encoding="utf-8")
    shown = Page(content)
    assert content.startswith("<!DOCTYPE html>")
    assert all(link.startswith("data:") for link in shown.links)
    assert not re.search(r"@import|url\(", content)
    assert not {"script", "link", "iframe", "object", "base"} & {tag for tag, _ in shown.elements}
    pictures = [base64.b64decode(link.partition("base64,")[2]) for link in shown.links if "svg" in link]
    assert len(pictures) == len(DRAWN)
    for svg in pictures:
        assert svg.startswith(b"<?xml")
        assert not re.search(rb"href=\"(?!#|data:)|<script|url\((?!#)", svg)
    assert all(own.get("alt") for tag, own in shown.elements if tag == "img")
    assert written["report.html"].stat().st_size < 2**20


def test_the_file_in_the_page_repeats_the_run(paper: Run, written: dict[str, Path], folder: Path) -> None:
    """The download in the page is the run's own topology, and its run is the same bit for bit."""
    (link,) = (link for link in page(written["report.html"]).links if "yaml" in link)
    text = base64.b64decode(link.partition("base64,")[2])
    again = ran(resolve(parse(text, "paper.yaml", folder)), folder / "again")
    for table in ("telemetry.parquet", "edges.parquet"):
        assert (again.folder / table).read_bytes() == (paper.folder / table).read_bytes()


def test_the_repetition_of_a_stopped_run_stops_at_the_same_step(paper: Run, folder: Path) -> None:
    longer = paper.topology.model_copy(update={"steps": 1000})
    path, *_ = report([replace(paper, topology=longer)], folder / "stopped-report", "gain", formats=["svg"])
    assert "orchestrator simulate paper.yaml --steps 30\n" in "".join(page(path).text)


def test_names_are_text(paper: Run, folder: Path) -> None:
    """A run with the name of a script does not run it, and its name is not mathematics."""
    name = """<script>alert("$x$")&'"""
    shutil.copytree(paper.folder, folder / name)
    run = load_run(folder / name)
    verdict = run.folder / "verdict.json"
    verdict.write_text(verdict.read_text().replace('"valid"', '"INVALID"').replace("[]", '["</pre><script>"]', 1))
    path, *_ = report([load_run(folder / name), paper], folder / "escaped", "gain", formats=["svg"])
    shown = page(path)
    assert "script" not in {tag for tag, _ in shown.elements}
    assert f"A: {name}. " in shown.text
    assert "Verdict: INVALID (</pre><script>)." in shown.text
    assert "orchestrator report '<script>alert(\"$x$\")&'\"'\"'' paper" in shown.text


def test_faults_and_their_effects(faulty: Run, folder: Path) -> None:
    """Each fault has its account, and the part of D from its steps."""
    path, *_ = report([faulty], folder / "faulty-report", "faults", formats=["svg"])
    shown = page(path)
    D = faulty.regret_sum
    for fault, (start, stop) in zip(faulty.verdict.content["faults"], ((0, 12), (22, 32), (42, 52)), strict=True):
        counts = [str(fault[name]) for name in ("scheduled", "fired", "masked", "seen", "beyond")]
        assert shown.row(fault["what"]) == [*counts, f"{D[stop] - D[start]:.4g}"]


def test_a_run_without_a_verdict_is_reported_so_far(paper: Run, folder: Path) -> None:
    """`up` was killed, or still runs: the numbers are computed again, and the page does not claim validity."""
    shutil.copytree(paper.folder, folder / "killed", ignore=shutil.ignore_patterns("verdict.json"))
    path, *_ = report([load_run(folder / "killed")], folder / "killed-report", "4", formats=["svg"])
    shown = page(path)
    assert "Verdict: none yet." in shown.text
    assert shown.row(METRICS["regret"]) == [number(paper.verdict.content["metrics"]["regret"])]
