"""A user's text in a Compose file stays one word of YAML and of the shell in it."""

import os
import shlex
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.deploy.compose import _path, to_compose
from hedgerow.orchestrator.deploy.containers import containers
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.session import check_namespace
from tests.tools.examples import examples

TOPOLOGY = resolve(load("paper7"), Path())
SHARDS = layout(TOPOLOGY, 7)
PIECES = ["a", "ü", ": ", "\n", "\x1b", *"/ ;&|'`({},~!-$#", '"', "\\"]


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.sampled_from(PIECES), min_size=1).map("".join))
def test_a_namespace_is_one_word_of_the_observers_command(namespace: str) -> None:
    try:
        check_namespace(namespace)
    except UserError:
        return
    one = containers(TOPOLOGY, SHARDS, namespace, 0.0, 10**6)
    service = yaml.safe_load(to_compose(one, Path()))["services"]["orchestrator"]
    shell, option, script = service["command"]
    assert (shell, option) == ("/bin/sh", "-c")
    words = shlex.split(script.replace("$$", "$").partition(" && exec ")[2])
    assert words == one.observer("runs/topology.yaml")


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_path_is_one_value(path: str) -> None:
    assert yaml.safe_load(f"{{file: {_path(path)}}}")["file"].replace("$$", "$") == path


def test_a_path_that_is_no_text_is_refused() -> None:
    with pytest.raises(UserError):
        _path(os.fsdecode(b"caf\xe9"))


@pytest.mark.parametrize("registry", ["x: y", "a b", "a/$(b)", "a\nb", "a#b", "-a", "a/B", "{a}", "http://a/b"])
def test_a_registry_is_a_prefix_of_an_image(registry: str) -> None:
    with pytest.raises(UserError) as refused:
        containers(TOPOLOGY, SHARDS, "a", 0.0, 10**6, registry=registry)
    assert refused.value.code == Code.OPTION


@pytest.mark.parametrize("registry", ["", "registry.example/team", "localhost:5000", "ghcr.io/a-b/c.d_e/"])
def test_a_registry(registry: str) -> None:
    one = containers(TOPOLOGY, SHARDS, "a", 0.0, 10**6, registry=registry)
    assert yaml.safe_load(to_compose(one, Path()))["services"]["orchestrator"]["image"] == one.image("hedgerow")


@pytest.mark.parametrize("namespace", ["a\nb", "a\x1b[2J", "a\u202eb", "a\udc9bb"])
def test_a_namespace_without_control_characters(namespace: str) -> None:
    with pytest.raises(UserError):
        check_namespace(namespace)
