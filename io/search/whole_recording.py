"""The whole walk: recording -> framesets -> Views -> Rig. `rig calibrate` and `rig demo` both go this way."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.recording.framesets import Framesets, build_framesets
from quadrig.io.recording.recorded_cameras import Recording, open_recording
from quadrig.io.search.choose_frames import choose_frames
from quadrig.io.search.detections import Detections, find_detections
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.view import View


@dataclass(frozen=True)
class Effort:
    """How a recording is searched.

    tolerance: s, the most that stamps of one instant differ; None as build_framesets has it. share: of the
    framesets that are searched, chosen by a quick look at all; 1 searches all. workers: processes; None as many as
    there are processors. cache: an MCAP that keeps what was found. progress: bars on stderr.
    """

    tolerance: float | None = None
    share: float = 1.0
    workers: int | None = None
    cache: Path | None = None
    progress: bool = True


@dataclass(frozen=True, eq=False)
class Searched:
    """What a recording showed, ready to be calibrated."""

    recording: Recording
    framesets: Framesets
    detections: Detections
    cameras: tuple[CameraInput, ...]

    @property
    def views(self) -> list[View]:
        """The Views of all cameras."""
        return self.detections.views

    @property
    def times(self) -> list[int]:
        """Time of each frameset, ns."""
        return self.framesets.times.tolist()

    @property
    def notes(self) -> list[str]:
        """What was left out or found before, in sentences."""
        unreadable, reused = self.detections.unreadable, self.detections.reused
        return [
            *self.recording.notes,
            *(
                f"camera {name!r}: {count} images cannot be read and are left out"
                for name, count in unreadable.items()
            ),
            *([f"{reused} images were searched before; what was kept of them is used"] if reused else []),
        ]


def search_recording(
    paths: Sequence[Path], config: RigConfig, effort: Effort | None = None, executor: Executor | None = None
) -> Searched:
    """Open a recording and find the rectangles of a rig.toml in it.

    Raises QuadrigError where there are no images, a camera of the rig.toml is missing, or nothing can be read.
    """
    effort = effort or Effort()
    wanted = {camera.name: camera.topic for camera in config.cameras}
    recording = open_recording(paths, wanted or None)
    framesets = build_framesets(recording, effort.tolerance)
    if effort.share < 1:
        framesets = choose_frames(recording, framesets, effort.share, effort.progress, effort.workers, executor)
    detections = find_detections(
        recording, framesets, config.rectangles, effort.progress, effort.workers, effort.cache, executor
    )
    return Searched(recording, framesets, detections, tuple(camera_inputs(recording, config)))


def camera_inputs(recording: Recording, config: RigConfig) -> list[CameraInput]:
    """What is known of each camera: from rig.toml first, else the lens that the recording brings as a first guess."""
    inputs = []
    for camera in recording.cameras:
        known = config.camera_input(camera.name, camera.width, camera.height)
        inputs.append(known if known.intrinsics is not None else replace(known, intrinsics=camera.prior))
    return inputs


def refuse_missing(rig: Rig) -> None:
    """Raises QuadrigError, naming each, where cameras could not be brought into the rig."""
    if rig.missing:
        raise QuadrigError("; ".join(rig.missing.values()) + "; or leave them out, without --all-cameras")
