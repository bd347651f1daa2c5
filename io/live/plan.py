"""What a live session is to do, and what it came to."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.live.capture.source import Pace
from quadrig.io.live.capture.source_spec import SourceSpec
from quadrig.rig.coach.fault import Fault
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


@dataclass(frozen=True, eq=False)
class SetupPlan:
    """What a session is to do.

    sources: by camera name. until: the accuracy, m, at which it stops by itself. pace: of files. earlier: the
    recordings of sessions that this one goes on from. tolerance: s, between frames of one frameset. replaces: files
    that go when the recording appears.
    """

    config: RigConfig
    sources: Mapping[str, SourceSpec]
    recording: Path
    until: float | None = None
    pace: Pace = "real time"
    earlier: tuple[Path, ...] = ()
    tolerance: float | None = None
    replaces: tuple[Path, ...] = ()

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras' names."""
        return tuple(self.sources)

    @property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """The rectangles of rig.toml."""
        return tuple(self.config.rectangles)

    @property
    def waits(self) -> bool:
        """Whether files wait until everything was done with their frames."""
        return self.pace == "consumed"


@dataclass(frozen=True, eq=False)
class SetupResult:
    """What a session came to.

    latencies: s, of each frameset from arrival until it was handed to the screens; ending: why it stopped.
    cameras: those that gave a picture. fault: what is wrong with the sheets, though there is a rig.
    """

    rig: Rig | None
    trouble: str
    views: tuple[View, ...]
    framesets: int
    kept: int
    seconds: float
    ending: str
    dropped: int = 0
    latencies: tuple[float, ...] = ()
    cameras: tuple[CameraInput, ...] = ()
    fault: Fault | None = None
