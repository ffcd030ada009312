"""The check of a separate viewer's version: another version seems to work, but may fail."""

from __future__ import annotations

import threading
from collections.abc import Callable

from hedgerow.orchestrator.views.rerun.viewer import Viewer

VERSION_DEADLINE_S = 2.0
"""the time to wait for an answer [s]: a frozen viewer never answers"""


def compare(viewer: Viewer, say: Callable[[str], None]) -> threading.Thread:
    """Ask a listening viewer for its version, on a thread, and report a difference with its fix."""

    def ask() -> None:
        if viewer.process is not None:
            return
        import rerun  # noqa: PLC0415
        from rerun.experimental import ViewerClient  # noqa: PLC0415

        ours = rerun.__version__
        try:
            theirs = ViewerClient.connect(viewer.url).get_state().viewer_version
        except (RuntimeError, OSError) as error:
            if "Unimplemented" in str(error):
                say(
                    f"the viewer at {viewer.url} does not report its version: it is old, or a relay. If it shows"
                    f" nothing, install rerun-sdk=={ours} there"
                )
            return
        if theirs != ours:
            say(
                f"the viewer at {viewer.url} is Rerun {theirs}, and this is {ours}: its display may be wrong."
                f" Install rerun-sdk=={ours} there"
            )

    asking = threading.Thread(target=ask, name="version", daemon=True)
    asking.start()
    return asking
