"""A run over Zenoh: one plant, agent processes, a router between them, and the observer here."""

from __future__ import annotations

import contextlib
import functools
import threading
import time
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import zenoh

from hedgerow.orchestrator.ground.assignment import Layout, process_name
from hedgerow.orchestrator.ground.signals import Interrupts
from hedgerow.orchestrator.launch.control import ask, tell_died
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.orchestrator.launch.launching import Launch, Launched
from hedgerow.orchestrator.launch.options import Options
from hedgerow.orchestrator.launch.supervisor import Processes, cause
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.orchestrator.runs.log_files import escape_logs
from hedgerow.orchestrator.views.screen import Screen
from hedgerow.topologies.errors import Exit
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.session import WireError, has_router
from hedgerow.wire.start import loading

# The modules of the observer take a tenth of a second to load, and Arrow two tenths. The first load while the processes
# of the run start, in `_recording`; Arrow loads after the run. At the top, both would delay the first step.
if TYPE_CHECKING:
    from hedgerow.orchestrator.launch.recording import Recording
    from hedgerow.orchestrator.metrics.verdict import Ending, Verdict
    from hedgerow.orchestrator.views.rerun.viewer import Viewer

TICK_S = 0.2
"""The time between two readings of telemetry [s]; rows are read in batches, beside the loop."""
PLANT_END_DEADLINE_S, AGENTS_END_DEADLINE_S = 5.0, 1.0
"""The time that the plant has to end by itself after END, and the agents after it [s]; agents have no data to save."""
ROUTER_GONE_S = 3.0
"""The time without the user's router after which the run ends, before the first and after the last step [s]."""


class Network:
    """The processes of one run, from launch to verdict."""

    def __init__(
        self,
        topology: Topology,
        folder: RunFolder,
        shards: Layout,
        options: Options,
        screen: Screen,
        fork_client: ForkClient,
        began: float,
    ) -> None:
        """Prepare a run; `began` is the start time of the command, by time.monotonic(), for the time to the first
        step.
        """
        self._topology, self._folder, self._shards, self._options = topology, folder, shards, options
        self._screen, self._began = screen, began
        self._wake = threading.Event()
        """set to check for news before the next tick"""
        self._launch = Launch(topology, folder, shards, options, screen, fork_client, self._wake.set)
        self._asked_at: float | None = None
        """the time of the first request to the plant to stop"""
        self._answered = False
        self._routed_at = time.monotonic()
        """the last time with a router"""
        self._cut_off = False
        """True if it has been absent for too long"""
        self.interrupted = ""
        """the signal by which the user asked for the end"""

    @cached_property
    def _ending(self) -> Ending:
        from hedgerow.orchestrator.metrics.verdict import Ending  # noqa: PLC0415

        return Ending(run=self._folder.name, engine="zenoh", processes=len(self._shards))

    @cached_property
    def _recording(self) -> Recording:
        """Return the recording, after loading all modules of the observer."""
        with loading():
            from hedgerow.orchestrator.launch import intake, judging  # noqa: F401, PLC0415
            from hedgerow.orchestrator.launch.recording import Recording  # noqa: PLC0415

        names = [process_name(view) for view in self._launch.views]
        return Recording(self._topology, self._folder, self._options.watching, self._ending, names)

    def run(
        self,
        on_first_step: Callable[[float], None] = lambda _: None,
        at_last: contextlib.AbstractContextManager[object] = contextlib.nullcontext(),  # noqa: B008 (it has no state)
    ) -> Verdict:
        """Launch, observe until the end or an interrupt, clean up, and judge.

        `on_first_step` receives the seconds from the command to the first step, after that step. `at_last` ends last,
        while a signal still only asks for the end.
        """
        found = None
        with Interrupts(self._wake.set) as interrupts, at_last, self._launch.announced():
            try:
                with contextlib.ExitStack() as stack:
                    launched = self._launch.start(stack, interrupts, meanwhile=lambda: self._recording)
                    run = self._recording
                    run.tell_faults()
                    try:
                        self._observe(run, launched, interrupts, on_first_step)
                        if not self._cut_off:  # otherwise no process knows of the end
                            launched.processes.wait(PLANT_END_DEADLINE_S, AGENTS_END_DEADLINE_S)
                    finally:
                        from hedgerow.orchestrator.launch.judging import fates  # noqa: PLC0415

                        found = fates(launched, run, self._shards, self._ending)
            except (KeyboardInterrupt, SystemExit):
                raise
            except BaseException as error:  # a panic of a Rust library is not an Exception
                self._ending.end_by(error, self._folder.logs / "orchestrator.log")
            self.interrupted = interrupts.name
            from hedgerow.orchestrator.launch.comparison import compare  # noqa: PLC0415
            from hedgerow.orchestrator.launch.judging import explain  # noqa: PLC0415
            from hedgerow.orchestrator.runs.round_trips import line  # noqa: PLC0415

            run = self._recording
            explain(found, run, self._folder, self._ending)
            if self._options.verify and not self._ending.stopped:
                self._ending.comparison = compare(run)
            verdict = run.close()
            escape_logs(self._folder.logs)
            run.warn(self._screen)
            if times := line(verdict.content["round_trips"] or {}):
                self._screen.say(times)
            self._screen.verdict(verdict, self._folder.path)
            if run.viewer is not None:
                self._serve(run.viewer, interrupts)
        return verdict

    def _serve(self, viewer: Viewer, interrupts: Interrupts) -> None:
        """Serve a web page until Ctrl-C if the command asks for it; a page that other machines open stays in any
        case.
        """
        if viewer.link is not None and self._recording.page_stays and not interrupts.count:
            self._wake.clear()
            while not (viewer.answers() or viewer.gone or interrupts.count):  # a short run ends before its page answers
                self._wake.wait(TICK_S)
            if viewer.answers() and not interrupts.count:
                self._screen.say(f"{viewer.link} stays until Ctrl-C")
            while not (viewer.gone or interrupts.count):
                self._wake.wait(TICK_S)
        viewer.end()

    def _observe(
        self,
        run: Recording,
        launched: Launched,
        interrupts: Interrupts,
        on_first_step: Callable[[float], None],
    ) -> None:
        """Read telemetry in batches, until the plant's END or until there is no process to wait for."""
        processes, session = launched.processes, launched.session
        from hedgerow.orchestrator.launch.intake import Intake  # noqa: PLC0415

        known = (self._launch.views, self._screen, self._ending, self._wake, launched.shared)
        intake = Intake(run, self._folder, self._shards, *known)
        with contextlib.closing(intake.open(session)):
            while run.observer.end is None:
                self._wake.wait(self._tick_s(processes))
                self._wake.clear()
                if self._ending.first_step_s is None and intake.first_at is not None:
                    self._ending.first_step_s = intake.first_at - self._began
                    self._folder.event("first_step", after_s=round(self._ending.first_step_s, 3))
                    on_first_step(self._ending.first_step_s)
                for refused in launched.meeting.refused() if launched.meeting else ():
                    self._screen.say(refused)
                no_process_left = (
                    processes.ended(keys.PLANT)
                    or self._asked_long_ago()
                    or self._is_cut_off(launched)
                    or self._nobody_comes(launched)
                )
                if not intake.take(processes) and no_process_left:
                    return
                for happened in processes.tend(functools.partial(tell_died, session, timeout_s=TICK_S)):
                    self._folder.event(**happened)
                    if happened["kind"] == "down":
                        self._screen.say(f"{happened['process']} stays down: {happened['how']}")
                    if happened.get("code") == Exit.CRASH:
                        self._screen.say(happened["how"])
                        self._ending.crashed = True
                        self._ending.stopped = self._ending.stopped or happened["how"]
                # Without one of our processes the first step never happens.
                missed = processes.failing if self._ending.first_step_s is None else []
                if interrupts.count or processes.dead() or missed:
                    self._ask_to_stop(session, interrupts.name or (cause(missed) if missed else ""))
        if self._ending.stopped == interrupts.name and run.observer.end.t == self._topology.steps:
            self._ending.stopped = ""  # the signal was too late: the plant had made all steps already

    def _tick_s(self, processes: Processes) -> float:
        due = processes.next_due
        return TICK_S if due is None else min(TICK_S, max(0.0, due - time.monotonic()))

    def _ask_to_stop(self, session: zenoh.Session, why: str) -> None:
        """Ask the plant to end the run, again at every tick until it answers: it may not have started yet."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()
            self._ending.stopped = why
            self._folder.event("stopping", why=why or "a process died")
        if not self._answered:
            with contextlib.suppress(WireError):
                ask(session, "stop", timeout_s=1.0)
                self._answered = True

    def _asked_long_ago(self) -> bool:
        return self._asked_at is not None and time.monotonic() - self._asked_at > PLANT_END_DEADLINE_S

    def _is_cut_off(self, launched: Launched) -> bool:
        """Return True if the user's router is absent for too long; a meeting with separate processes waits longer."""
        now = time.monotonic()
        if self._launch.connection.listens or launched.meeting is not None or has_router(launched.session):
            self._routed_at = now
            return False
        in_steps = self._ending.first_step_s is not None and self._asked_at is None
        patience_s = max(ROUTER_GONE_S, self._options.deadline_s) if in_steps else ROUTER_GONE_S
        if now - self._routed_at > patience_s:
            self._cut_off = True
            gone = f"the router at {self._launch.connection.endpoint} is gone: not seen for {patience_s:g} s"
            self._ending.stopped = self._ending.stopped or gone
        return self._cut_off

    def _nobody_comes(self, launched: Launched) -> bool:
        """Return True if the separate processes are absent and will not come."""
        begun = self._ending.first_step_s is not None
        over = launched.meeting is not None and launched.meeting.is_over(begun)
        if over and launched.meeting is not None:
            self._ending.stopped = self._ending.stopped or launched.meeting.reason
        if launched.fleet is not None and launched.fleet.reason and not begun:
            over, self._ending.stopped = True, self._ending.stopped or launched.fleet.reason
        return over
