"""The whole walk: recording -> framesets -> Views -> Rig. All that calibrates a recording goes this way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from quadrig.io.config.rig_toml import CameraConfig, RigConfig, refuse_reference
from quadrig.io.formats.any_file import KnownLens
from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.recorded_cameras import Recording, open_recording
from quadrig.io.search.choose_frames import choose_frames
from quadrig.io.search.corner_views import corner_views, without_corners
from quadrig.io.search.detections import UNREADABLE, find_detections
from quadrig.io.search.effort import EVERY_IMAGE, Effort
from quadrig.io.search.known_lenses import with_known_lenses
from quadrig.io.search.plain_sights import plain_sights
from quadrig.io.search.separate import separate_recordings
from quadrig.io.search.several_recordings import RecordedViews, joined
from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.verdict import out_of_step
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


@dataclass(frozen=True, eq=False)
class Searched:
    """What recordings showed of the rectangles of a rig.toml, ready to be calibrated.

    rectangles: those of the rig.toml, and one more for each further recording in which one that stands still was
    seen. times: ns, of each frameset by index. notes: what was skipped, or found before, in sentences. sights: what
    cameras that saw no rectangle show instead, in sentences. solved: the rig of just these Views, where the search
    had to solve it to know whether the chosen images suffice.
    """

    config: RigConfig
    cameras: tuple[CameraInput, ...]
    rectangles: tuple[Rectangle, ...]
    views: list[View]
    times: list[int]
    notes: list[str]
    sights: Mapping[str, str] = field(default_factory=dict)
    solved: Rig | None = None


@dataclass(frozen=True, eq=False)
class _OneRecording:
    """What one of several recordings showed."""

    shown: RecordedViews
    notes: list[str]
    sights: Mapping[str, str]


def _left_out(camera: RecordedCamera, why: str, images: Sequence[int]) -> str:
    files = camera.source.files
    first = files[images[0]].name if len(files) == camera.frames else f"number {images[0]}"
    count = f"{len(images)} images are" if len(images) > 1 else "1 image is"
    if why == UNREADABLE and (said := camera.source.why_unreadable(images[0])):
        first = f"{first}, {said}"
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

    paths: MCAP files, videos or folders of images. Those of different cameras were recorded together; one that brings
    a camera again is another recording, of the same rig at another time. Cameras that share nothing with the
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

    Where only a share of the images is wanted and in those chosen the cameras are out of step, every image is
    searched: how a rectangle moved, and so by how much clocks are off, only neighbours in time show.
    Raises QuadrigError where there are no images, a camera of the rig.toml is missing, nothing can be read, or
    corners given by hand or lenses do not belong to this recording.
    """
    recordings, cameras, remarks = open_checked(paths, config, effort, lenses or {}, keep_lenses)
    searched = _search_all(recordings, config, effort, cameras, remarks)
    if effort.share >= 1 or not _may_be_out_of_step(searched):
        return searched
    try:
        rig = calibrate_searched(searched)
    except QuadrigError:
        # Clocks that are off can leave no rig at all.
        rig = None
    if rig is not None and not out_of_step(rig):
        return replace(searched, solved=rig)
    remark = (
        "every image was searched, not a share of them: those chosen do not fit together, and where cameras did not "
        "take their pictures at one instant, by how much only the images between show"
    )
    return _search_all(recordings, config, replace(effort, share=1.0), cameras, [*remarks, remark])


def _may_be_out_of_step(searched: Searched) -> bool:
    """Whether several cameras saw rectangles that move."""
    moving = {rectangle.name for rectangle in searched.rectangles if rectangle.moving}
    return len({view.camera for view in searched.views if view.rectangle in moving}) > 1


def _search_all(
    recordings: Sequence[Recording],
    config: RigConfig,
    effort: Effort,
    cameras: Sequence[CameraInput],
    remarks: Sequence[str],
) -> Searched:
    parts = [
        _search_one(recording, config, replace(effort, cache=cache_of(effort.cache, number)))
        for number, recording in enumerate(recordings)
    ]
    rectangles, shown = config.rectangles, parts[0].shown
    if len(parts) > 1:
        rectangles, shown = joined([part.shown for part in parts], cameras, rectangles)
    notes = [*dict.fromkeys(note for part in parts for note in part.notes), *remarks, *without_corners(config)]
    sights = {name: sight for part in parts for name, sight in part.sights.items()}
    seeing = {view.camera for view in shown.views}
    unseen = {name: sight for name, sight in sights.items() if name not in seeing}
    return Searched(config, tuple(cameras), rectangles, list(shown.views), list(shown.times), notes, unseen)


def open_checked(
    paths: Sequence[Path | str] | Path | str,
    config: RigConfig,
    effort: Effort,
    lenses: Mapping[str, KnownLens],
    keep_lenses: bool,
) -> tuple[list[Recording], Sequence[CameraInput], list[str]]:
    """The recordings, their cameras with the lenses known before, and remarks on those: all that can be wrong before
    the search, which takes long, is wrong here. Raises QuadrigError as search_recording does."""
    groups = separate_recordings(paths, effort.rate)
    recordings = [open_described(group, config, effort.rate, several=len(groups) > 1) for group in groups]
    cameras, remarks = with_known_lenses(camera_inputs(recordings, config), lenses, keep_lenses)
    refuse_reference(config, [camera.name for camera in cameras])
    return recordings, cameras, list(remarks)


def _search_one(recording: Recording, config: RigConfig, effort: Effort) -> _OneRecording:
    every = build_framesets(recording, effort.tolerance)
    pointed, outside = corner_views(config.corners, recording, every)
    framesets = choose_frames(recording, every, effort)
    sought = [rectangle for rectangle in config.rectangles if not rectangle.marking.by_hand]
    found = find_detections(recording, framesets, sought, effort)
    views = [*found.views, *pointed]
    sights = plain_sights(recording, framesets, views, sought, effort)
    left_out = [
        _left_out(recording.camera(name), why, images)
        for name, reasons in found.left_out.items()
        for why, images in reasons.items()
    ]
    kept = [f"{found.reused} images were searched before; what was kept of them is used"] if found.reused else []
    shown = RecordedViews(recording.paths[0].stem, views, framesets.times.tolist())
    return _OneRecording(shown, [*recording.notes, *found.remarks, *outside, *left_out, *kept], sights)


def cache_of(cache: Path | None, number: int) -> Path | None:
    """A file of each recording's own: rig.detections.mcap, rig-2.detections.mcap, ..."""
    if cache is None or number == 0:
        return cache
    head, dot, rest = cache.name.partition(".")
    return cache.with_name(f"{head}-{number + 1}{dot}{rest}")


def open_described(
    paths: Sequence[Path | str] | Path | str, config: RigConfig, rate: float | None = None, *, several: bool = False
) -> Recording:
    """The recording with the cameras of rig.toml.

    Where a [[camera]] names its topic, the tables choose: the others are left out, which is said. Else the tables
    only add what is known of a camera, and every camera of the recording is used. several: it is one of several, and
    need not have all of them.
    """
    if several:
        config = replace(config, cameras=_cameras_of(config, open_recording(paths, rate=rate)))
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


def _cameras_of(config: RigConfig, recording: Recording) -> tuple[CameraConfig, ...]:
    """The [[camera]] tables that are of a recording."""
    there = {name for one in recording.cameras for name in (one.name, one.topic, Path(one.topic).name)}
    return tuple(camera for camera in config.cameras if (camera.topic or camera.name) in there)


def calibrate_searched(searched: Searched) -> Rig:
    """The rig that the Views of a recording show. Raises QuadrigError as calibrate does."""
    if searched.solved is not None:
        return searched.solved
    config, sights = searched.config, searched.sights
    try:
        rig = calibrate(searched.cameras, searched.rectangles, searched.views, config.reference)
    except QuadrigError as error:
        raise QuadrigError("; ".join([str(error), *dict.fromkeys(sights.values())])) from error
    return replace(rig, missing={name: sights.get(name, why) for name, why in rig.missing.items()})


def camera_inputs(recordings: Sequence[Recording], config: RigConfig) -> list[CameraInput]:
    """What is known of each camera: from rig.toml first, else the lens that a recording brings as a first guess.

    Raises QuadrigError where a camera's pictures have another size in another recording.
    """
    inputs: dict[str, CameraInput] = {}
    for recording in recordings:
        for camera in recording.cameras:
            known = config.camera_input(camera.name, camera.width, camera.height)
            known = known if known.intrinsics is not None else replace(known, intrinsics=camera.prior)
            before = inputs.setdefault(camera.name, known)
            if (before.width, before.height) != (camera.width, camera.height):
                raise QuadrigError(
                    f"{recording.paths[0]}: camera {camera.name!r} has pictures of {camera.width}x{camera.height}, "
                    f"in another recording of {before.width}x{before.height}; calibrate each size by itself"
                )
            if before.intrinsics is None:
                inputs[camera.name] = known
    return list(inputs.values())


def refuse_missing(rig: Rig) -> None:
    """Raises QuadrigError, naming each, where cameras could not be brought into the rig."""
    if rig.missing:
        raise QuadrigError("; ".join(rig.missing.values()) + "; or accept a rig without them, without --all-cameras")
