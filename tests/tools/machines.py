"""Several machines on one switch: network namespaces, each with an address, a name and a cable. They need root."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROUTER = """
import signal, sys
from hedgerow.wire.session import open_router
with open_router(sys.argv[1]):
    print("open", flush=True)
    signal.pause()
"""


SECURE_ROUTER = """
import signal, sys, zenoh
with zenoh.open(zenoh.Config.from_file(sys.argv[1].removeprefix("--config="))):
    print("open", flush=True)
    signal.pause()
"""
"""The router runs as in its image: with a file, in the folder of its keys."""


def command(*words: str) -> None:
    """Run a command of the system; its complaint is the reason to skip."""
    if shutil.which(words[0]) is None:
        pytest.skip(f"there is no {words[0]} here")
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"{' '.join(words)}: {done.stderr.strip()}")


class Machines:
    """Machines by name, each with a cable to a switch; every one knows the others' names."""

    def __init__(self, names: Sequence[str]) -> None:
        self._switch = f"hw{os.getpid()}"
        self._spaces = {name: f"{self._switch}-{name}" for name in names}
        self.address = {name: f"10.78.0.{number}" for number, name in enumerate(names, 1)}

    def build(self, rto_min: str | None) -> None:
        """Make them; skip the test where that cannot be. `rto_min` is how long TCP waits for an answer at first."""
        if os.geteuid() != 0:
            pytest.skip("network namespaces need root")
        command("ip", "netns", "add", self._switch)
        command("ip", "-n", self._switch, "link", "add", "switch", "type", "bridge")
        command("ip", "-n", self._switch, "link", "set", "switch", "up")
        hosts = "127.0.0.1 localhost\n" + "".join(f"{ip} {name}\n" for name, ip in self.address.items())
        for number, (name, space) in enumerate(self._spaces.items(), 1):
            command("ip", "netns", "add", space)
            # `ip netns exec` mounts this file over /etc/hosts.
            folder = Path("/etc/netns") / space
            folder.mkdir(parents=True)
            (folder / "hosts").write_text(hosts)
            port = f"port{number}"
            command("ip", "link", "add", port, "netns", self._switch, "type", "veth", "peer", "eth0", "netns", space)
            command("ip", "-n", self._switch, "link", "set", port, "master", "switch", "up")
            command("ip", "-n", space, "addr", "add", f"{self.address[name]}/24", "dev", "eth0")
            command("ip", "-n", space, "link", "set", "lo", "up")
            command("ip", "-n", space, "link", "set", "eth0", "up")
            if rto_min is not None:
                route = ("10.78.0.0/24", "dev", "eth0", "src", self.address[name], "rto_min", rto_min)
                command("ip", "-n", space, "route", "change", *route)

    def on(self, name: str) -> tuple[str, ...]:
        """Return the prefix of a command on that machine."""
        return ("ip", "netns", "exec", self._spaces[name])

    def cable(self, name: str, state: str) -> None:
        """Disconnect a machine's cable, `down`, or reconnect it, `up`."""
        number = list(self._spaces).index(name) + 1
        command("ip", "-n", self._switch, "link", "set", f"port{number}", state)

    def tear_down(self) -> None:
        """Remove everything."""
        for space in (*self._spaces.values(), self._switch):
            with contextlib.suppress(FileNotFoundError):
                subprocess.run(("ip", "netns", "del", space), capture_output=True, check=False)
            shutil.rmtree(Path("/etc/netns") / space, ignore_errors=True)


@contextlib.contextmanager
def machines(*names: str, rto_min: str | None = "10ms") -> Iterator[Machines]:
    """Provide the machines with these names, while the block lasts.

    TCP waits 200 ms before it repeats a packet, and twice as long each time; on a cable of a few microseconds 10 are
    plenty, unless `rto_min` is None.
    """
    lab = Machines(names)
    try:
        lab.build(rto_min)
        yield lab
    finally:
        lab.tear_down()


class Program:
    """A command that runs on one of them, and logs to a file."""

    def __init__(
        self, inside: Sequence[str], words: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.log = folder / "log"
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [*inside, *words],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **(environment or {})},
                start_new_session=True,
            )

    def end(self) -> None:
        """End it if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()


def scripts(folder: Path) -> Path:
    """Provide the commands of an installation, as in pyproject.toml, in a folder for the path."""
    folder.mkdir()
    names = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    for name, where in names.items():
        module, function = where.split(":")
        path = folder / name
        path.write_text(f"#!{sys.executable} -P\nfrom {module} import {function}\n{function}()\n")
        path.chmod(0o755)
    return folder
