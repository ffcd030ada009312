"""The choice of `--viewer`: the Rerun viewer that shows a run live, and its start.

    native    a window, which stays open after the run
    web       a page, served until the run has ended
    auto      native if there is a display, otherwise none
    http://HOST:PORT    the same page on one port of that address, 0.0.0.0 for all, until Ctrl-C: for containers
    none      nothing live
    rerun+http://HOST:PORT/proxy    a viewer that the user starts, now or later

Every other server here listens on loopback only. A started viewer counts as listening only when its own process holds
the port. Otherwise, if the port was busy, all data would go to the program that holds it.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, urlsplit

from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.wire.ports import LOOPBACK, free_port
from hedgerow.wire.release import release

NATIVE_MEMORY = "1GB"
"""the memory of the native viewer for a run; it drops the oldest steps beyond"""
SERVER_MEMORY = "256MiB"
"""the memory of a server for pages that are opened late"""
NICE = 5
"""the increase of a viewer's `nice` value, so that the run has priority"""
END_DEADLINE_S = 5.0
"""the time that a viewer has to end before it is killed [s]"""
START_DEADLINE_S = 20.0
"""the time that a viewer has to start if the command waits for it [s]"""


@dataclass(frozen=True)
class Viewer:
    """A Rerun viewer that listens at `url`, or will do so."""

    url: str
    link: str | None = None
    """the link for a browser, if the viewer is a page"""
    process: subprocess.Popen[bytes] | None = None
    """the viewer's process; None if the user starts the viewer"""
    door: subprocess.Popen[bytes] | None = None
    """the process that serves a page on one port, if there is one"""

    @property
    def gone(self) -> bool:
        """Return True if the viewer that we started has ended; any program may then use its port."""
        return self.process is not None and self.process.poll() is not None

    def listens(self) -> bool:
        """Return True if the viewer itself, not another program on its port, accepts connections now."""
        address = urlsplit(self.url)
        if self.process is not None:
            return (LOOPBACK, address.port) in listening(self.process.pid)
        try:
            socket.create_connection((address.hostname or "", address.port or 0), 1).close()
        except OSError:
            return False
        return True

    def answers(self) -> bool:
        """Return True if a viewer that we started accepts data now and, if it is a page, browsers too.

        A viewer that the user starts may come at any time: it counts as there.
        """
        if self.process is None:
            return True
        if not self.listens():
            return False
        server = self.process if self.door is None else self.door
        page = urlsplit(self.link or self.url).port
        return any(port == page for _, port in listening(server.pid))

    def wait_until_it_listens(self, deadline_s: float = START_DEADLINE_S) -> None:
        """Wait until it accepts connections; raise HedgerowError, with a fix, if it never does."""
        by = time.monotonic() + deadline_s
        while not self.listens():
            if self.gone:
                raise HedgerowError(
                    "the viewer ended at once: there may be no graphics driver here; --viewer web shows it in a"
                    " browser",
                    code=Code.VIEWER,
                )
            if time.monotonic() > by:
                raise HedgerowError(f"{self.url}: {self.unheard}", code=Code.VIEWER)
            time.sleep(0.05)

    @property
    def unheard(self) -> str:
        """Return the fix for a viewer that does not listen."""
        if self.process is not None:
            return "the viewer does not start; try again, or --viewer web"
        port = urlsplit(self.url).port
        return (
            f"no viewer listens there; start a viewer of rerun-sdk {release('rerun-sdk')} with"
            f" `rerun --port {port} --bind {LOOPBACK}`, or choose --viewer web"
        )

    def end(self) -> None:
        """Stop the server behind a page; a native viewer stays until its window is closed."""
        if self.process is not None and self.link is not None:
            for process in (self.process, self.door):
                if process is not None:
                    process.terminate()
                    try:
                        process.wait(END_DEADLINE_S)
                    except subprocess.TimeoutExpired:  # it ignores SIGTERM, as our process may do
                        process.kill()
                        process.wait()


def choose(asked: str) -> str:
    """Return the result of `--viewer ASKED` on this machine: native, web, none or an address.

    Raise UserError for another text, for native without a display, and for a page on a port that is not available.
    """
    match asked:
        case "auto":
            return "native" if has_display() else "none"
        case "native" if not has_display():
            raise UserError(
                "--viewer native: there is no display (DISPLAY and WAYLAND_DISPLAY are not set); choose --viewer web,"
                " or --viewer none and open run.rrd with `rerun` where there is one"
            )
        case "native" | "web" | "none":
            return asked
        case _ if _is_page(asked):
            _check_free(asked)
            return asked
        case _ if _is_address(asked):
            return asked
        case _:
            raise UserError(
                f"--viewer {asked}: is none of auto, native, web, none and no viewer's address;"
                " an address is written rerun+http://HOST:PORT/proxy, and http://HOST:PORT serves a page there"
            )


def choose_one(asked: str, instead: str) -> str:
    """Return the choice for a command that must show something; raise UserError, with a fix, for none or without a
    display.
    """
    choice = choose(asked) if asked != "native" or has_display() else "none"
    if choice == "none":
        option = "" if asked == "auto" else f"--viewer {asked}: "
        raise UserError(
            f"{option}there is no display (DISPLAY and WAYLAND_DISPLAY are not set): --viewer web serves a page;"
            f" {instead}"
            if asked != "none"
            else "--viewer none: shows nothing; choose native, web or a viewer's address",
            code=Code.VIEWER if asked == "auto" else Code.OPTION,
        )
    return choice


def start(choice: str, memory: str = NATIVE_MEMORY, server_memory: str = SERVER_MEMORY) -> Viewer | None:
    """Return the viewer of a choice from `choose`, with its process started if it is ours; None for none."""
    match choice:
        case "none":
            return None
        case "native":
            return native(memory=memory)
        case "web":
            return _web(server_memory)
        case _ if _is_page(choice):
            return _published(choice, server_memory)
        case _:
            return Viewer(choice)


def has_display() -> bool:
    """Return True if a window can be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _is_address(asked: str) -> bool:
    try:
        parts = urlsplit(asked)
        known = parts.scheme in ("rerun+http", "rerun+https") and parts.path == "/proxy"
        return known and bool(parts.hostname and parts.port)
    except ValueError:  # a port that is not a number, or too large
        return False


def _is_page(asked: str) -> bool:
    try:
        parts = urlsplit(asked)
        return parts.scheme == "http" and parts.path in ("", "/") and bool(parts.hostname and parts.port)
    except ValueError:
        return False


def _check_free(page: str) -> None:
    parts = urlsplit(page)
    host = str(parts.hostname)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, int(parts.port or 0)), family=family).close()
    except OSError as error:
        why = (error.strerror or str(error)).partition(" (while")[0]
        raise UserError(f"--viewer {page}: no page there: {why}; choose another port, or an address of ours") from None


def native(*options: str, port: int | None = None, memory: str = NATIVE_MEMORY) -> Viewer:
    """Return a viewer in a window, at a free port; `options` are further options of rerun, such as --headless."""
    port = free_port() if port is None else port
    return Viewer(_url(port), process=_begin("--port", str(port), "--memory-limit", memory, *options))


def _web(memory: str) -> Viewer:
    port, page = free_port(), free_port()
    ports = ("--port", str(port), "--web-viewer-port", str(page))
    process = _begin("--serve-web", *ports, server_memory=memory, first=_end_with_parent)
    # Use the dark theme, which the colours of the network's picture need; a browser would choose by itself.
    link = f"http://{LOOPBACK}:{page}/?url={quote(_url(port), safe='')}&theme=dark"
    return Viewer(_url(port), link, process)


def _published(address: str, memory: str) -> Viewer:
    """Return a page and its data on one port (orchestrator.views.rerun.one_port) that other machines can reach."""
    port, page, parts = free_port(), free_port(), urlsplit(address)
    process = _begin(
        *("--port", str(port), "--web-viewer-port", str(page), "--serve-web"),
        server_memory=memory,
        first=_end_with_parent,
    )
    host, outside = str(parts.hostname), int(parts.port or 0)
    door = subprocess.Popen(
        [
            sys.executable,
            "-P",
            "-m",
            "hedgerow.orchestrator.views.rerun.one_port",
            *map(str, (host, outside, port, page)),
        ],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=_end_with_parent,  # noqa: PLW1509 (system calls, no lock)
    )
    return Viewer(_url(port), f"http://{'localhost' if host == '0.0.0.0' else host}:{outside}", process, door)


def _url(port: int) -> str:
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def _step_back() -> None:
    """Lower the priority of a viewer: it may stutter, but a step of the run may not."""
    os.nice(NICE)


def _end_with_parent() -> None:
    """End the server of a page with the run, even if that is killed (on Linux, where the kernel supports it)."""
    _step_back()
    if sys.platform == "linux":
        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


def _begin(
    *options: str, server_memory: str = SERVER_MEMORY, first: Callable[[], None] = _step_back
) -> subprocess.Popen[bytes]:
    # Use a separate session: a Ctrl-C, or the end of the run's terminal, must not reach the viewer.
    return subprocess.Popen(
        [
            str(executable()),
            *("--bind", LOOPBACK, "--server-memory-limit", server_memory, "--hide-welcome-screen"),
            *options,
        ],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=first,  # noqa: PLW1509 (system calls, no lock)
        env={**os.environ, "RERUN_APP_ONLY": "true"},
    )


def executable() -> Path:
    """Return the viewer of the installed rerun-sdk: the `rerun` on the path is a wrapper, or another version."""
    package = importlib.util.find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise UserError("--viewer: rerun-sdk has no viewer here; reinstall it, or --viewer none", code=Code.DEPENDENCY)
    folder = Path(package.origin).parent
    bundle = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    if sys.platform == "darwin" and bundle.exists():
        return bundle
    return folder / ("rerun.exe" if sys.platform == "win32" else "rerun")


def listening(pid: int) -> set[tuple[str, int]]:
    """Return the addresses at which a process accepts TCP connections; none if it has ended."""
    import psutil  # noqa: PLC0415  # it delays the first step

    try:
        sockets = psutil.Process(pid).net_connections("tcp")
    except psutil.Error:
        return set()
    return {(one.laddr.ip, one.laddr.port) for one in sockets if one.status == psutil.CONN_LISTEN}
