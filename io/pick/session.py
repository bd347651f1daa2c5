"""What the page of `rig pick` does: corners placed, snapped, undone and kept, and what they say so far."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from quadrig.io.config.corners_toml import CORNER_NAMES, PointedCorners, keep_corners, read_corners
from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.pick.placed import Placed, place
from quadrig.io.recording.framesets import NO_FRAME, Framesets
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.search.corner_views import camera_of, corner_view
from quadrig.io.search.whole_recording import camera_inputs
from quadrig.rig.words import length
from quadrig.single.arrays import Floats, Picture
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.solve.corners import REASON_WORDS, Reason, corner_reasons
from quadrig.single.subpixel.edge_crossing import nearest_crossing

# Quality of the pictures that the browser gets, where nothing is lost that an eye could point at.
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 92]


@dataclass(frozen=True, eq=False)
class _Change:
    """A step that can be undone: a table before and after it, and the corner that it was about."""

    before: PointedCorners
    after: PointedCorners
    corner: int


@dataclass(eq=False)
class PickSession:
    """Corners of one recording in one corners.toml; the file is read before every change, so that what a person
    writes into it meanwhile stays."""

    recording: Recording
    framesets: Framesets
    config: RigConfig
    path: Path
    done: list[_Change] = field(default_factory=list)
    undone: list[_Change] = field(default_factory=list)
    greys: dict[str, tuple[int, Picture]] = field(default_factory=dict)
    last: tuple[list, Placed] | None = None

    @property
    def rectangles(self) -> list[Rectangle]:
        """Those whose corners are given by hand."""
        return [one for one in self.config.rectangles if one.marking.by_hand]

    def described(self) -> dict[str, object]:
        """What does not change: cameras, rectangles, and which image of each camera belongs to which instant."""
        return {
            "cameras": [
                {"name": one.name, "width": one.width, "height": one.height} for one in self.recording.cameras
            ],
            "rectangles": [
                {"name": one.name, "width": one.width, "height": one.height, "moving": one.moving}
                for one in self.rectangles
            ],
            "corner_names": [name.replace("_", " ") for name in CORNER_NAMES],
            "images": self.framesets.frames.tolist(),
            "path": str(self.path),
        }

    def jpeg(self, camera: str, image: int) -> bytes:
        """A picture as a JPEG. Raises QuadrigError where there is none."""
        self._check_image(camera, image)
        return cv2.imencode(".jpg", self.recording.frame(camera, image), _JPEG)[1].tobytes()

    def corners(self) -> list[dict[str, object]]:
        """Every table of corners.toml."""
        return [
            {
                "camera": one.camera,
                "rectangle": one.rectangle.name,
                "image": one.image,
                "sigma": one.sigma,
                "pixels": pixel_list(one.pixels),
                "problem": _problem(one),
            }
            for one in self._tables()
        ]

    def place(self, camera: str, rectangle: str, image: int, corner: int, pixel: Floats, snap: bool) -> Floats | None:
        """Put a corner at a pixel (2,), then at the crossing of edges nearest to it, if asked and if there is one.

        The first can be had back by one undo. Returns the crossing, or None. Raises QuadrigError where the picture
        does not reach so far.
        """
        table = self._table(camera, rectangle, image)
        self._change(table, corner, np.asarray(pixel, float))
        if not snap:
            return None
        crossing = nearest_crossing(self._grey(camera, image), np.asarray(pixel, float))
        if crossing is not None:
            self._change(self._table(camera, rectangle, image), corner, crossing)
        return crossing

    def remove(self, camera: str, rectangle: str, image: int, corner: int) -> None:
        """Take a corner away."""
        self._change(self._table(camera, rectangle, image), corner, np.full(2, np.nan))

    def set_sigma(self, camera: str, rectangle: str, image: int, sigma: float) -> None:
        """How sure the corners of a rectangle in a picture are, px. Raises QuadrigError where it is no length."""
        if not (np.isfinite(sigma) and sigma > 0):
            raise QuadrigError(f"sigma is {sigma}; give pixels above zero, such as 1.0")
        table = self._table(camera, rectangle, image)
        self._do(_Change(table, replace(table, sigma=float(sigma)), 0))

    def undo(self) -> dict[str, object] | None:
        """Take the last step back; which corner it was about, None where there is none."""
        return self._move(self.done, self.undone, "before")

    def redo(self) -> dict[str, object] | None:
        """Take the last undone step again; which corner it was about, None where there is none."""
        return self._move(self.undone, self.done, "after")

    def solution(self, frameset: int) -> dict[str, object]:
        """What the corners so far predict for one instant, and how well they agree, in words."""
        placed = self._placed()
        predicted = {
            camera.name: {
                one.name: pixel_list(pixels)
                for one in self.rectangles
                if (pixels := placed.predicted(camera.name, one, frameset)) is not None
            }
            for camera in self.recording.cameras
        }
        return {"predicted": predicted, "status": _status(placed, len(self.recording.cameras))}

    def _placed(self) -> Placed:
        """Lenses and poses by the corners so far; the same ones again where no corner was moved since."""
        whole = [one for one in self._tables() if one.complete and not _problem(one)]
        views = [corner_view(one, self.recording, self.framesets) for one in whole]
        asked = [(one.key, one.sigma, one.pixels.tolist()) for one in whole]
        if self.last is None or self.last[0] != asked:
            inputs = camera_inputs([self.recording], self.config)
            self.last = asked, place(inputs, self.config.rectangles, views, self.config.reference)
        return self.last[1]

    def _tables(self) -> tuple[PointedCorners, ...]:
        tables = read_corners(self.path, self.config.rectangles)
        for one in tables:
            camera_of(one, self.recording)
        return tables

    def _table(self, camera: str, rectangle: str, image: int) -> PointedCorners:
        """The table of a rectangle in an image; of one that stands still the one there is, whatever its image."""
        self._check_image(camera, image)
        one = next((each for each in self.rectangles if each.name == rectangle), None)
        if one is None:
            raise QuadrigError(f"rig.toml has no rectangle {rectangle!r} whose corners are given by hand")
        for table in self._tables():
            if (table.camera, table.rectangle.name) == (camera, rectangle) and (
                not one.moving or (table.image or 0) == image
            ):
                return table
        return PointedCorners(camera, one, np.full((4, 2), np.nan), image if one.moving else None)

    def _change(self, table: PointedCorners, corner: int, pixel: Floats) -> None:
        pixels = table.pixels.copy()
        pixels[corner] = pixel
        self._do(_Change(table, replace(table, pixels=pixels), corner))

    def _do(self, change: _Change) -> None:
        camera_of(change.after, self.recording)
        keep_corners(self.path, change.after)
        self.done.append(change)
        self.undone.clear()

    def _move(self, source: list[_Change], target: list[_Change], to: str) -> dict[str, object] | None:
        if not source:
            return None
        change: _Change = source[-1]
        table: PointedCorners = getattr(change, to)
        keep_corners(self.path, table)
        target.append(source.pop())
        return {
            "camera": table.camera,
            "rectangle": table.rectangle.name,
            "image": table.image,
            "corner": change.corner,
        }

    def _check_image(self, camera: str, image: int) -> None:
        known = {one.name: one.frames for one in self.recording.cameras}
        if camera not in known or not 0 <= image < known[camera] or image == NO_FRAME:
            raise QuadrigError(f"the recording has no image {image} of a camera {camera!r}")

    def _grey(self, camera: str, image: int) -> Picture:
        """A picture in grey; the last one of each camera is at hand, since one picture gets many clicks."""
        held = self.greys.get(camera)
        if held is None or held[0] != image:
            held = self.greys[camera] = (image, self.recording.frame(camera, image, gray=True))
        return held[1]


def pixel_list(pixels: Floats) -> list[list[float] | None]:
    """Pixels (P, 2) as JSON has them; None for nan."""
    return [[round(float(x), 2), round(float(y), 2)] if np.isfinite([x, y]).all() else None for x, y in pixels]


def _problem(table: PointedCorners) -> str:
    """What is wrong with four corners, in words, or ""."""
    if not table.complete:
        return ""
    reason = Reason(int(corner_reasons(table.pixels)))
    return "" if reason == Reason.OK else REASON_WORDS[reason]


def _status(placed: Placed, cameras: int) -> Mapping[str, object]:
    rig = placed.rig
    if rig is None:
        return {"whole": False, "headline": "No rig yet", "details": [placed.reason]}
    accuracy = f", working accuracy {length(rig.working_accuracy)}" if np.isfinite(rig.working_accuracy) else ""
    details = [
        f"{camera.name}: focal {camera.intrinsics.focal:.0f} px, RMS {camera.rms:.2f} px" for camera in rig.cameras
    ]
    return {
        "whole": len(rig.cameras) == cameras,
        "headline": f"{len(rig.cameras)} of {cameras} cameras placed, RMS {rig.rms:.2f} px{accuracy}",
        "details": [*details, *rig.missing.values()],
    }
