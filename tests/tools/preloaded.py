"""The command `orchestrator`, or a separate agent or plant, in a new process that has loaded its modules already.

Loading them takes most of a short command's time. A server loads them once for a session of tests, and forks one
process per command. Such a process has its own streams, folder, environment and limits, like a process that a shell
started. Tests of the start itself, of signals while modules load, and of the installed program start a new Python.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import importlib
import json
import os
import resource
import runpy
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, NoReturn

ROOT = Path(__file__).parents[2]
MODULES = (
    "clarabel",
    "matplotlib.figure",
    "matplotlib.backends.backend_agg",
    "numpy",
    "pandas",
    "pyarrow.ipc",
    "pyarrow.parquet",
    "rich.console",
    "rich.live",
    "rich.table",
    "scipy.linalg",
    "scipy.sparse.csgraph",
    "scipy.stats",
    "hedgerow.agents.standalone",
    "hedgerow.orchestrator.cli.main",
    "hedgerow.orchestrator.experiments.bounds",
    "hedgerow.orchestrator.experiments.compare",
    "hedgerow.orchestrator.experiments.compare.figure",
    "hedgerow.orchestrator.experiments.compare.statistics",
    "hedgerow.orchestrator.experiments.sweep",
    "hedgerow.orchestrator.experiments.sweep.boxes",
    "hedgerow.orchestrator.experiments.worst",
    "hedgerow.orchestrator.launch.live",
    "hedgerow.orchestrator.launch.recording",
    "hedgerow.orchestrator.launch.simulation",
    "hedgerow.orchestrator.launch.up",
    "hedgerow.orchestrator.metrics.guarantee",
    "hedgerow.orchestrator.metrics.summary",
    "hedgerow.orchestrator.report.figures",
    "hedgerow.orchestrator.report.page",
    "hedgerow.orchestrator.runs.export",
    "hedgerow.plant.standalone",
    "hedgerow.topologies.load",
    "hedgerow.topologies.resolve",
)
"""modules that many commands load, except those that start a thread (rerun)"""
WITHOUT_THREADS = {"JE_ARROW_MALLOC_CONF": "background_thread:false"}
"""variables with which those modules start no thread: the memory pool of pyarrow has one, which only tidies up"""
OF_THE_START = ("PYTHON", "LC_", "LANG", "LD_", "RERUN", "OPENBLAS", "OMP", "MPL")
"""variables that take effect when Python or a library loads, by how they begin"""
SERVER = f"import sys; sys.path.append({str(ROOT)!r}); from tests.tools.preloaded import serve; serve(sys.argv[1])"


CLIENT = """#!{python} -IS
import json, os, socket, sys
program = os.path.basename(sys.argv[0]) == "program"
what = dict(arguments=sys.argv[1:], program=program, new_session=False, largest={unlimited}, folder=os.getcwd())
text = json.dumps(what | dict(environment=dict(os.environ))).encode()
connection = socket.socket(socket.AF_UNIX)
connection.connect({address!r})
socket.send_fds(connection, [len(text).to_bytes(4, "big")], (0, 1, 2))
connection.sendall(text)
with connection.makefile() as answers:
    answers.readline()
    code = int(answers.read())
os.kill(os.getpid(), -code) if code < 0 else os._exit(code)
"""
"""the programs `orchestrator`, and `program FILE …`, for a shell: they order a process, and exit with its code"""


class Process:
    """A process of the server; it has those members of `subprocess.Popen` that the tests use."""

    def __init__(self, connection: socket.socket, pid: int, stdout: IO[str] | None = None) -> None:
        self.pid, self.stdout = pid, stdout
        self.returncode: int | None = None
        self._connection = connection

    def poll(self) -> int | None:
        """Return the exit code if the process has ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end of the process, and return its exit code."""
        if self.returncode is None:
            self._connection.settimeout(timeout if timeout != 0 else 1e-6)
            try:
                text = self._connection.recv(64)
            except TimeoutError:
                raise subprocess.TimeoutExpired("orchestrator", timeout or 0.0) from None
            assert text, "the server of preloaded processes has ended"
            self._connection.close()
            self.returncode = int(text)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, if the process still runs."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


class Server:
    """The server of one session of tests; it starts with the first command."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._address = ""
        self._lock = threading.Lock()

    @property
    def address(self) -> str:
        """Return the path of the server's socket, at which it listens."""
        with self._lock:
            if self._process is None:
                self._folder = tempfile.TemporaryDirectory(prefix="pre-")
                self._address = f"{self._folder.name}/s"
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-c", SERVER, self._address],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    cwd="/",
                    env=os.environ | WITHOUT_THREADS,
                    start_new_session=True,
                )
                assert self._process.stdout is not None
                assert self._process.stdout.readline() == b"listening\n"
        return self._address

    @property
    def programs(self) -> Path:
        """Return a folder with `orchestrator`, and `program` for `python -W error`, for the beginning of a PATH."""
        folder = Path(self.address).parent / "bin"
        if not folder.exists():
            folder.mkdir()
            text = CLIENT.format(python=sys.executable, unlimited=resource.RLIM_INFINITY, address=self.address)
            for name in ("orchestrator", "program"):
                (folder / name).write_text(text)
                (folder / name).chmod(0o755)
        return folder

    def run(self, arguments: Sequence[str], timeout: float, **how: Any) -> subprocess.CompletedProcess[str]:
        """Run a command to its end, as `subprocess.run` does with captured text."""
        pipes = [os.pipe() for _ in range(2)]
        process = self.start(arguments, (0, pipes[0][1], pipes[1][1]), **how)
        for _, writes in pipes:
            os.close(writes)
        texts = ["", ""]

        def read(k: int) -> None:
            with open(pipes[k][0], encoding="utf-8") as stream:
                texts[k] = stream.read()

        readers = [threading.Thread(target=read, args=(k,)) for k in range(2)]
        for reader in readers:
            reader.start()
        try:
            code = process.wait(timeout)
        except BaseException:
            process.kill()
            raise
        for reader in readers:
            reader.join()
        return subprocess.CompletedProcess([*arguments], code, *texts)

    def start(
        self,
        arguments: Sequence[str],
        streams: Sequence[int],
        new_session: bool = False,
        largest: int = resource.RLIM_INFINITY,
        stdout: IO[str] | None = None,
        module: str = "",
    ) -> Process:
        """Start a command with these streams in our folder and environment; no file grows past `largest` bytes.

        With `module`, it is the program that the function `main` of that module is.
        """
        what = {"arguments": [*arguments], "new_session": new_session, "largest": largest, "module": module}
        return Process(*ordered(self.address, what, streams), stdout)

    def close(self) -> None:
        """End the server."""
        if self._process is not None:
            self._process.communicate()
            self._process = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


SESSION = Server()


def at_the_start() -> dict[str, str]:
    """Return the environment that affects how Python and the libraries load."""
    return {name: value for name, value in os.environ.items() if name.startswith(OF_THE_START)}


_AT_THE_START = at_the_start()


def suits() -> bool:
    """Return True if a preloaded process has loaded what a new one would load."""
    return at_the_start() == _AT_THE_START


def ordered(address: str, what: dict[str, Any], streams: Sequence[int]) -> tuple[socket.socket, int]:
    """Order a process of the server; return the connection that carries its exit code, and its id."""
    environment = dict(os.environ)
    text = json.dumps(what | {"folder": os.getcwd(), "environment": environment}).encode()
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(address)
    socket.send_fds(connection, [len(text).to_bytes(4, "big")], streams)
    connection.sendall(text)
    pid = b""
    while not pid.endswith(b"\n"):
        more = connection.recv(1)
        assert more, "the server of preloaded processes has ended"
        pid += more
    return connection, int(pid)


# The server.


def serve(address: str) -> NoReturn:
    """Fork a process per order until standard input ends."""
    from hedgerow.orchestrator import __main__ as command  # noqa: PLC0415

    command._settle_environment()
    for name in MODULES:
        importlib.import_module(name)
    assert len(os.listdir("/proc/self/task")) == 1, "a module of the list starts a thread, which a fork would lose"
    gc.freeze()
    waking, wakes = socket.socketpair()
    for end in (waking, wakes):
        end.setblocking(False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wakes.fileno())
    connections: dict[int, socket.socket] = {}
    with socket.socket(socket.AF_UNIX) as listening, selectors.DefaultSelector() as selector:
        listening.bind(address)
        listening.listen(64)
        for one in (listening, waking, sys.stdin):
            selector.register(one, selectors.EVENT_READ)
        print("listening", flush=True)
        while True:
            for key, _ in selector.select():
                if key.fileobj is sys.stdin:
                    os._exit(0)
                if key.fileobj is waking:
                    with contextlib.suppress(BlockingIOError):
                        waking.recv(4096)
                    reap(connections)
                if key.fileobj is listening:
                    accept(listening, connections)


def reap(connections: dict[int, socket.socket]) -> None:
    """Send the exit codes of processes that have ended."""
    with contextlib.suppress(ChildProcessError):
        while (found := os.waitpid(-1, os.WNOHANG))[0]:
            pid, status = found
            with contextlib.suppress(OSError), connections.pop(pid) as connection:
                connection.sendall(str(os.waitstatus_to_exitcode(status)).encode())


def accept(listening: socket.socket, connections: dict[int, socket.socket]) -> None:
    """Fork the process of one order."""
    connection, _ = listening.accept()
    length, streams, _, _ = socket.recv_fds(connection, 4, 3)
    size, text = int.from_bytes(length, "big"), b""
    while len(text) < size:
        text += connection.recv(size - len(text))
    pid = os.fork()
    if not pid:
        begin(json.loads(text), streams)
    for stream in streams:
        os.close(stream)
    connections[pid] = connection
    connection.sendall(f"{pid}\n".encode())


def run_program(file: str, *arguments: str) -> None:
    """Run a Python program as `python -W error FILE …` does."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    warnings.simplefilter("error")
    sys.argv = [file, *arguments]
    sys.path.insert(0, str(Path(file).parent.absolute()))
    runpy.run_path(file, run_name="__main__")


def run_module(module: str, *arguments: str) -> None:
    """Run the function `main` of a module as the program that pip installs for it does."""
    sys.argv = [module, *arguments]
    importlib.import_module(module).main()


def run_to_the_end(program: Callable[[], None]) -> NoReturn:
    """Run a program, and end this process as the end of Python does."""
    code = 0
    try:
        program()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def begin(what: dict[str, Any], streams: Sequence[int]) -> NoReturn:
    """Become the process of an order, and run its command."""
    from hedgerow.orchestrator import __main__ as command  # noqa: PLC0415

    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    try:
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
        os.closerange(3, 256)
        if what["new_session"]:
            os.setsid()
        if what["largest"] != resource.RLIM_INFINITY:
            resource.setrlimit(resource.RLIMIT_FSIZE, (what["largest"], what["largest"]))
        os.chdir(what["folder"])
        os.environ.clear()
        os.environ.update(what["environment"])
        for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
        if what.get("program"):
            run_to_the_end(functools.partial(run_program, *what["arguments"]))
        if what.get("module"):
            run_to_the_end(functools.partial(run_module, what["module"], *what["arguments"]))
        sys.argv = [command.__file__, *what["arguments"]]
        command.BEGAN = time.monotonic()
        command.main()
    finally:
        os._exit(70)
