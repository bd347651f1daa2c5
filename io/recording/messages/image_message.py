"""Messages that carry an image or a lens: ROS 2 in CDR, Foxglove in protobuf and in JSON.

One reading for all: an EncodedImage and a time stamp, so that decoding knows nothing of messages.
"""

import base64
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np

from quadrig.io.safe_json import read_json
from quadrig.single.lens import Intrinsics, LensModel

_HEADER = """std_msgs/Header header
{}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_RECTIFY_FIELDS = "\n".join(f"uint32 {name}" for name in ("x_offset", "y_offset", "height", "width"))
ROS2_DEFINITIONS = {
    "sensor_msgs/msg/Image": _HEADER.format(
        "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data"
    ),
    "sensor_msgs/msg/CompressedImage": _HEADER.format("string format\nuint8[] data"),
    "sensor_msgs/msg/CameraInfo": _HEADER.format(
        "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\n"
        "float64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    )
    + f"{'=' * 80}\nMSG: sensor_msgs/RegionOfInterest\n{_RECTIFY_FIELDS}\nbool do_rectify\n",
}
"""The definitions of the ROS 2 messages that are read and written: the layout of CDR follows from them alone, so
recordings whose own schema is IDL, or missing, are read as well."""

_IMAGE_SCHEMAS = {
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "foxglove.RawImage",
    "foxglove.CompressedImage",
    "foxglove.CompressedVideo",
}
_LENS_SCHEMAS = {"sensor_msgs/msg/CameraInfo", "foxglove.CameraCalibration"}
# The stamp comes first in every message worth its name; 200 bytes hold it in the longest form, JSON with spaces.
STAMP_BYTES = 200
_PROTOBUF_FIRST_FIELD = 0x0A
_JSON_STAMP = re.compile(rb'^\s*\{\s*"timestamp"\s*:\s*(\{[^{}]*\}|"[^"]*")')


@dataclass(frozen=True, eq=False)
class EncodedImage:
    """The bytes of one image and how they are to be read. width, height and step are 0 where the bytes say so."""

    encoding: str
    data: bytes
    width: int = 0
    height: int = 0
    step: int = 0
    big_endian: bool = False


def holds_images(encoding: str, schema: str) -> bool:
    """Whether messages of this encoding and schema carry images that can be read here."""
    return canonical_schema(schema) in _IMAGE_SCHEMAS and encoding in _encodings(schema)


def holds_lenses(encoding: str, schema: str) -> bool:
    """Whether messages of this encoding and schema carry a lens that can be read here."""
    return canonical_schema(schema) in _LENS_SCHEMAS and encoding in _encodings(schema)


def holds_video(schema: str) -> bool:
    """Whether the images of one topic build on one another."""
    return schema == "foxglove.CompressedVideo"


def canonical_schema(schema: str) -> str:
    """sensor_msgs/Image, as some writers have it, is sensor_msgs/msg/Image."""
    return schema.replace("/", "/msg/") if schema.count("/") == 1 else schema


def _encodings(schema: str) -> tuple[str, ...]:
    return ("protobuf", "json") if schema.startswith("foxglove.") else ("cdr",)


@contextmanager
def _damage_as_value_error() -> Iterator[None]:
    """The decoders of CDR, protobuf and JSON answer damaged bytes with a dozen kinds of errors; here it is one."""
    try:
        yield
    except Exception as error:
        raise ValueError(f"the message is damaged ({error or type(error).__name__})") from error


@_damage_as_value_error()
def read_stamp(encoding: str, data: bytes) -> int | None:
    """Time stamp (ns) that the message itself carries, from its first bytes; 0 where unset, None where unknown.

    Raises ValueError where the bytes are not such a message.
    """
    if encoding == "cdr":
        order = "<" if len(data) > 1 and data[1] & 1 else ">"
        seconds, nanoseconds = struct.unpack_from(order + "iI", data, 4)
        return seconds * 10**9 + nanoseconds
    if encoding == "protobuf":
        return _stamp_from_protobuf(data)
    found = _JSON_STAMP.match(data)
    return _stamp_from_json(msgspec.json.decode(found.group(1))) if found else None


@_damage_as_value_error()
def stamp_of_whole(encoding: str, schema: str, data: bytes) -> int:
    """Time stamp (ns) of a whole message whose first bytes do not show it; 0 where it has none.

    Raises ValueError where the bytes are not such a message.
    """
    if encoding == "json":
        return _stamp_from_json(read_json(data, dict).get("timestamp"))
    if encoding == "protobuf":
        stamp = _protobuf_class(schema).FromString(data).timestamp
        return stamp.seconds * 10**9 + stamp.nanos
    return read_stamp(encoding, data) or 0


@_damage_as_value_error()
def read_image(encoding: str, schema: str, data: bytes) -> EncodedImage:
    """The image that a message carries. Raises ValueError where the bytes are not such a message."""
    schema = canonical_schema(schema)
    if encoding == "cdr":
        message = _cdr_decoder(schema)(data)
        if schema == "sensor_msgs/msg/CompressedImage":
            return EncodedImage(_word(message.format), message.data)
        return EncodedImage(
            _word(message.encoding), message.data, message.width, message.height, message.step,
            bool(message.is_bigendian),
        )  # fmt: skip
    message = _foxglove_message(encoding, schema, data)
    if schema == "foxglove.RawImage":
        return EncodedImage(message.encoding.lower(), message.data, message.width, message.height, message.step)
    return EncodedImage(message.format.lower(), message.data)


@_damage_as_value_error()
def read_lens(encoding: str, schema: str, data: bytes) -> tuple[Intrinsics | None, str]:
    """The lens of a CameraInfo or CameraCalibration, and a remark where part of it could not be taken over.

    None where the camera was not calibrated (a matrix of zeros).
    Raises ValueError where the bytes are not such a message.
    """
    schema = canonical_schema(schema)
    if encoding == "cdr":
        message = _cdr_decoder(schema)(data)
        fields = (message.width, message.height, _word(message.distortion_model), message.d, message.k)
    else:
        message = _foxglove_message(encoding, schema, data)
        fields = (message.width, message.height, message.distortion_model, message.D, message.K)
    return _intrinsics(*fields)


def _intrinsics(width: int, height: int, model: str, d: Any, k: Any) -> tuple[Intrinsics | None, str]:
    matrix = np.array(list(k), float)
    distortion = np.array(list(d), float)
    if len(matrix) != 9 or not (matrix[0] > 0 and matrix[4] > 0) or width <= 0 or height <= 0:
        return None, ""
    if not (np.isfinite(matrix).all() and np.isfinite(distortion).all()):
        return None, "its lens is not numbers and is not used"
    lens: LensModel = "fisheye" if model in ("equidistant", "fisheye", "kannala_brandt") else "pinhole"
    places = 4 if lens == "fisheye" else 5
    remark = ""
    if np.any(distortion[places:]):
        remark = (
            f"its {model or 'distortion'} has terms beyond the first {places}; only the focal is taken as a guess"
        )
        distortion = np.zeros(0)
    coefficients = np.zeros(5)
    count = min(len(distortion), places)
    coefficients[:count] = distortion[:count]
    centre = np.array([matrix[2], matrix[5]])
    focal, aspect = float(matrix[0]), float(matrix[4] / matrix[0])
    return Intrinsics(int(width), int(height), focal, centre, coefficients, aspect, lens), remark


def _word(text: bytes) -> str:
    """A text as _cdr_decoder leaves it."""
    return text.partition(b"\0")[0].decode(errors="replace").lower()


@cache
def _cdr_decoder(schema: str) -> Callable[[bytes], Any]:
    from mcap.records import Schema
    from mcap_ros2.decoder import DecoderFactory

    # A text lies in CDR as a list of bytes does. Taken as such, one that is no UTF-8 costs no picture: a mere name.
    text = re.sub(r"^string ", "uint8[] ", ROS2_DEFINITIONS[schema], flags=re.MULTILINE).encode()
    decoder = DecoderFactory().decoder_for("cdr", Schema(id=1, data=text, encoding="ros2msg", name=schema))
    assert decoder is not None
    return decoder


@cache
def _protobuf_class(schema: str) -> Any:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    classes = (CameraCalibration, CompressedImage, CompressedVideo, RawImage)
    return {f"foxglove.{one.__name__}": one for one in classes}[schema]


@dataclass
class _JsonMessage:
    """The fields of a Foxglove message that came as JSON, where bytes are in base64."""

    data: bytes
    format: str
    encoding: str
    width: int
    height: int
    step: int
    distortion_model: str
    D: list[float]
    K: list[float]


def _foxglove_message(encoding: str, schema: str, data: bytes) -> Any:
    if encoding == "protobuf":
        return _protobuf_class(schema).FromString(data)
    fields = read_json(data, dict)
    return _JsonMessage(
        data=base64.b64decode(fields.get("data", "")),
        format=fields.get("format", ""),
        encoding=fields.get("encoding", ""),
        width=int(fields.get("width", 0)),
        height=int(fields.get("height", 0)),
        step=int(fields.get("step", 0)),
        distortion_model=fields.get("distortion_model", ""),
        D=fields.get("D", []),
        K=fields.get("K", []),
    )


def _stamp_from_protobuf(data: bytes) -> int | None:
    """Of a message whose first field is a google.protobuf.Timestamp of a few bytes."""
    if len(data) < 2 or data[0] != _PROTOBUF_FIRST_FIELD or data[1] > 40 or len(data) < 2 + data[1]:
        return None
    from google.protobuf.timestamp_pb2 import Timestamp

    stamp = Timestamp.FromString(data[2 : 2 + data[1]])
    return stamp.seconds * 10**9 + stamp.nanos


def _stamp_from_json(stamp: Any) -> int:
    """Foxglove writes {"sec", "nsec"}; protobuf's own JSON is a date."""
    if isinstance(stamp, dict):
        return int(stamp.get("sec", 0)) * 10**9 + int(stamp.get("nsec", stamp.get("nanos", 0)))
    if isinstance(stamp, str):
        from google.protobuf.timestamp_pb2 import Timestamp

        parsed = Timestamp()
        parsed.FromJsonString(stamp)
        return parsed.seconds * 10**9 + parsed.nanos
    return 0
