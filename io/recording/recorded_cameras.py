"""Recordings: which cameras they hold, and their images, be they MCAP files, videos or folders of images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quadrig.io.plain_words import plain_name
from quadrig.io.recording.camera import RecordedCamera, camera_name, camera_of_source
from quadrig.io.recording.image_folder import (
    IMAGE_SUFFIXES,
    ImageFiles,
    folder_images,
    image_files,
    one_image,
    pattern_images,
    read_image_folder,
)
from quadrig.io.recording.messages.image_message import holds_images
from quadrig.io.recording.messages.mcap_reader import index_mcap
from quadrig.io.recording.messages.ros_bag import index_bag, is_bag
from quadrig.io.recording.picture_times import with_times
from quadrig.io.recording.topic_cameras import cameras_of_mcaps
from quadrig.io.recording.video import VIDEO_SUFFIXES, read_video
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError


@dataclass(frozen=True, eq=False)
class Recording:
    """Cameras that recorded together.

    paths: as they were given; files: the MCAP files, videos and folders of images that were found there and hold
    images. notes: what was not used, or used in a way worth knowing, in sentences.
    """

    paths: tuple[Path, ...]
    files: tuple[Path, ...]
    cameras: tuple[RecordedCamera, ...]
    notes: tuple[str, ...] = ()
    indexed: bool = True
    other_topics: tuple[tuple[str, str, int], ...] = ()

    def camera(self, name: str) -> RecordedCamera:
        """The camera of that name. Raises KeyError."""
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise KeyError(name)

    def frame(self, camera: str, index: int, gray: bool = False) -> Picture:
        """One image, (H, W, 3) BGR or (H, W) grey uint8. Raises QuadrigError where it cannot be read."""
        image = next(self.camera(camera).source.part(np.array([index])).images(gray), None)
        if image is None:
            raise QuadrigError(f"{self.paths[0]}: image {index} of camera {camera!r} cannot be read; leave it out")
        return image


def open_recording(
    paths: Sequence[Path | str] | Path | str,
    topics: Mapping[str, str | None] | None = None,
    rate: float | None = None,
) -> Recording:
    """Open MCAP files and bags of ROS (parts of one recording), videos, folders of images and single images as one
    recording.

    A path with {camera} in it is a pattern of image files, such as pictures/camera_{camera}_*.jpg.
    topics: the cameras wanted, by name, each with its topic (or the path of its video or folder), or None where the
    name says it; without any, every image topic, video and folder is a camera. rate: pictures a second of cameras
    whose image files carry no time.
    Raises QuadrigError where a path cannot be read, a wanted camera is missing or nothing is a camera.
    """
    given = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    if not given:
        raise QuadrigError("no recording given; name an MCAP file, videos or folders of images")
    notes: list[str] = []
    cameras, files, mcaps = [], [], []
    for path in given:
        if _is_pattern(path):
            found = cameras_of_pattern(path, notes)
            cameras += found
            files += [file for camera in found for file in _picture_files(camera)]
            continue
        for part in _expand(path):
            if is_bag(part):
                mcaps.append(part)
            elif part.is_dir() or part.suffix.lower() in VIDEO_SUFFIXES | IMAGE_SUFFIXES:
                cameras.append(_camera_of_files(part, notes))
                files.append(part)
            else:
                mcaps.append(part)
    indexes = [index_bag(path) if is_bag(path) else index_mcap(path) for path in mcaps]
    for index in indexes:
        if index.note:
            notes.append(f"{index.path}: {index.note}; what is whole is used")
    of_topics, others = cameras_of_mcaps(indexes, topics or {}, notes)
    chosen = with_times(_choose([*of_topics, *cameras], topics or {}, given, notes), rate, notes)
    indexed = all(index.indexed for index in indexes)
    files += [index.path for index in indexes if any(holds_images(one.encoding, one.schema) for one in index.topics)]
    return Recording(tuple(given), tuple(files), tuple(chosen), tuple(notes), indexed, others)


def is_result(path: Path) -> bool:
    """Whether a file's name is that of a rig or of kept detections, which often lie beside recordings."""
    return path.name == "rig.mcap" or path.name.endswith((".rig.mcap", ".detections.mcap"))


def _expand(path: Path) -> list[Path]:
    """A folder of MCAP files, of videos or of image folders is each of them."""
    if not path.exists():
        raise QuadrigError(f"{path}: no such file or folder; name an MCAP file, videos or folders of images")
    if not path.is_dir():
        return [path]
    if folder_images(path) or is_bag(path):
        return [path]
    inside = sorted(path.iterdir())
    mcaps = [p for p in inside if (p.suffix.lower() == ".mcap" and not is_result(p)) or is_bag(p)]
    videos = [p for p in inside if p.suffix.lower() in VIDEO_SUFFIXES]
    folders = [p for p in inside if p.is_dir() and folder_images(p)]
    parts = mcaps or [*videos, *folders]
    if not parts:
        raise QuadrigError(f"{path}: no recording in this folder; give MCAP files, videos or folders of images")
    return parts


def _camera_of_files(path: Path, notes: list[str]) -> RecordedCamera:
    if path.is_dir():
        source, name = read_image_folder(path, notes), plain_name(path.name)
    elif path.suffix.lower() in IMAGE_SUFFIXES:
        source, name = one_image(path), plain_name(path.stem)
    else:
        source, name = read_video(path), plain_name(path.stem)
    return camera_of_source(name, str(path), source)


def _is_pattern(path: Path) -> bool:
    return "{camera}" in str(path) and not path.exists()


def cameras_of_pattern(pattern: Path, notes: list[str]) -> list[RecordedCamera]:
    """The cameras of a pattern with {camera} in it; notes: as image_files has it. Raises QuadrigError without any."""
    found = pattern_images(pattern)
    if not found:
        raise QuadrigError(f"{pattern}: no image file matches; {{camera}} stands for a camera's name, * for the rest")
    where = str(pattern)
    return [
        camera_of_source(name, where.replace("{camera}", name), image_files(paths, f"camera {name!r}", notes))
        for name, paths in found.items()
    ]


def camera_of_pattern(name: str, folder: Path, pattern: str, notes: list[str]) -> RecordedCamera:
    """A camera from the image files that match a pattern, such as left*.jpg. Raises QuadrigError where none do."""
    paths = [path for path in folder.glob(pattern) if path.suffix.lower() in IMAGE_SUFFIXES]
    if not paths:
        raise QuadrigError(f"{folder / pattern}: no image file matches; check the pattern of camera {name!r}")
    return camera_of_source(name, str(folder / pattern), image_files(paths, f"camera {name!r}", notes))


def _picture_files(camera: RecordedCamera) -> tuple[Path, ...]:
    return camera.source.paths if isinstance(camera.source, ImageFiles) else ()


def _choose(
    cameras: Sequence[RecordedCamera], wanted: Mapping[str, str | None], paths: Sequence[Path], notes: list[str]
) -> list[RecordedCamera]:
    where = ", ".join(str(path) for path in paths)
    if not cameras:
        raise QuadrigError(
            f"{where}: no images in this recording{_because(notes)}; record the cameras' image topics, or give videos"
        )
    if not wanted:
        return _one_of_each_name(cameras, notes)
    chosen = []
    for name, topic in wanted.items():
        fits = [camera for camera in cameras if _is_wanted(camera, name, topic)]
        if not fits:
            there = ", ".join(camera.topic for camera in cameras)
            what = f"topic {topic}" if topic else "topic"
            raise QuadrigError(f"{where}: no {what} for camera {name!r}; the images are on {there}")
        chosen.append(replace(_one_of_each_name(fits, notes)[0], name=name))
    used = {camera_name(camera.topic) for camera in chosen} | {camera.topic for camera in chosen}
    left = {camera.name for camera in cameras if camera.name not in used and camera.topic not in used}
    if left:
        notes.append(f"not asked for, and left out: {', '.join(sorted(left))}; name them in a [[camera]] to use them")
    return chosen


def _because(notes: Sequence[str]) -> str:
    return f" ({'; '.join(notes)})" if notes else ""


def _is_wanted(camera: RecordedCamera, name: str, topic: str | None) -> bool:
    if topic is None:
        return camera.name == name
    # A video or folder may be named without the path that leads to it.
    return camera.topic == topic or (topic in (Path(camera.topic).name, camera.name) and "/" not in topic)


def _one_of_each_name(cameras: Sequence[RecordedCamera], notes: list[str]) -> list[RecordedCamera]:
    """Of one camera's several topics (raw and compressed) the one with the most images; of equals the least coded."""
    best: dict[str, RecordedCamera] = {}
    for camera in sorted(cameras, key=lambda one: (-one.frames, len(one.topic.split("/")), one.topic)):
        if camera.name not in best:
            best[camera.name] = camera
        else:
            used = best[camera.name].topic
            notes.append(f"camera {camera.name!r}: {camera.topic} shows the same as {used} and is not used")
    return [best[name] for name in sorted(best)]
