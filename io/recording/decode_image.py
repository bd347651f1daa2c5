"""From the bytes of one image to an array: grey for detection, BGR for looking at.

Encodings are those of ROS 2 (sensor_msgs/image_encodings) and Foxglove (RawImage): both are covered by one table.
A picture whose EXIF says that it is turned is turned: pixels are those of the picture as one sees it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from quadrig.io.recording.limits import most_pixels, too_many_pixels
from quadrig.io.recording.messages.image_message import EncodedImage
from quadrig.io.recording.picture_header import PictureHeader, read_header, upright
from quadrig.io.whole_file import read_whole
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError

# Channels, bytes of a sample, and OpenCV's conversions to grey and to BGR (None: leave as it is).
_PACKED = {
    "mono8": (1, 1, None, cv2.COLOR_GRAY2BGR),
    "8uc1": (1, 1, None, cv2.COLOR_GRAY2BGR),
    "mono16": (1, 2, None, cv2.COLOR_GRAY2BGR),
    "bgr8": (3, 1, cv2.COLOR_BGR2GRAY, None),
    "8uc3": (3, 1, cv2.COLOR_BGR2GRAY, None),
    "rgb8": (3, 1, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    "bgra8": (4, 1, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    "8uc4": (4, 1, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, 1, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2BGR),
    "bgr16": (3, 2, cv2.COLOR_BGR2GRAY, None),
    "rgb16": (3, 2, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    "bayer_rggb": (1, 1, cv2.COLOR_BayerRGGB2GRAY, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr": (1, 1, cv2.COLOR_BayerBGGR2GRAY, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg": (1, 1, cv2.COLOR_BayerGBRG2GRAY, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg": (1, 1, cv2.COLOR_BayerGRBG2GRAY, cv2.COLOR_BayerGRBG2BGR),
    "uyvy": (2, 1, cv2.COLOR_YUV2GRAY_UYVY, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (2, 1, cv2.COLOR_YUV2GRAY_YUY2, cv2.COLOR_YUV2BGR_YUY2),
}
# Luma rows first, then the chroma at half height: one array of 3/2 the height.
_PLANAR = {
    "nv12": (cv2.COLOR_YUV2GRAY_NV12, cv2.COLOR_YUV2BGR_NV12),
    "nv21": (cv2.COLOR_YUV2GRAY_NV21, cv2.COLOR_YUV2BGR_NV21),
    "i420": (cv2.COLOR_YUV2GRAY_I420, cv2.COLOR_YUV2BGR_I420),
}
_SAME_AS = {"yuv422": "uyvy", "yuv422_yuy2": "yuyv", "yuy2": "yuyv"}
_DEPTH = ("16uc1", "16sc1", "32fc1", "64fc1", "compresseddepth")
# Bytes of a pixel that is stored as it is: four channels of sixteen bits.
_WIDEST_PIXEL = 8
# What shows through where a picture with alpha has nothing: the paper on which one would see it.
_WHITE = 255

# What OpenCV would print of damaged pictures is counted, and said in words.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

_REDUCED = {
    1: (cv2.IMREAD_GRAYSCALE, cv2.IMREAD_COLOR),
    2: (cv2.IMREAD_REDUCED_GRAYSCALE_2, cv2.IMREAD_REDUCED_COLOR_2),
    4: (cv2.IMREAD_REDUCED_GRAYSCALE_4, cv2.IMREAD_REDUCED_COLOR_4),
    8: (cv2.IMREAD_REDUCED_GRAYSCALE_8, cv2.IMREAD_REDUCED_COLOR_8),
}


class UndecodableImage(ValueError):  # noqa: N818 - it names the image, which is what a person has to look at
    """The bytes of one image cannot be read: the frame is skipped, the recording goes on."""


def is_depth(encoding: str) -> bool:
    """Whether the encoding is that of depths, which no marking can be seen in."""
    return any(word in encoding.lower() for word in _DEPTH)


def read_picture_file(path: Path) -> bytes:
    """The bytes of an image file. Raises UndecodableImage where it cannot be read, or is larger than any picture."""
    try:
        return read_whole(path, most_pixels() * _WIDEST_PIXEL)
    except QuadrigError as error:
        raise UndecodableImage(str(error)) from error
    except OSError as error:
        raise UndecodableImage(error.strerror or str(error)) from error


def decode_image(coded: EncodedImage, gray: bool = True, shrink: int = 1) -> Picture:
    """The image (H, W) uint8, or (H, W, 3) uint8 in BGR where not gray, at 1/shrink of its size (1, 2, 4 or 8).

    Raises UndecodableImage.
    """
    if coded.width == 0:
        return decode_file(coded.data, gray, shrink)
    size = f"{coded.width}x{coded.height} {coded.encoding}"
    if coded.height == 0:
        raise UndecodableImage(f"a {size} image has no pixels")
    try:
        return shrunk(_decode_raw(coded, gray), shrink)
    except UndecodableImage:
        raise
    except (cv2.error, ValueError, MemoryError) as error:
        raise UndecodableImage(f"{len(coded.data)} bytes are no {size} image") from error


def decode_file(data: bytes, gray: bool = True, shrink: int = 1) -> Picture:
    """The image of the bytes of a JPEG, PNG, WebP, TIFF, PGM... file, as decode_image gives it.

    A JPEG is shrunk while it is decoded, which saves most of the work.
    """
    return _upright(data, lambda header: _decoded(data, header, gray, shrink))


def decode_unchanged(data: bytes) -> NDArray[Any]:
    """The image of the same bytes with all its bits and channels, in BGR or BGRA. Raises UndecodableImage."""
    return _upright(data, lambda header: _imdecode(data, header, cv2.IMREAD_UNCHANGED))


def _upright(data: bytes, decoded: Callable[[PictureHeader], Any]) -> Any:
    try:
        header = read_header(data)
        if refused := too_many_pixels(header.width, header.height, header.pixel_bytes):
            raise UndecodableImage(refused)
        return upright(decoded(header), header)
    except UndecodableImage:
        raise
    except (cv2.error, ValueError, MemoryError) as error:
        raise UndecodableImage(str(error)) from error


def _decoded(data: bytes, header: PictureHeader, gray: bool, shrink: int) -> Picture:
    """The image as it is stored."""
    # OpenCV reads samples of colour TIFFs as they are or not at all, and drops alpha instead of looking through it.
    as_stored = header.alpha or header.kind == "tiff"
    how = _REDUCED[shrink][0 if gray else 1] | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = _eight_bits(_imdecode(data, header, cv2.IMREAD_UNCHANGED if as_stored else how))
    return shrunk(_plain(image, gray), shrink) if as_stored else image


def _imdecode(data: bytes, header: PictureHeader, how: int) -> NDArray[Any]:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), how)
    if image is None:
        raise UndecodableImage(f"{len(data)} bytes are a damaged {header.kind.upper()}")
    return np.asarray(image)


def _plain(image: Picture, gray: bool) -> Picture:
    """Grey or BGR from one, three or four channels; where there is alpha, as seen on paper."""
    if image.ndim == 3 and image.shape[2] == 4:
        alpha = image[..., 3]
        through = np.uint8(_WHITE) - alpha
        shown = [cv2.add(cv2.multiply(image[..., k], alpha, scale=1 / 255), through) for k in range(3)]
        image = np.asarray(np.dstack(shown), np.uint8)
    if gray and image.ndim == 3:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    if not gray and image.ndim == 2:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    return image


def shrunk(image: Picture, shrink: int) -> Picture:
    """The image at 1/shrink of its size, each pixel the mean of those it stands for."""
    if shrink == 1:
        return image
    size = (-(-image.shape[1] // shrink), -(-image.shape[0] // shrink))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _decode_raw(coded: EncodedImage, gray: bool) -> Picture:
    encoding = _SAME_AS.get(coded.encoding, coded.encoding)
    if encoding in _PLANAR:
        to_gray, to_bgr = _PLANAR[encoding]
        image = _rows(coded, coded.height * 3 // 2, coded.width)
        return np.asarray(cv2.cvtColor(image, to_gray if gray else to_bgr), np.uint8)
    wide = encoding.startswith("bayer_") and encoding.endswith("16")
    name = encoding.removesuffix("16").removesuffix("8") if encoding.startswith("bayer_") else encoding
    if name not in _PACKED:
        known = ", ".join(sorted([*_PACKED, *_PLANAR]))
        raise UndecodableImage(f"encoding {coded.encoding!r} is not one of {known}")
    channels, sample, to_gray, to_bgr = _PACKED[name]
    sample = 2 if wide else sample
    image = _rows(coded, coded.height, coded.width * channels * sample)
    if sample == 2:
        image = _eight_bits(image.view(">u2" if coded.big_endian else "<u2").astype(np.uint16))
    image = image.reshape(coded.height, coded.width, channels) if channels > 1 else image
    conversion = to_gray if gray else to_bgr
    return np.ascontiguousarray(image if conversion is None else cv2.cvtColor(image, conversion), np.uint8)


def _rows(coded: EncodedImage, rows: int, row_bytes: int) -> Picture:
    """(rows, row_bytes) uint8 without the padding at the end of each row."""
    # One row needs no step: a claimed one would be made up for with zeros.
    step = coded.step if coded.step >= row_bytes and rows > 1 else row_bytes
    flat = np.frombuffer(coded.data, np.uint8)
    missing = rows * step - len(flat)
    # The last row may come without its padding.
    if 0 < missing <= step - row_bytes:
        flat = np.concatenate([flat, np.zeros(missing, np.uint8)])
    return np.ascontiguousarray(flat[: rows * step].reshape(rows, step)[:, :row_bytes])


def _eight_bits(image: np.ndarray) -> Picture:
    """The upper eight of the bits in use: sensors put 10, 12 or 14 of them into sixteen. Others by their maximum."""
    if image.dtype == np.uint16:
        image = image >> max(0, int(image.max(initial=0)).bit_length() - 8)
    elif image.dtype != np.uint8:
        samples = np.nan_to_num(image.astype(np.float32), copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        np.maximum(samples, 0, out=samples)
        # Nothing brighter than black stays black.
        samples *= 255 / (samples.max(initial=0) or 1)
        image = np.rint(samples, out=samples)
    return image.astype(np.uint8, copy=False)
