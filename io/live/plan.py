"""What a live session is to do, and what it came to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from quadrig.io.config.rig_toml import RigConfig, refuse_reference
from quadrig.io.live.capture.source import Pace
from quadrig.io.live.capture.source_spec import SourceSpec
from quadrig.rig.coach.fault import Fault
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.detect.image_search import check_rectangles
from quadrig.single.errors import QuadrigError
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


def check_plan(config: RigConfig, cameras: Sequence[str]) -> tuple[str, ...]:
    """What a person should know of a rig.toml before the first picture of these cameras comes, in sentences.

    Raises QuadrigError where a session could come to nothing: a reference that is not there, rectangles that no
    search finds or tells apart.
    """
    refuse_reference(config, cameras)
    check_rectangles(config.rectangles)
    by_hand = [rectangle.name for rectangle in config.rectangles if rectangle.marking.by_hand]
    if len(by_hand) == len(config.rectangles):
        raise QuadrigError(
            "rig.toml has only rectangles whose corners are given by hand, which live pictures do not show; record "
            "with rig record, then rig pick and rig calibrate"
        )
    notes = [f"{', '.join(by_hand)}: corners given by hand count later, in rig calibrate"] if by_hand else []
    idle = [camera.name for camera in config.cameras if camera.name not in cameras]
    if idle:
        notes.append(f"rig.toml describes {', '.join(idle)}, which is none of the sources ({', '.join(cameras)})")
    return tuple(notes)


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
