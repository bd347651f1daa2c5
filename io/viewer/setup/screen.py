"""A live session in a rerun viewer, or in a file, moment by moment."""

import queue
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

from quadrig.io.live.state import SetupState
from quadrig.io.viewer.process import Viewer
from quadrig.io.viewer.web_page import PageViewer
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle

# Seconds from moment to moment in a viewer at least, and that it may take to accept one.
_SHORTEST, _SLOWEST = 1 / 15, 2.0


class RerunScreen:
    """Logs a session to a rerun viewer, or to a file.

    Exactly one of `viewer` and `file` (.rrd) is given. A viewer that is slower than the session misses moments and
    holds nobody up; one whose window was closed is said on stderr, and the session goes on without it.
    """

    def __init__(
        self,
        cameras: Sequence[str],
        rectangles: Sequence[Rectangle],
        viewer: Viewer | PageViewer | None = None,
        file: Path | None = None,
    ) -> None:
        import rerun as rr

        from quadrig.io.viewer.rrd_file import rrd_written
        from quadrig.io.viewer.setup.blueprint import setup_blueprint
        from quadrig.io.viewer.setup.moments import MomentLog

        blueprint, self._file = setup_blueprint(cameras), ExitStack()
        if file is not None:
            self._recording = self._file.enter_context(rrd_written(file, "quadrig setup", blueprint))
        elif viewer is not None:
            self._recording = rr.RecordingStream("quadrig setup")
            self._recording.connect_grpc(viewer.address, default_blueprint=blueprint)
            self._recording.send_blueprint(blueprint)
        self._moments = MomentLog(self._recording, cameras, rectangles)
        self._viewer, self._waiting = viewer, queue.Queue[SetupState | None](1)
        self._thread = threading.Thread(target=self._log_newest, name="viewer", daemon=True)
        self._thread.start()

    def show(self, state: SetupState) -> None:
        """Log what has changed: in a file at once, in a viewer when it has taken what came before."""
        if self._viewer is None:
            self.log(state)
        else:
            self._hand_over(state)

    def log(self, state: SetupState) -> None:
        """Log what has changed since the state before."""
        self._moments.log(state)

    def close(self) -> None:
        """Send what waits."""
        self._hand_over(None)
        self._thread.join(_SLOWEST)
        if self._viewer is None:
            try:
                self._file.close()
            except QuadrigError as error:
                # What the session came to matters more.
                print(f"rig: {error}", file=sys.stderr, flush=True)
            return
        # A viewer that was closed takes nothing any more.
        with suppress(RuntimeError):
            self._recording.flush(timeout_sec=_SLOWEST)
        self._recording.disconnect()

    def _hand_over(self, state: SetupState | None) -> None:
        with suppress(queue.Empty):
            self._waiting.get_nowait()
        self._waiting.put(state)

    def _log_newest(self) -> None:
        while (state := self._waiting.get()) is not None:
            began = time.monotonic()
            self.log(state)
            # Without this a slow viewer would fall behind by all that waits for it.
            with suppress(RuntimeError):
                self._recording.flush(timeout_sec=_SLOWEST)
            if self._viewer is not None and not self._viewer.open:
                print("rig: the viewer was closed; the session goes on here", file=sys.stderr, flush=True)
                return
            time.sleep(max(0.0, began + _SHORTEST - time.monotonic()))
