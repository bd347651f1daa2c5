"""Turn videos and folders of images into an MCAP recording that any tool opens."""

import csv
import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Literal

import cv2
import numpy as np

from quadrig.io.progress import progress_bar
from quadrig.io.recording.image_folder import ImageFiles
from quadrig.io.recording.image_message import ROS2_DEFINITIONS
from quadrig.io.recording.image_source import Stamped
from quadrig.io.recording.recorded_cameras import RecordedCamera
from quadrig.io.topic_writer import TopicWriter
from quadrig.io.whole_file import written_beside
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError

MessageFormat = Literal["foxglove", "ros2"]
ImageFormat = Literal["jpeg", "png"]

_COLUMNS = ("cam_id", "frame_index", "frame_time")
# Files of these kinds go into the recording as they are, to the last bit.
_COPIED = {"jpg": "jpeg", "jpeg": "jpeg", "png": "png"}
# PNG's first level is three times faster than its default and 5 % larger on photographs.
_PNG_LEVEL = 1


@dataclass(frozen=True)
class Recorded:
    """What was written: images and bytes by camera; unreadable: images that had to be skipped."""

    images: dict[str, int]
    bytes: int
    unreadable: int
    encoded: dict[str, str]


def record(
    cameras: Sequence[RecordedCamera],
    output: Path,
    messages: MessageFormat = "foxglove",
    images: ImageFormat = "jpeg",
    quality: int = 95,
    progress: bool = True,
) -> Recorded:
    """Write the images of these cameras, in the order of their time, on /NAME/image_raw/compressed.

    JPEG and PNG files are copied as they are; what is decoded (videos, other files) is encoded as `images`, JPEG with
    this quality. Raises QuadrigError where the file cannot be written.
    """
    counts = {camera.name: 0 for camera in cameras}
    encoded: dict[str, str] = {}
    size = unreadable = 0
    with written_beside(output) as beside, beside.open("wb") as stream:
        write, finish = image_writer(stream, messages)
        total = sum(camera.frames for camera in cameras)
        with progress_bar("record", total, "images", quiet=not progress) as advance:
            streams = [_encoded(k, camera, images, quality) for k, camera in enumerate(cameras)]
            for stamp, k, _, form, data in heapq.merge(*streams, key=lambda entry: entry[:3]):
                advance(1)
                if not data:
                    unreadable += 1
                    continue
                name = cameras[k].name
                write(name, stamp, form, data)
                counts[name] += 1
                encoded[name] = form
                size += len(data)
        finish()
    return Recorded(counts, size, unreadable, encoded)


def with_timestamps(cameras: Sequence[RecordedCamera], table: Path) -> list[RecordedCamera]:
    """The cameras with the time stamps of a CSV with columns cam_id, frame_index and frame_time (seconds).

    A cam_id is a camera's name, or the number that its name ends with. Rows are matched to images by frame_index
    where it counts from 0, else in its order. Raises QuadrigError where table and cameras do not fit together.
    """
    rows = _read_table(table)
    result = []
    for camera in cameras:
        mine = rows.get(_table_name(camera.name, rows))
        if not mine:
            known = ", ".join(rows)
            raise QuadrigError(f"{table}: no rows for camera {camera.name!r}; it has cam_id {known}")
        result.append(_with_stamps(camera, sorted(mine), table))
    return result


def _with_stamps(camera: RecordedCamera, rows: list[tuple[int, int]], table: Path) -> RecordedCamera:
    indices, stamps = (np.array(column, np.int64) for column in zip(*rows, strict=True))
    if len(rows) == camera.frames:
        indices = np.arange(camera.frames)
    elif indices[0] < 0 or indices[-1] >= camera.frames or np.any(np.diff(indices) == 0):
        raise QuadrigError(
            f"{table}: camera {camera.name!r} has {camera.frames} images but {len(rows)} rows, up to frame_index "
            f"{indices[-1]}; give the table of these videos"
        )
    return replace(camera, source=Stamped(camera.source.part(indices), stamps))


def _encoded(
    number: int, camera: RecordedCamera, form: ImageFormat, quality: int
) -> Iterator[tuple[int, int, int, str, bytes]]:
    """Stamp, camera's number, image's number, format and bytes of each image; no bytes where it is unreadable."""
    source = camera.source.source if isinstance(camera.source, Stamped) else camera.source
    # heapq.merge needs rising stamps from each camera.
    order = np.argsort(camera.stamps, kind="stable")
    if isinstance(source, ImageFiles) and source.encoding in _COPIED:
        for k in order.tolist():
            yield int(camera.stamps[k]), number, k, _COPIED[source.encoding], source.paths[k].read_bytes()
        return
    rising = bool(np.all(np.diff(order) > 0))
    parts = [camera.source] if rising else (camera.source.part(np.array([k])) for k in order)
    images = (image for part in parts for image in part.images(gray=False))
    for k, image in zip(order.tolist(), images, strict=True):
        data = b"" if image is None else _encode(image, form, quality)
        yield int(camera.stamps[k]), number, k, form, data


def _encode(image: Picture, form: ImageFormat, quality: int) -> bytes:
    if form == "jpeg":
        return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])[1].tobytes()


Write = Callable[[str, int, str, bytes], None]


def image_writer(stream: BinaryIO, messages: MessageFormat) -> tuple[Write, Callable[[], None]]:
    """How to write one image (camera, stamp ns, format, bytes), and how to finish."""
    # What is JPEG or PNG does not get smaller: chunks without compression can be read in any place.
    if messages == "ros2":
        from mcap.writer import CompressionType
        from mcap_ros2.writer import Writer as Ros2Writer

        ros2 = Ros2Writer(stream, compression=CompressionType.NONE)
        name = "sensor_msgs/msg/CompressedImage"
        schema = ros2.register_msgdef(name, ROS2_DEFINITIONS[name])

        def write_ros2(camera: str, stamp: int, form: str, data: bytes) -> None:
            seconds, nanoseconds = divmod(stamp, 10**9)
            header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": camera}
            message = {"header": header, "format": form, "data": data}
            ros2.write_message(_topic(camera), schema, message, stamp, stamp)

        return write_ros2, ros2.finish
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    foxglove = TopicWriter(stream)

    def write_foxglove(camera: str, stamp: int, form: str, data: bytes) -> None:
        message: Any = CompressedImage(frame_id=camera, format=form, data=data)
        message.timestamp.FromNanoseconds(stamp)
        foxglove.write_protobuf(_topic(camera), message, stamp)

    return write_foxglove, foxglove.finish


def _topic(camera: str) -> str:
    return f"/{camera}/image_raw/compressed"


def _read_table(table: Path) -> dict[str, list[tuple[int, int]]]:
    """Frame index and time (ns) of each row, by cam_id."""
    rows: dict[str, list[tuple[int, int]]] = {}
    try:
        with table.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            missing = [column for column in _COLUMNS if column not in (reader.fieldnames or [])]
            if missing:
                raise QuadrigError(f"{table}: no column {missing[0]}; it needs {', '.join(_COLUMNS)}")
            for row in reader:
                entry = int(row["frame_index"]), _nanoseconds(row["frame_time"])
                rows.setdefault(row["cam_id"].strip(), []).append(entry)
    except (ValueError, TypeError, AttributeError) as error:
        raise QuadrigError(f"{table}: a row is not numbers ({error}); give whole rows") from error
    except OSError as error:
        raise QuadrigError(f"{table}: cannot be read ({error.strerror}); give a table of time stamps") from error
    return rows


def _nanoseconds(seconds: str) -> int:
    """Whole nanoseconds: a float of seconds since 1970 would lose all below 0.2 microseconds."""
    from decimal import Decimal, InvalidOperation

    try:
        return int(Decimal(seconds.strip()).scaleb(9))
    except InvalidOperation as error:
        raise ValueError(f"{seconds!r} is no time") from error


def _table_name(camera: str, rows: Mapping[str, Any]) -> str:
    """The cam_id of a camera: its name, or the number that its name ends with."""
    if camera in rows:
        return camera
    digits = camera[len(camera.rstrip("0123456789")) :]
    return next((one for one in rows if digits and one.isdigit() and int(one) == int(digits)), "")
