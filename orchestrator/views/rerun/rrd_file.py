"""The recording run.rrd, split into run-001.rrd, run-002.rrd, … if it becomes too large.

Each part begins with all static data, so each of them opens alone. Together they are one recording, and `rerun rrd
merge run*.rrd -o whole.rrd` makes one file of them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import rerun as rr
from rerun_bindings import flush_and_cleanup_orphaned_recordings

from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.topologies.errors import Code, UserError

ROOM_BYTES = 2**18
"""the disk has this much room before a part begins"""
Write = Callable[[rr.RecordingStream], None]


def part_path(path: Path, number: int) -> Path:
    """Return the file of a part: `path` itself for number 0, then run-001.rrd and so on."""
    return path.with_stem(f"{path.stem}-{number:03}") if number else path


def parts(path: Path) -> list[Path]:
    """Return the existing parts, the oldest first; some may have been deleted during the run."""
    later = (one for one in path.parent.glob(f"{path.stem}-*{path.suffix}") if _number(path, one))
    return [path] * path.exists() + sorted(later, key=lambda one: _number(path, one))


def _number(path: Path, part: Path) -> int:
    digits = part.stem.removeprefix(f"{path.stem}-")
    return int(digits) if digits.isdecimal() and len(digits) >= 3 else 0


class RrdFile:
    """A recording on disk, in parts of about `part_bytes`, or in one file for 0.

    With `footer`, each part ends with an index of its content. Rerun holds that index in memory until then, 0.34 MB per
    MB of paper7.

    `open_stream` opens a recording into a sink and sends it all static data. The first write after a part has reached
    its size starts the next part; the last 0.2 s of rows, which Rerun still holds, are added to the old one.
    """

    def __init__(
        self,
        path: Path,
        open_stream: Callable[[rr.FileSink], rr.RecordingStream],
        part_bytes: int = 0,
        footer: bool = True,
    ) -> None:
        self._path, self._open, self._part_bytes, self._footer = path, open_stream, part_bytes, footer
        self.number = 0
        self._stream = self._begin()

    @property
    def part(self) -> Path:
        """Return the file that is being written."""
        return part_path(self._path, self.number)

    def write(self, write: Write) -> None:
        """Write to the current part, or start another one first; raise UserError if that fails."""
        if self._part_bytes and self._size() >= self._part_bytes:
            self._finish(timeout_s=5.0)
            self.number += 1
            self._stream = self._begin()
            flush_and_cleanup_orphaned_recordings()  # otherwise the threads of the last part remain
        write(self._stream)

    def close(self, deadline_s: float) -> None:
        """Complete the last part; raise UserError if it is incomplete."""
        self._finish(max(deadline_s, 1.0))

    def _begin(self) -> rr.RecordingStream:
        try:
            self._make_room()
            return self._open(rr.FileSink(spelled(self.part), write_footer=self._footer))
        except (RuntimeError, OSError) as error:
            raise self._unwritable(error) from None

    def _make_room(self) -> None:
        """Raise OSError if the beginning of a part has no room: Rerun may wait for ever after a failed write."""
        room = self.part.with_suffix(".room")
        try:
            room.write_bytes(bytes(ROOM_BYTES))
        finally:
            room.unlink(missing_ok=True)

    def _finish(self, timeout_s: float) -> None:
        try:
            self._stream.flush(timeout_sec=timeout_s)
        except RuntimeError as error:
            raise self._unwritable(error) from None
        self._stream.disconnect()

    def _size(self) -> int:
        with contextlib.suppress(FileNotFoundError):
            return self.part.stat().st_size
        return self._part_bytes  # the file was deleted: write further data to the next part

    def _unwritable(self, error: RuntimeError | OSError) -> UserError:
        return UserError(
            f"{self.part}: is not complete: {error}; see that the disk has room and the folder can be written",
            code=Code.OUTPUT,
        )
