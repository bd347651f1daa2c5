"""Detections kept: an MCAP of ImageAnnotations for the eye and of our own exact record for the next solve.

They are found again only for the same pictures, topic, rectangles and detector: anything else is searched anew.
"""

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import msgspec
import numpy as np

from quadrig.io.file_kind import RECORDING, file_kind, is_written_here
from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.image_folder import IMAGE_SUFFIXES
from quadrig.io.recording.messages.image_message import holds_images
from quadrig.io.recording.messages.mcap_reader import McapBytes, McapIndex, index_mcap
from quadrig.io.rig_file.rig_mcap import RIG_TOPIC
from quadrig.io.rig_file.view_record import ViewRecord, recorded_view, view_record
from quadrig.io.safe_json import read_json
from quadrig.io.topic_writer import TopicWriter
from quadrig.io.whole_file import cannot_write, new_part, place_held
from quadrig.single.arrays import Ints
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.registry import marking_values
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

DETECTIONS_TOPIC = "/quadrig/detections"
FORMAT = 5
"""Raised when this record changes, so that old files are not taken for new ones."""

# Of a recording or video, so many bytes from both ends distinguish it from another of the same size and time.
_ENDS = 1 << 16
# Of a rectangle: what no picture of it shows.
_NOT_SEEN = ("moving", "body", "body_from_rect", "layout_sigma", "sheet")
# The sources of what makes detections of a picture: reading it, and searching it.
_DETECTOR = ("single", "io/recording")


class ImageRecord(msgspec.Struct):
    """What was found in one image of one camera; views is None where the image was left out, why says the reason."""

    key: str
    camera: str
    image: int
    stamp: int
    views: list[ViewRecord] | None
    why: str = ""


Found = dict[tuple[str, int], tuple[View, ...] | str]
"""Views by camera and image; where the image was left out, why."""


def camera_key(camera: RecordedCamera, rectangles: Sequence[Rectangle]) -> str:
    """What detections in a camera's images depend on, as a short word: files, topic, markings, detector."""
    files = [_file_mark(path) for path in camera.source.files]
    # Where it stands, or whether it moves, changes nothing of what is seen.
    sheets = [{k: v for k, v in _plain(one).items() if k not in _NOT_SEEN} for one in rectangles]
    shape = [camera.width, camera.height, camera.frames, camera.encoding]
    mark = [FORMAT, detector_version(), files, camera.topic, shape, sheets]
    return hashlib.blake2b(msgspec.json.encode(mark), digest_size=12).hexdigest()


@cache
def detector_version() -> str:
    """Changes with every change of what makes detections of pictures: our sources, and OpenCV."""
    digest = hashlib.blake2b(cv2.__version__.encode(), digest_size=12)
    # Where it is run from its sources, those are enough.
    with suppress(PackageNotFoundError):
        digest.update(version("quadrig").encode())
    root = Path(__file__).resolve().parents[2]
    for folder in _DETECTOR:
        for source in sorted((root / folder).rglob("*.py")):
            digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()


def detections_beside(result: Path) -> Path:
    """Where the detections behind a result are kept: rig.detections.mcap beside rig.mcap."""
    return result.with_suffix(".detections.mcap")


def read_detections(path: Path, keys: Mapping[str, str], set_aside: bool = True) -> tuple[Found, list[str]]:
    """What is kept in the file for cameras with these keys; nothing where there is no such file, or only others.

    A damaged file gives what is whole of it, and where set_aside, is set aside, which the sentence returned says.
    Raises QuadrigError where the file is something else, which writing would destroy.
    """
    if file_kind(path) not in (None, RECORDING) and not _may_be_damaged(path):
        raise QuadrigError(f"{path} is {file_kind(path)}, not kept detections; give another file with --cache")
    found: Found = {}
    remarks = []
    for kept in (path, _partial(path.resolve())):
        try:
            index = index_mcap(kept) if kept.is_file() else None
        except QuadrigError:
            remarks += [_set_aside(kept, 0)] if kept == path and set_aside else []
            continue
        if index is None:
            continue
        if kept == path and not _is_ours(index):
            raise QuadrigError(f"{kept} is a recording or a rig, not kept detections; give another file with --cache")
        lost = 0
        for record, views in _records(index):
            if record is None:
                lost += 1
            elif keys.get(record.camera) == record.key:
                found[record.camera, record.image] = views
        # A file that a killed run left is cut off as a matter of course.
        damaged = lost or index.note or all(topic.topic != DETECTIONS_TOPIC for topic in index.topics)
        if kept == path and damaged and set_aside:
            remarks.append(_set_aside(path, lost))
    return found, remarks


def _may_be_damaged(path: Path) -> bool:
    """Whether what is no MCAP by its beginning was one: its name says so, and it is nothing else that is known."""
    return path.suffix == ".mcap" and file_kind(path) in ("another file", "a text")


def _is_ours(index: McapIndex) -> bool:
    """Whether an MCAP, damaged or whole, may be kept detections: it has such, or nothing that can be read."""
    if any(topic.topic == RIG_TOPIC or holds_images(topic.encoding, topic.schema) for topic in index.topics):
        return False
    names = [topic.topic for topic in index.topics]
    ours = DETECTIONS_TOPIC in names or all(name.endswith("/annotations") for name in names)
    return ours or is_written_here(index.path)


def _set_aside(path: Path, lost: int) -> str:
    aside = path.with_name(f"{path.name}.damaged-{time.strftime('%Y%m%d-%H%M%S')}")
    path.replace(aside)
    what = f"{lost} of its records cannot be read" if lost else "it cannot be read to its end"
    return f"{path} was damaged ({what}): what is whole is used, and the damaged file is now {aside.name}"


class DetectionWriter:
    """Writes what was found, image by image. Made by `keep_detections`."""

    def __init__(self, stream: BinaryIO, keys: Mapping[str, str]) -> None:
        self._keys = keys
        self._writer = TopicWriter(stream, "lz4")
        self._writer.declare_json(DETECTIONS_TOPIC, "quadrig.ImageDetections")

    def write(self, camera: str, image: int, stamp: int, views: tuple[View, ...] | str) -> None:
        """Add one image. views: in words where it was left out."""
        records, why = (None, views) if isinstance(views, str) else ([view_record(view) for view in views], "")
        record = ImageRecord(self._keys[camera], camera, image, stamp, records, why)
        self._writer.write_json(DETECTIONS_TOPIC, msgspec.json.encode(record), stamp)
        if views and not isinstance(views, str):
            self._writer.write_protobuf(f"/{camera}/annotations", _annotations(views, stamp), stamp)

    def flush(self) -> None:
        """Keep what was written so far, also when this process is killed."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()


@contextmanager
def keep_detections(
    path: Path, keys: Mapping[str, str], kept: Found, stamps: Mapping[str, Ints]
) -> Iterator[DetectionWriter]:
    """A DetectionWriter for `path` that has what was kept before; the file appears whole, also when interrupted.

    A process that is killed, or finds no room, leaves a file beside it that the next run reads as far as it goes.
    Raises QuadrigError where it cannot be written.
    """
    with place_held(path) as place:
        partial, fresh = _partial(place), None
        try:
            fresh = new_part(place)
            with fresh.open("wb") as stream:
                writer = DetectionWriter(stream, keys)
                for (camera, image), views in kept.items():
                    writer.write(camera, image, int(stamps[camera][image]), views)
                writer.flush()
                # From here on this file has all that the former partial one had.
                fresh.replace(partial)
                try:
                    yield writer
                finally:
                    writer.finish()
                    stream.close()
                    partial.replace(place)
        except OSError as error:
            # One that names another file is of what was read.
            if error.filename not in (None, str(partial), str(fresh)):
                raise
            left = "; what was found so far is kept for the next run there" if partial.exists() else ""
            raise QuadrigError(f"{cannot_write(path, error)}{left}") from error
        finally:
            if fresh is not None:
                fresh.unlink(missing_ok=True)


def is_unfinished(path: Path) -> bool:
    """Whether a run that was killed left what it had found beside the file."""
    return _partial(path.resolve()).exists()


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


def _records(index: McapIndex) -> Iterator[tuple[ImageRecord | None, tuple[View, ...] | str]]:
    """The records with their Views; None for each that is damaged."""
    with closing(McapBytes(index.path)) as file:
        for topic in index.topics:
            if topic.topic != DETECTIONS_TOPIC:
                continue
            for chunk, offset in zip(topic.chunks.tolist(), topic.offsets.tolist(), strict=True):
                try:
                    record: ImageRecord = read_json(file.message(chunk, offset), ImageRecord)
                    views = _views(record)
                except ValueError:
                    yield None, ()
                else:
                    yield record, views


def _views(record: ImageRecord) -> tuple[View, ...] | str:
    if record.views is None:
        return record.why or "cannot be read"
    return tuple(replace(recorded_view(one), camera=record.camera) for one in record.views)


def _annotations(views: Sequence[View], stamp: int) -> Any:
    from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
    from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

    message = ImageAnnotations()
    for view in views:
        marks = message.points.add(type=PointsAnnotation.POINTS, thickness=4.0)
        marks.timestamp.FromNanoseconds(stamp)
        marks.outline_color.r, marks.outline_color.g, marks.outline_color.b = 0.1, 0.9, 0.4
        marks.outline_color.a = 1.0
        for x, y in np.asarray(view.pixels).tolist():
            marks.points.add(x=x, y=y)
        label = message.texts.add(text=view.rectangle, font_size=14.0)
        label.timestamp.FromNanoseconds(stamp)
        label.position.x, label.position.y = np.asarray(view.pixels).mean(axis=0).tolist()
        label.text_color.r = label.text_color.g = label.text_color.b = label.text_color.a = 1.0
    return message


def _file_mark(path: Path) -> list[object]:
    """What changes with a file's pictures: place, size, time; of a recording or video also both its ends."""
    state = path.stat()
    mark: list[object] = [str(path.resolve()), state.st_size, state.st_mtime_ns]
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return mark
    with path.open("rb") as stream:
        ends = stream.read(_ENDS)
        stream.seek(max(0, state.st_size - _ENDS))
        ends += stream.read(_ENDS)
    return [*mark, hashlib.blake2b(ends, digest_size=12).hexdigest()]


def _plain(rectangle: Rectangle) -> dict[str, Any]:
    return {**asdict(rectangle), "marking": marking_values(rectangle.marking), "body_from_rect": None}
