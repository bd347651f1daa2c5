"""A Frame: one picture of one camera, kept as it came until somebody needs its pixels."""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from quadrig.io.recording.decode_image import UndecodableImage, decode_file
from quadrig.io.recording.picture_header import read_header
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError

# Corners of a picture written at 95 lie within 0.02 px of the raw one's; at 80 they are three times as far.
_JPEG_QUALITY = 95
_PREVIEW_QUALITY = 80


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of one camera.

    stamp: ns, when it was taken; timed: whether a clock gave it, not the order of files in a folder;
    arrived: s on the monotonic clock, when it reached this program.
    encoded: its JPEG or PNG bytes where the source gave such, else empty; picture: (H, W) or (H, W, 3) BGR else.
    """

    camera: str
    stamp: int
    arrived: float
    encoded: bytes = b""
    picture: Picture | None = None
    timed: bool = True

    @property
    def time(self) -> float:
        """When it was taken, s since 1970 by its camera's clock; nan where no clock says."""
        return self.stamp / 1e9 if self.timed else float("nan")

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height, px. Raises QuadrigError where the bytes are no picture."""
        with suppress(ValueError):
            return read_header(self.encoded).size
        height, width = self.grey.shape
        return width, height

    @cached_property
    def grey(self) -> Picture:
        """The picture (H, W) in grey. Raises QuadrigError where the bytes are no picture."""
        if self.picture is None:
            return self._decoded()
        if self.picture.ndim == 2:
            return self.picture
        return np.asarray(cv2.cvtColor(self.picture, cv2.COLOR_BGR2GRAY), np.uint8)

    def preview(self, shrink: int) -> bytes:
        """A JPEG for the eye, grey, its sides 1 / shrink of the picture's. Raises as `grey` does."""
        small = cv2.resize(self.grey, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _PREVIEW_QUALITY])[1].tobytes()

    def jpeg(self) -> bytes:
        """JPEG or PNG bytes: those of the source, or the picture encoded, once."""
        return self._jpeg

    @cached_property
    def _jpeg(self) -> bytes:
        if self.encoded or self.picture is None:
            return self.encoded
        done, data = cv2.imencode(".jpg", self.picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not done:
            raise QuadrigError(f"camera {self.camera!r}: a picture could not be written as JPEG; free some memory")
        return data.tobytes()

    @property
    def format(self) -> str:
        """ "png" or "jpeg": what jpeg() returns."""
        return "png" if self.encoded.startswith(b"\x89PNG") else "jpeg"

    def _decoded(self) -> Picture:
        try:
            return decode_file(self.encoded)
        except UndecodableImage as error:
            what = f"camera {self.camera!r}: a picture arrived damaged ({error}); look at its cable or network"
            raise QuadrigError(what) from error
