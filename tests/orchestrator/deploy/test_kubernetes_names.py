"""Kubernetes accepts the names and labels of the manifests for any names of a network and its nodes."""

import re
from pathlib import Path
from typing import Any

import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.deploy.containers import containers
from hedgerow.orchestrator.deploy.kubernetes import label, to_kubernetes
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.topologies.load import parse
from hedgerow.topologies.resolve import resolve

RFC_1123 = re.compile(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?")
NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}", fullmatch=True) | st.sampled_from(
    ["pilot_", "a" * 58, "a" * 64, "A" * 64, "_", "__", "default", "kube-system", "KUBE_system", "a.b", "a-b", "a_b"]
)


def is_label(text: Any) -> bool:
    return isinstance(text, str) and len(text) <= 63 and bool(RFC_1123.fullmatch(text))


@given(st.text(st.characters()) | NAMES)
def test_any_text_becomes_a_label(text: str) -> None:
    name = label(text)
    assert is_label(name)
    assert label(name) == name
    assert name != "default"
    assert not name.startswith("kube-")


@given(st.lists(st.text(st.characters()) | NAMES, unique=True))
def test_different_texts_become_different_labels(texts: list[str]) -> None:
    assert len({label(text) for text in texts}) == len(texts)


def manifests(name: str, ids: list[str]) -> list[dict[str, Any]]:
    text = yaml.safe_dump({"name": name, "b": 0.1, "steps": 3, "nodes": ids, "edges": [ids]})
    topology = resolve(parse(text.encode(), "net.yaml", Path()), Path())
    shards = layout(topology, 2)
    one = containers(topology, shards, "hedgerow/net", 0.0, 10**6)
    return list(yaml.safe_load_all(to_kubernetes(one)))


@settings(max_examples=25, deadline=None)
@given(NAMES, st.lists(NAMES.filter(lambda name: not name.isdecimal()), min_size=2, max_size=2, unique=True))
def test_every_name_of_the_manifests_is_valid_and_unique(name: str, ids: list[str]) -> None:
    documents = manifests(name, ids)
    metadata = [one["metadata"] for one in documents]
    assert all(is_label(one["name"]) for one in metadata)
    assert all(is_label(value) for one in metadata for value in one["labels"].values())
    assert len({(one["kind"], one["metadata"]["name"]) for one in documents}) == len(documents)
    for job in (one for one in documents if one["kind"] == "Job"):
        spec = job["spec"]["template"]["spec"]
        assert all(is_label(one["name"]) for one in (*spec["containers"], *spec["volumes"]))
        config = next(one for one in spec["volumes"] if one["name"] == "config")
        assert ("ConfigMap", config["configMap"]["name"]) in {
            (one["kind"], one["metadata"]["name"]) for one in documents
        }


def test_a_changed_name_is_kept_in_an_annotation() -> None:
    documents = manifests("pilot_", ["A" * 58, "b" * 58])
    jobs = [one["metadata"] for one in documents if one["kind"] == "Job"]
    assert all(one["annotations"]["hedgerow/network"] == "pilot_" for one in jobs)
    noted = [one["annotations"].get("hedgerow/process", "") for one in jobs]
    assert any("A" * 58 in one for one in noted)
    assert any("b" * 58 in one for one in noted)
