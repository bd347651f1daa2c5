"""Recordings: which cameras they hold, and their images, be they MCAP files, videos or folders of images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from quadrig.io.recording.decode_image import decode_image, is_depth
from quadrig.io.recording.image_folder import IMAGE_SUFFIXES, folder_images, image_files, one_image, read_image_folder
from quadrig.io.recording.image_message import holds_images, holds_lenses, holds_video, read_lens
from quadrig.io.recording.image_source import ImageSource, McapImages
from quadrig.io.recording.mcap_messages import McapMessages
from quadrig.io.recording.mcap_reader import McapIndex, TopicMessages, index_mcap
from quadrig.io.recording.video import VIDEO_SUFFIXES, McapVideo, read_video
from quadrig.single.arrays import Ints, Picture
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

_NAME_WORDS = ("image_raw", "image", "compressed", "camera_info")
# A broken first image or two happen when a recording is started; more in a row are no stream of images.
_FIRST_IMAGES = 5


@dataclass(frozen=True, eq=False)
class RecordedCamera:
    """One camera of a recording.

    topic: of an MCAP recording, else the path of the video or folder. width, height: px, of its first image.
    prior: the lens that the recording brings along, if any. frames: how many images it has.
    """

    name: str
    topic: str
    width: int
    height: int
    source: ImageSource
    prior: Intrinsics | None = None

    @property
    def frames(self) -> int:
        """How many images there are."""
        return len(self.source)

    @property
    def encoding(self) -> str:
        """How the images are stored: jpeg, png, bgr8, h264..."""
        return self.source.encoding

    @cached_property
    def stamps(self) -> Ints:
        """Time of each image (F,) int64 ns."""
        return self.source.stamps()


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
    paths: Sequence[Path | str] | Path | str, topics: Mapping[str, str | None] | None = None
) -> Recording:
    """Open MCAP files (parts of one recording), videos, folders of images and single images as one recording.

    topics: the cameras wanted, by name, each with its topic (or the path of its video or folder), or None where the
    name says it; without any, every image topic, video and folder is a camera.
    Raises QuadrigError where a path cannot be read, a wanted camera is missing or nothing is a camera.
    """
    given = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    if not given:
        raise QuadrigError("no recording given; name an MCAP file, videos or folders of images")
    parts = [part for path in given for part in _expand(path)]
    files = [part for part in parts if part.is_dir() or part.suffix.lower() in VIDEO_SUFFIXES | IMAGE_SUFFIXES]
    cameras = [_camera_of_files(path) for path in files]
    notes: list[str] = []
    indexes = [index_mcap(path) for path in parts if path not in files]
    for index in indexes:
        if index.note:
            notes.append(f"{index.path}: {index.note}; what is whole is used")
    found, others = _cameras_of_mcaps(indexes, topics or {}, notes)
    chosen = _choose([*found, *cameras], topics or {}, given, notes)
    indexed = all(index.indexed for index in indexes)
    files += [index.path for index in indexes if any(holds_images(one.encoding, one.schema) for one in index.topics)]
    return Recording(tuple(given), tuple(files), tuple(chosen), tuple(notes), indexed, others)


def is_result(path: Path) -> bool:
    """Whether a file's name is that of a rig or of kept detections, which often lie beside recordings."""
    return path.name == "rig.mcap" or path.name.endswith((".rig.mcap", ".detections.mcap"))


def camera_name(topic: str) -> str:
    """A camera's name: its topic without the trailing image_raw, image, compressed, camera_info words.

    /cam0/image_raw/compressed is cam0; where nothing else is left the camera is called camera.
    """
    words = [word for word in topic.split("/") if word]
    while words and words[-1] in _NAME_WORDS:
        words.pop()
    return "/".join(words) or "camera"


def _expand(path: Path) -> list[Path]:
    """A folder of MCAP files, of videos or of image folders is each of them."""
    if not path.exists():
        raise QuadrigError(f"{path}: no such file or folder; name an MCAP file, videos or folders of images")
    if not path.is_dir():
        return [path]
    if folder_images(path):
        return [path]
    inside = sorted(path.iterdir())
    mcaps = [p for p in inside if p.suffix.lower() == ".mcap" and not is_result(p)]
    videos = [p for p in inside if p.suffix.lower() in VIDEO_SUFFIXES]
    folders = [p for p in inside if p.is_dir() and folder_images(p)]
    parts = mcaps or [*videos, *folders]
    if not parts:
        raise QuadrigError(f"{path}: no recording in this folder; give MCAP files, videos or folders of images")
    return parts


def _camera_of_files(path: Path) -> RecordedCamera:
    if path.is_dir():
        source, name = read_image_folder(path), path.name
    elif path.suffix.lower() in IMAGE_SUFFIXES:
        source, name = one_image(path), path.stem
    else:
        source, name = read_video(path), path.stem
    return camera_of_source(name, str(path), source)


def camera_of_source(name: str, topic: str, source: ImageSource) -> RecordedCamera:
    """A camera from where its images are. Raises QuadrigError where none of the first can be read."""
    first = source.part(np.arange(min(_FIRST_IMAGES, len(source))))
    image = next((image for image in first.images() if image is not None), None)
    if image is None:
        raise QuadrigError(f"{topic}: none of its first images can be read; is it a recording of images?")
    return RecordedCamera(name, topic, image.shape[1], image.shape[0], source)


def camera_of_pattern(name: str, folder: Path, pattern: str) -> RecordedCamera:
    """A camera from the image files that match a pattern, such as left*.jpg. Raises QuadrigError where none do."""
    paths = [path for path in folder.glob(pattern) if path.suffix.lower() in IMAGE_SUFFIXES]
    if not paths:
        raise QuadrigError(f"{folder / pattern}: no image file matches; check the pattern of camera {name!r}")
    return camera_of_source(name, str(folder / pattern), image_files(paths))


def _cameras_of_mcaps(
    indexes: Sequence[McapIndex], wanted: Mapping[str, str | None], notes: list[str]
) -> tuple[list[RecordedCamera], tuple[tuple[str, str, int], ...]]:
    """Cameras of the image topics, and the other topics: name, schema, messages."""
    groups: dict[str, list[TopicMessages]] = {}
    others: dict[str, tuple[str, str, int]] = {}
    priors: dict[str, TopicMessages] = {}
    for topic in (topic for index in indexes for topic in index.topics):
        if holds_images(topic.encoding, topic.schema) and len(topic):
            groups.setdefault(topic.topic, []).append(topic)
            continue
        if holds_lenses(topic.encoding, topic.schema) and len(topic):
            priors.setdefault(camera_name(topic.topic), topic)
        _, _, before = others.get(topic.topic, ("", "", 0))
        others[topic.topic] = (topic.topic, topic.schema or topic.encoding, before + len(topic))
    cameras = []
    asked = {topic for topic in wanted.values() if topic}
    for name, topics in sorted(groups.items()):
        camera = _camera_of_topic(name, topics, name in asked, notes)
        if camera is None:
            others[name] = (name, topics[0].schema, sum(len(topic) for topic in topics))
        else:
            cameras.append(_with_prior(camera, priors, notes))
    return cameras, tuple(others[name] for name in sorted(others))


def _camera_of_topic(
    name: str, topics: Sequence[TopicMessages], asked: bool, notes: list[str]
) -> RecordedCamera | None:
    messages = McapMessages.of(topics)
    reason = "there are none"
    with messages.opened() as opened:
        for index in range(min(_FIRST_IMAGES, len(messages))):
            try:
                coded = opened.image(index)
                if is_depth(coded.encoding) and not asked:
                    notes.append(f"topic {name} holds depths ({coded.encoding}), not images, and is not used")
                    return None
                if holds_video(messages.schema):
                    return camera_of_source(camera_name(name), name, McapVideo(messages, coded.encoding))
                height, width = decode_image(coded).shape
            except ValueError as error:
                reason = str(error)
                continue
            return RecordedCamera(camera_name(name), name, width, height, McapImages(messages, coded.encoding))
    notes.append(f"topic {name} is not used: its images cannot be read ({reason})")
    return None


def _with_prior(camera: RecordedCamera, priors: Mapping[str, TopicMessages], notes: list[str]) -> RecordedCamera:
    topic = priors.get(camera.name)
    if topic is None:
        return camera
    try:
        with McapMessages.of([topic]).opened() as opened:
            lens, remark = read_lens(topic.encoding, topic.schema, opened.data(0))
    except ValueError:
        notes.append(f"topic {topic.topic} cannot be read; camera {camera.name!r} has no lens to begin with")
        return camera
    if remark:
        notes.append(f"camera {camera.name!r}: {remark}")
    if lens is not None and (lens.width, lens.height) != (camera.width, camera.height):
        notes.append(
            f"camera {camera.name!r}: {topic.topic} is for {lens.width}x{lens.height} images, its images are "
            f"{camera.width}x{camera.height}; the lens is not used"
        )
        return camera
    return camera if lens is None else replace(camera, prior=lens)


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
