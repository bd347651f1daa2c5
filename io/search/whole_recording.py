"""The whole walk: recording -> framesets -> Views -> Rig. All that calibrates a recording goes this way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.formats.any_file import KnownLens
from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.framesets import Framesets, build_framesets
from quadrig.io.recording.recorded_cameras import Recording, open_recording
from quadrig.io.search.choose_frames import choose_frames
from quadrig.io.search.corner_views import corner_views, without_corners
from quadrig.io.search.detections import Detections, find_detections
from quadrig.io.search.effort import EVERY_IMAGE, Effort
from quadrig.io.search.known_lenses import with_known_lenses
from quadrig.io.search.plain_sights import plain_sights
from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.view import View


@dataclass(frozen=True, eq=False)
class Searched:
    """What a recording showed of the rectangles of a rig.toml, ready to be calibrated. sights: what cameras that saw
    none of them show instead, in sentences."""

    config: RigConfig
    recording: Recording
    framesets: Framesets
    detections: Detections
    cameras: tuple[CameraInput, ...]
    sights: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

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
        """What was skipped, or found before, in sentences."""
        reused = self.detections.reused
        return [
            *self.recording.notes,
            *self.detections.remarks,
            *self.remarks,
            *without_corners(self.config),
            *(
                _left_out(self.recording.camera(name), why, images)
                for name, reasons in self.detections.left_out.items()
                for why, images in reasons.items()
            ),
            *([f"{reused} images were searched before; what was kept of them is used"] if reused else []),
        ]


def _left_out(camera: RecordedCamera, why: str, images: Sequence[int]) -> str:
    files = camera.source.files
    first = files[images[0]].name if len(files) == camera.frames else f"number {images[0]}"
    count = f"{len(images)} images are" if len(images) > 1 else "1 image is"
    return f"camera {camera.name!r}: {count} left out: {why} (the first: {first})"


def calibrate_recording(
    paths: Sequence[Path | str] | Path | str,
    config: RigConfig,
    effort: Effort = EVERY_IMAGE,
    *,
    lenses: Mapping[str, KnownLens] | None = None,
    keep_lenses: bool = False,
) -> Rig:
    """The rig of the cameras of a recording, from the description of the room in a rig.toml.

    paths: MCAP files, videos or folders of images that were recorded together. Cameras that share nothing with the
    largest rig are not placed, and named in Rig.missing; their lenses are in Rig.apart. lenses: known before, by
    camera (read_any_lenses): with their doubt they count as the Views they come from; keep_lenses: as they are.
    Raises QuadrigError where the recording cannot be searched, nothing is found, or a lens is not of its cameras.
    """
    return calibrate_searched(search_recording(paths, config, effort, lenses=lenses, keep_lenses=keep_lenses))


def search_recording(
    paths: Sequence[Path | str] | Path | str,
    config: RigConfig,
    effort: Effort = EVERY_IMAGE,
    *,
    lenses: Mapping[str, KnownLens] | None = None,
    keep_lenses: bool = False,
) -> Searched:
    """Open a recording and find the rectangles of a rig.toml in it; those whose corners are given by hand as given.

    Raises QuadrigError where there are no images, a camera of the rig.toml is missing, nothing can be read, or
    corners given by hand or lenses do not belong to this recording.
    """
    recording = open_described(paths, config, effort.rate)
    # Before the search, which takes long: what is wrong with the lenses is known at once.
    cameras, remarks = with_known_lenses(camera_inputs(recording, config), lenses or {}, keep_lenses)
    every = build_framesets(recording, effort.tolerance)
    pointed = corner_views(config.corners, recording, every)
    framesets = choose_frames(recording, every, effort)
    sought = [rectangle for rectangle in config.rectangles if not rectangle.marking.by_hand]
    detections = find_detections(recording, framesets, sought, effort)
    detections = replace(detections, views=[*detections.views, *pointed])
    sights = plain_sights(recording, framesets, detections.views, sought, effort)
    return Searched(config, recording, framesets, detections, tuple(cameras), sights, tuple(remarks))


def open_described(
    paths: Sequence[Path | str] | Path | str, config: RigConfig, rate: float | None = None
) -> Recording:
    """The recording with the cameras of rig.toml.

    Where a [[camera]] names its topic, the tables choose: the others are left out, which is said. Else the tables
    only add what is known of a camera, and every camera of the recording is used.
    """
    wanted = {camera.name: camera.topic for camera in config.cameras}
    if all(topic is None for topic in wanted.values()):
        recording = open_recording(paths, rate=rate)
        names = [camera.name for camera in recording.cameras]
        missing = [name for name in wanted if name not in names]
        if missing:
            there = ", ".join(camera.topic for camera in recording.cameras)
            where = ", ".join(str(path) for path in recording.paths)
            raise QuadrigError(f"{where}: no topic for camera {missing[0]!r}; the images are on {there}")
        more = [name for name in names if name not in wanted] if wanted else []
        said = f"rig.toml has no [[camera]] for {', '.join(more)}: used all the same, with nothing known beforehand"
        return replace(recording, notes=(*recording.notes, said)) if more else recording
    return open_recording(paths, wanted, rate)


def calibrate_searched(searched: Searched) -> Rig:
    """The rig that the Views of a recording show. Raises QuadrigError as calibrate does."""
    config, sights = searched.config, searched.sights
    try:
        rig = calibrate(searched.cameras, config.rectangles, searched.views, config.reference)
    except QuadrigError as error:
        raise QuadrigError("; ".join([str(error), *dict.fromkeys(sights.values())])) from error
    return replace(rig, missing={name: sights.get(name, why) for name, why in rig.missing.items()})


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
        raise QuadrigError("; ".join(rig.missing.values()) + "; or accept a rig without them, without --all-cameras")
