"""Which Views are worth keeping: those that show a rectangle where it was not seen yet, and not in full flight."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# A sheet moved less than this (of the picture's diagonal) since a kept View shows nothing new.
NEWS = 0.015
# Speeds above this (picture diagonals a second) smear a 10 ms exposure over more than a pixel and a half of 720p,
# and displace the sheet between cameras that are 10 ms apart by as much.
FASTEST = 0.12

Key = tuple[str, str]
"""Camera and rectangle."""


@dataclass(frozen=True, eq=False)
class Places:
    """Where rectangles were in the pictures of kept Views: outlines (K, 4, 2) px by camera and rectangle."""

    outlines: Mapping[Key, Floats] = field(default_factory=dict)

    def with_views(self, outlines: Mapping[Key, Floats]) -> "Places":
        """The same places and one more for each key; outlines (4, 2)."""
        added = {
            key: np.concatenate([self.outlines.get(key, np.zeros((0, 4, 2))), outline[None]])
            for key, outline in outlines.items()
        }
        return Places({**self.outlines, **added})

    def distance(self, key: Key, outline: Floats) -> float:
        """px from an outline (4, 2) to the nearest kept one of its camera and rectangle; inf where there is none."""
        kept = self.outlines.get(key)
        if kept is None:
            return float("inf")
        return float(np.linalg.norm(kept - outline, axis=-1).max(axis=-1).min())


def outlines_of(views: Sequence[View], rectangles: Sequence[Rectangle]) -> dict[Key, Floats]:
    """The corners (4, 2) px of the whole rectangle of each View, whichever of its points the View holds."""
    corners = {rectangle.name: rectangle.corners for rectangle in rectangles}
    return {(v.camera, v.rectangle): outline(v, corners[v.rectangle]) for v in views if v.rectangle in corners}


def outline(view: View, corners: Floats) -> Floats:
    """Where the corners (4, 3) of the rectangle lie in the picture, by the homography of the View's points."""
    if view.points.shape == corners.shape and np.array_equal(view.points, corners):
        return view.pixels
    homography, _ = cv2.findHomography(view.points[:, :2], view.pixels)
    if homography is None:
        return np.full((4, 2), np.inf)
    lifted = np.concatenate([corners[:, :2], np.ones((4, 1))], axis=1) @ np.asarray(homography).T
    return lifted[:, :2] / lifted[:, 2:]


def news(outlines: Mapping[Key, Floats], places: Places, diagonals: Mapping[str, float]) -> set[Key]:
    """The camera and rectangle of each outline that differs from all that were kept."""
    return {key for key, line in outlines.items() if places.distance(key, line) > NEWS * diagonals[key[0]]}


def speed(
    before: Mapping[Key, Floats], after: Mapping[Key, Floats], seconds: float, diagonals: Mapping[str, float]
) -> float:
    """The greatest speed, picture diagonals a second, of what two moments have in common; 0 for nothing."""
    if seconds <= 0:
        return 0.0
    shifts = [
        np.linalg.norm(after[key] - before[key], axis=-1).max() / diagonals[key[0]]
        for key in after.keys() & before.keys()
    ]
    return float(max(shifts, default=0.0) / seconds)


def displaced(
    outlines: Mapping[Key, Floats], places: Places, rectangles: Sequence[Rectangle], diagonals: Mapping[str, float]
) -> Key | None:
    """A static rectangle that stands elsewhere than where it was kept, with the camera that saw it move."""
    static = {rectangle.name for rectangle in rectangles if not rectangle.moving}
    for key, line in outlines.items():
        apart = places.distance(key, line)
        if key[1] in static and np.isfinite(apart) and apart > NEWS * diagonals[key[0]]:
            return key
    return None
