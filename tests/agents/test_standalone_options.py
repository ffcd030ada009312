"""Options and files of separate processes: a wrong one is refused at once, in words that name it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.tools.processes import run_here
from tests.tools.standalone import bundle, start

__all__ = ["start"]


@pytest.mark.parametrize(("form", "protocol"), [((), "tcp"), (("--secure",), "tls")], ids=["open", "secure"])
def test_a_bundle_uses_one_port_for_operator_and_agents(here: Path, form: tuple[str, ...], protocol: str) -> None:
    bundle(f"{protocol}/localhost:8123", *form)
    printed = Path("lab/README.md").read_text()
    assert printed.count(f"--listen {protocol}/0.0.0.0:8123") == 2
    assert "7447" not in printed


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (("up", "paper7", "--router", "bench"), "--router bench"),
        (("up", "paper7", "--external", "3", "--listen", "bench:7447"), "--listen bench:7447"),
        (("bundle", "paper7", "--router", "bench", "--out", "lab"), "--router bench"),
    ],
)
def test_an_invalid_endpoint_is_refused_at_once(here: Path, arguments: tuple[str, ...], option: str) -> None:
    done = run_here(*arguments)
    assert done.returncode == 2
    assert done.stderr == f"error: {option}: is no endpoint; write tcp/HOST:PORT, or tls/HOST:PORT\n"
    assert [*here.glob("[!.]*")] == []


def test_a_certificate_names_no_address_in_brackets(here: Path) -> None:
    """Zenoh would try for ever."""
    done = run_here("keys", "paper7", "--out", "lab", "--router", "tls/[::1]:7447")
    assert done.returncode == 2
    assert done.stderr.startswith("error: --router tls/[::1]:7447: ")
    assert [*here.glob("[!.]*")] == []


@pytest.mark.parametrize(
    "words",
    [
        "up paper7 --router tcp/bench:0",
        "up paper7 --external 3 --listen tcp/0.0.0.0:65536",
        "bundle paper7 --out lab --router tcp/bench",
        "keys paper7 --out lab --router tls/bench:99999",
    ],
)
def test_a_port_is_from_1_to_65535(here: Path, words: str) -> None:
    done = run_here(*words.split())
    assert done.returncode == 2
    assert done.stderr == f"error: {' '.join(words.split()[-2:])}: write a port from 1 to 65535 after the host\n"
    assert [*here.glob("[!.]*")] == []


@pytest.mark.parametrize("namespace", ["", "a//b", "a/**", "a#b"])
@pytest.mark.parametrize("command", ["up", "bundle --out lab", "compose"])
def test_a_namespace_is_a_key_without_wildcards(here: Path, command: str, namespace: str) -> None:
    done = run_here(*command.split(), "paper7", "--namespace", namespace)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: --namespace {namespace}: is no key of Zenoh's; ")
    assert [*here.glob("[!.]*")] == []


@pytest.mark.parametrize(
    ("module", "option", "number"),
    [
        *(("agents", "--wait", number) for number in ("nan", "inf", "-1", "0")),
        ("plant", "--wait", "nan"),
        ("plant", "--deadline", "nan"),
        *(("plant", "--rate", number) for number in ("nan", "-5")),
        *(("up", option, "nan") for option in ("--rate", "--deadline", "--wait")),
        ("up", "--wait", "0"),
        ("compose", "--rate", "nan"),
    ],
)
def test_seconds_and_rates_are_numbers_that_can_be_waited_for(
    here: Path, start: Any, module: str, option: str, number: str
) -> None:
    if module in ("up", "compose"):
        done = run_here(module, "paper7", option, number)
        code, printed = done.returncode, done.stderr
    else:
        code, printed = start(module, option, number).wait()
    assert code == 2
    assert option in printed
    assert number in printed
    assert [*here.glob("[!.]*")] == []


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--external", "9"), "--external 9: "),
        (("--external", "3"), "--listen tcp/0.0.0.0:7447"),
        (("--external", "plant"), "--external plant: "),
        (("--listen", "tcp/0.0.0.0:7447"), "--external"),
    ],
)
def test_impossible_options_are_refused_at_once(here: Path, arguments: tuple[str, ...], named: str) -> None:
    done = run_here("up", "paper7", *arguments)
    assert done.returncode == 2
    assert named in done.stderr


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "lab.toml: "),
        ("a = ", "lab.toml: "),
        ('process = "agent-3"\nnamespace = "h"\nrouter = "tcp/x:1"\nnetwork = "0"\n', "config of agent-3: "),
        ('process = "plant"\nnamespace = "h"\nrouter = "tcp/x:1"\nnetwork = "0"\n', "`hedgerow-plant`"),
        (None, "`orchestrator bundle`"),
    ],
)
def test_a_wrong_file_is_a_mistake_and_no_traceback(here: Path, start: Any, text: str | None, named: str) -> None:
    if text is not None:
        Path("lab.toml").write_text(text)
    for check in ((), ("--check",)):
        code, log = start("agents", "--config", "lab.toml", *check).wait()
        assert code == 2, log
        assert named in log
        assert "Traceback" not in log
