"""The timelines of a rig: its framesets, and their times where known."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from quadrig.rig.result import Rig


def framesets_of(rig: Rig) -> list[int]:
    """The framesets that hold a View or a moving rectangle, in order."""
    held = {fit.view.frameset for fit in rig.fits}
    return sorted(held.union(*(np.asarray(placed.framesets).tolist() for placed in rig.rectangles)))


def set_frameset(recording: rr.RecordingStream, frameset: int, times: Sequence[int]) -> None:
    """Put what is logged next at a frameset, on the timelines "frameset" and, where known, "time"."""
    recording.set_time("frameset", sequence=int(frameset))
    if 0 <= frameset < len(times):
        recording.set_time("time", timestamp=np.datetime64(int(times[frameset]), "ns"))
