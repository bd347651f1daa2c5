"""rig.mcap: the result of a calibration as MCAP that any tool opens.

Channels: for each camera foxglove.CameraCalibration on /<camera>/camera_info; /tf with foxglove.FrameTransforms (the
rig frame is the parent of every camera and every rectangle, child_frame_id is its name); for each rectangle its
outline as foxglove.PointCloud, so that viewers that know no rectangle draw it too; and our full record as JSON on
/quadrig/rig and /quadrig/views. rig.toml is an attachment, versions are metadata "quadrig".
"""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from quadrig.io.drawing.geometry import dense_outline
from quadrig.io.file_kind import RIG
from quadrig.io.recording.messages.mcap_reader import McapBytes, McapIndex, index_mcap, is_mcap
from quadrig.io.rig_file.record import (
    RECORD_FORMAT,
    FitRecord,
    RigRecord,
    decode_fit,
    decode_rig,
    encode_fit,
    encode_rig,
)
from quadrig.io.safe_json import read_json
from quadrig.io.topic_writer import TopicWriter
from quadrig.io.whole_file import refuse_no_place, refuse_other_kind, written_beside
from quadrig.rig.result import Camera, PlacedRectangle, Rig, ViewFit
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose

RIG_TOPIC = "/quadrig/rig"
VIEWS_TOPIC = "/quadrig/views"
CONFIG_ATTACHMENT = "rig.toml"

# Points on each side of the outline that a point cloud draws: enough to read as a line at any usual size.
_OUTLINE_POINTS = 60


@dataclass(frozen=True, eq=False)
class RigFile:
    """What a rig.mcap holds: the Rig, the rig.toml it was made with, the times (ns since 1970) of its framesets by
    index (empty where unknown), the version of quadrig that wrote it, and the names of the recordings it was made
    from."""

    rig: Rig
    config_text: str = ""
    times: tuple[int, ...] = ()
    version: str = ""
    recordings: tuple[str, ...] = ()


def is_rig_file(path: Path) -> bool:
    """Whether a file is an MCAP with a Rig in it. Raises QuadrigError where it is an MCAP that cannot be read."""
    return path.is_file() and is_mcap(path) and any(one.topic == RIG_TOPIC for one in index_mcap(path).topics)


def refuse_no_rig(path: Path) -> None:
    """Raises QuadrigError where no rig may be written: as refuse_no_place does, and over whatever is no rig. A result
    can be made again; what a camera saw cannot."""
    refuse_no_place(path)
    refuse_other_kind(path, RIG)


def write_rig(
    path: Path | str,
    rig: Rig,
    config_text: str = "",
    times: Sequence[int] = (),
    recordings: Sequence[Path | str] = (),
) -> None:
    """Write a Rig to an MCAP file, whole or not at all.

    config_text: the rig.toml as the user wrote it. times: ns since 1970 of each frameset, by index; one microsecond
    apart from zero where not given. recordings: what it was made from; the names are kept, without their folders.
    Raises QuadrigError where the file cannot be written, as refuse_no_rig does too.
    """
    refuse_no_rig(Path(path))
    known = tuple(int(time) for time in times)
    times = known or _invented_times(rig)
    first = min(times, default=0)
    with written_beside(path) as beside, beside.open("wb") as stream:
        # The record repeats itself much (the same board points in each View): zstd takes it to a quarter.
        writer = TopicWriter(stream, "zstd", "quadrig")
        for camera in (*rig.cameras, *(camera for _, camera in rig.lens_only)):
            writer.write_protobuf(f"/{camera.name}/camera_info", _calibration(camera, first), first)
        for time, transforms in _transforms(rig, times):
            writer.write_protobuf("/tf", transforms, time)
        for placed in rig.rectangles:
            writer.write_protobuf(f"/{placed.name}/outline", _outline(placed, first), first)
        _write_record(writer, rig, times, known)
        writer.attach(CONFIG_ATTACHMENT, "application/toml", config_text.encode(), first)
        names = msgspec.json.encode([Path(recording).name for recording in recordings]).decode()
        # Loaded when it is used, for it looks through what is installed.
        from quadrig.io.version import __version__

        writer.add_metadata("quadrig", {"version": __version__, "record": str(RECORD_FORMAT), "recordings": names})
        writer.finish()


def read_rig(path: Path | str) -> Rig:
    """The Rig of a rig.mcap. Raises QuadrigError where the file is absent, no MCAP, or holds no rig."""
    return read_rig_file(path).rig


def read_rig_file(path: Path | str) -> RigFile:
    """All that a rig.mcap holds. Raises QuadrigError where the file is absent, no MCAP, or holds no rig."""
    from mcap.records import Attachment, Metadata
    from mcap.stream_reader import StreamReader

    path = Path(path)
    if not path.is_file():
        raise QuadrigError(f"there is no file {path}; give the rig.mcap that `rig calibrate` wrote")
    try:
        index = index_mcap(path)
        if index.note:
            raise ValueError(index.note)
        records, views = (list(_messages(index, topic)) for topic in (RIG_TOPIC, VIEWS_TOPIC))
        config: list[str] = []
        metadata: dict[str, str] = {}
        with path.open("rb") as stream:
            # Chunks are left as they are: what they unfold to is read above, within its limit.
            for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
                if isinstance(record, Attachment) and record.name == CONFIG_ATTACHMENT:
                    config.append(record.data.decode())
                elif isinstance(record, Metadata) and record.name == "quadrig":
                    metadata = record.metadata
        recordings = read_json(metadata.get("recordings", "[]").encode(), tuple[str, ...])
        if not records:
            raise QuadrigError(f"{path} is MCAP but holds no rig; give the rig.mcap that `rig calibrate` wrote")
        rig, times = decode_rig(records[-1], tuple(decode_fit(view) for view in views))
    except OSError as error:
        raise QuadrigError(f"cannot read {path}: {error.strerror}") from error
    except QuadrigError:
        raise
    # Damage shows as whatever the parsers of mcap, zstd and JSON stumble over.
    except Exception as error:
        raise QuadrigError(
            f"{path} cannot be read as a rig.mcap ({_first_line(error)}); write it again with `rig calibrate`"
        ) from error
    return RigFile(rig, "".join(config[-1:]), times, metadata.get("version", ""), recordings)


def _messages(index: McapIndex, name: str) -> Iterator[bytes]:
    """The messages of a topic in the order that they were written in. Raises ValueError where one is damaged."""
    with closing(McapBytes(index.path)) as file:
        for topic in index.topics:
            if topic.topic == name:
                for chunk, offset in sorted(zip(topic.chunks.tolist(), topic.offsets.tolist(), strict=True)):
                    yield file.message(chunk, offset)


def rig_frame_name(rig: Rig) -> str:
    """The rig frame's name among transforms: the reference's, or "world" where a surveyed rectangle is the reference
    and its pose says where the frame is."""
    for placed in rig.rectangles:
        if placed.name == rig.reference:
            is_frame = np.allclose(placed.rig_from_rect.matrix(), np.eye(4), atol=0, rtol=0)
            return rig.reference if is_frame else "world"
    return rig.reference


def _invented_times(rig: Rig) -> tuple[int, ...]:
    framesets = [fit.view.frameset for fit in _every_fit(rig)]
    framesets += [int(index) for placed in rig.rectangles for index in placed.framesets]
    return tuple(1000 * index for index in range(max(framesets, default=-1) + 1))


def _write_record(writer: TopicWriter, rig: Rig, times: tuple[int, ...], known: tuple[int, ...]) -> None:
    writer.declare_json(RIG_TOPIC, "quadrig.Rig", msgspec.json.encode(msgspec.json.schema(RigRecord)))
    writer.declare_json(VIEWS_TOPIC, "quadrig.View", msgspec.json.encode(msgspec.json.schema(FitRecord)))
    first = min(times, default=0)
    writer.write_json(RIG_TOPIC, encode_rig(rig, known), first)
    for number, fit in enumerate(_every_fit(rig)):
        time = times[fit.view.frameset] if 0 <= fit.view.frameset < len(times) else first
        writer.write_json(VIEWS_TOPIC, encode_fit(fit), time, number)


def _every_fit(rig: Rig) -> Iterator[ViewFit]:
    """The fits of a rig and of those apart from it."""
    yield from rig.fits
    for each in rig.apart:
        yield from _every_fit(each)


def _calibration(camera: Camera, time: int) -> Any:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

    lens = camera.intrinsics
    message = CameraCalibration(frame_id=camera.name, width=lens.width, height=lens.height)
    message.timestamp.FromNanoseconds(time)
    pinhole = lens.model == "pinhole"
    message.distortion_model = "plumb_bob" if pinhole else "kannala_brandt"
    message.D.extend(float(value) for value in (lens.distortion if pinhole else lens.distortion[:4]))
    message.K.extend(lens.camera_matrix.ravel().tolist())
    message.R.extend(np.eye(3).ravel().tolist())
    message.P.extend(np.column_stack([lens.camera_matrix, np.zeros(3)]).ravel().tolist())
    return message


def _transforms(rig: Rig, times: tuple[int, ...]) -> Iterator[tuple[int, Any]]:
    """What stands still at the first time, and then each frameset's moving rectangles at its own."""
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    first = min(times, default=0)
    still, frame = FrameTransforms(), rig_frame_name(rig)
    for camera in rig.cameras:
        _add_transform(still, frame, camera.name, camera.rig_from_camera, first)
    moving: dict[int, Any] = {}
    for placed in rig.rectangles:
        if not placed.rectangle.moving:
            _add_transform(still, frame, placed.name, placed.rig_from_rect, first)
            continue
        for row, frameset in enumerate(placed.framesets):
            time = times[frameset] if frameset < len(times) else first
            message = moving.setdefault(time, FrameTransforms())
            _add_transform(message, frame, placed.name, placed.rig_from_rect[row], time)
    yield first, still
    yield from sorted(moving.items())


def _add_transform(message: Any, parent: str, child: str, parent_from_child: Pose, time: int) -> None:
    """foxglove.FrameTransform holds the transform that takes child coordinates to parent coordinates."""
    if parent == child:
        return
    entry = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
    entry.timestamp.FromNanoseconds(time)
    entry.translation.x, entry.translation.y, entry.translation.z = parent_from_child.translation.tolist()
    quaternion = parent_from_child.quaternion().tolist()
    entry.rotation.x, entry.rotation.y, entry.rotation.z, entry.rotation.w = quaternion


def _outline(placed: PlacedRectangle, time: int) -> Any:
    """The rectangle's outline in its own frame as a foxglove.PointCloud."""
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

    points = dense_outline(placed.rectangle.corners, _OUTLINE_POINTS).astype("<f4")
    message = PointCloud(frame_id=placed.name, point_stride=12, data=points.tobytes())
    message.timestamp.FromNanoseconds(time)
    message.pose.orientation.w = 1
    for index, name in enumerate("xyz"):
        message.fields.add(name=name, offset=4 * index, type=PackedElementField.FLOAT32)
    return message


def _first_line(error: Exception) -> str:
    from mcap.exceptions import EndOfFile

    if isinstance(error, EndOfFile):
        return "the file ends in the middle"
    return (str(error) or type(error).__name__).splitlines()[0]
