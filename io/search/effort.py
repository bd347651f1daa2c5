"""How much work a recording is worth, and who does it."""

from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Effort:
    """How a recording is searched.

    rate: pictures a second of image files that carry no time; None where not known.
    tolerance: s, the most that stamps of one instant differ; None as build_framesets has it. share: of the
    framesets that are searched, chosen by a quick look at all; 1 searches all. workers: processes; None as many as
    there are processors. cache: an MCAP that keeps what was found: images that it has are not searched again.
    progress: bars on stderr, where that is a terminal. executor: runs the tasks instead of processes of our own.
    """

    tolerance: float | None = None
    share: float = 1.0
    workers: int | None = None
    cache: Path | None = None
    progress: bool = True
    executor: Executor | None = None
    rate: float | None = None


EVERY_IMAGE = Effort()
"""Every image, over all processors, nothing kept."""
