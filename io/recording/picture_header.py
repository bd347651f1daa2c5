"""What a picture file says of itself before it is decoded: its size, how it is turned, when it was taken."""

import re
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from io import BytesIO
from typing import Any

import cv2
import numpy as np

from quadrig.single.arrays import Picture

HEADER_BYTES = 1 << 18
"""So much of a file holds its header, also where a thumbnail or a colour profile comes first."""

_ORIENTATION, _EXIF, _TAKEN, _FRACTION, _ZONE = 0x0112, 0x8769, 0x9003, 0x9291, 0x9011
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS = 256, 257, 258
_PNG_ALPHA = {"RGBA", "LA", "La", "RGBa", "PA"}
# EXIF 2.3, tag Orientation: how to turn the stored picture so that it stands upright, and that in words.
_TURNS = {
    2: ("mirrored", lambda image: cv2.flip(image, 1)),
    3: ("turned by 180 degrees", lambda image: cv2.rotate(image, cv2.ROTATE_180)),
    4: ("mirrored upside down", lambda image: cv2.flip(image, 0)),
    5: ("mirrored and turned by 90 degrees", lambda image: cv2.transpose(image)),
    6: ("turned by 90 degrees", lambda image: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE)),
    7: ("mirrored and turned by 270 degrees", lambda image: cv2.flip(cv2.transpose(image), -1)),
    8: ("turned by 270 degrees", lambda image: cv2.rotate(image, cv2.ROTATE_90_COUNTERCLOCKWISE)),
}


@dataclass(frozen=True)
class PictureHeader:
    """width, height: px, as stored. kind: jpeg, png, tiff... orientation: EXIF's, 1 for upright.

    pixel_bytes: of one pixel as it is decoded. taken: ns since 1970, None where the picture does not say; a time
    without its zone is taken as UTC, as it is for the other cameras.
    """

    kind: str
    width: int
    height: int
    orientation: int = 1
    pixel_bytes: int = 3
    alpha: bool = False
    taken: int | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height (px) of the upright picture."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)

    @property
    def turned(self) -> str:
        """How the stored picture has to be turned, in words, or ""."""
        return _TURNS[self.orientation][0] if self.orientation in _TURNS else ""


def read_header(data: bytes) -> PictureHeader:
    """The header of a JPEG, PNG, WebP, TIFF, BMP, JPEG 2000 or PNM picture. Raises ValueError where it has none."""
    kind = next((kind for kind, begins in _MAGIC.items() if re.match(begins, data, re.DOTALL)), "")
    if not kind:
        raise ValueError(f"{len(data)} bytes are no image that can be read")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            header = _read_tiff(data) if kind == "tiff" else _read_other(kind, data)
    except Exception as error:
        # Pillow answers damaged bytes with whatever went wrong in its parsers: a dozen kinds of errors.
        raise ValueError(f"{len(data)} bytes are a damaged {kind.upper()}{_why(error)}") from error
    if header.width <= 0 or header.height <= 0:
        raise ValueError(f"the {kind.upper()} has no pixels")
    return header


def _why(error: Exception) -> str:
    """What Pillow says in words of its own: what it only passes on helps nobody."""
    return f" ({error})" if str(error) and error.__cause__ is None and not isinstance(error, struct.error) else ""


def upright(image: Picture, header: PictureHeader) -> Picture:
    """The decoded picture, turned as its EXIF says."""
    # OpenCV turns a TIFF by itself, asked or not.
    if header.kind == "tiff" or header.orientation not in _TURNS:
        return image
    return np.ascontiguousarray(_TURNS[header.orientation][1](image))


_MAGIC = {
    "jpeg": rb"\xff\xd8\xff",
    "png": rb"\x89PNG\r\n\x1a\n",
    "webp": rb"RIFF....WEBP",
    "tiff": rb"II\*\0|MM\0\*",
    "bmp": rb"BM",
    "pnm": rb"P[1-6]\s|P[fF]\s",
    "jp2": rb"\0\0\0\x0cjP  ",
}


def _read_other(kind: str, data: bytes) -> PictureHeader:
    from PIL import (
        BmpImagePlugin,
        Image,
        Jpeg2KImagePlugin,
        JpegImagePlugin,
        PngImagePlugin,
        PpmImagePlugin,
        WebPImagePlugin,
    )

    # Each by its own class: Image.open warns of large pictures, and refuses larger ones, by a limit of its own.
    reader = {
        "jpeg": JpegImagePlugin.JpegImageFile,
        "png": PngImagePlugin.PngImageFile,
        "webp": WebPImagePlugin.WebPImageFile,
        "bmp": BmpImagePlugin.BmpImageFile,
        "pnm": PpmImagePlugin.PpmImageFile,
        "jp2": Jpeg2KImagePlugin.Jpeg2KImageFile,
    }[kind]
    picture = reader(BytesIO(data))
    # PngImageFile.getexif would decode the picture to look for EXIF behind it.
    exif = Image.Image.getexif(picture)
    alpha = picture.mode in _PNG_ALPHA or "transparency" in picture.info
    wide = picture.mode.startswith(("I", "F"))
    width, height = picture.size
    return PictureHeader(
        kind, width, height, _orientation(exif), (4 if alpha else 3) * (2 if wide else 1), alpha,
        _taken(exif.get_ifd(_EXIF)),
    )  # fmt: skip


def _read_tiff(data: bytes) -> PictureHeader:
    """By its tags alone: Pillow's own reader knows no floats in colour, which OpenCV decodes."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    stream = BytesIO(data)
    tags: Any = ImageFileDirectory_v2(stream.read(8))
    stream.seek(tags.next)
    tags.load(stream)
    bits = tags.get(_TIFF_BITS, (1,))
    pixel = sum(bits if isinstance(bits, tuple) else (bits,)) // 8
    return PictureHeader("tiff", int(tags[_TIFF_WIDTH]), int(tags[_TIFF_HEIGHT]), _orientation(tags), max(pixel, 1))


def _orientation(tags: Mapping[int, Any]) -> int:
    value = tags.get(_ORIENTATION, 1)
    return value if value in _TURNS else 1


def _taken(tags: Mapping[int, Any]) -> int | None:
    text = str(tags.get(_TAKEN, "")).strip("\0 ")
    try:
        moment = datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    zone = re.fullmatch(r"([+-])(\d\d):(\d\d)", str(tags.get(_ZONE, "")).strip("\0 "))
    if zone:
        moment -= int(f"{zone[1]}1") * timedelta(hours=int(zone[2]), minutes=int(zone[3]))
    fraction = str(tags.get(_FRACTION, "")).strip("\0 ")
    return int(moment.timestamp()) * 10**9 + (int(f"{fraction:0<9.9}") if fraction.isdigit() else 0)
