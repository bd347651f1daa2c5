"""Blank sheets, and their readings: they look the same after half a turn, square ones after a quarter."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.blank_sheet import find_blank_sheet
from quadrig.single.detect.pictures import window_around
from quadrig.single.lens import image_middle
from quadrig.single.rectangle import FoundTags, Marking, Rectangle
from quadrig.single.view import View

# Share by which angle and side ratio may be missed where the lens bends the outline or is not centred.
_SURELY_WRONG = 0.15


@dataclass(frozen=True)
class PlainMarking(Marking):
    """An unmarked sheet, lighter or darker than what it lies on."""

    kind: ClassVar[str] = "plain"

    @property
    def description(self) -> str:
        return "a blank sheet"

    @property
    def not_found(self) -> str:
        return "a blank sheet was not found; show it whole and flat, alone on a ground that is darker or lighter"

    @property
    def marks(self) -> frozenset[Hashable]:
        return frozenset(["blank sheet"])

    def find(self, grey: Picture, rectangle: Rectangle, _found: FoundTags, /) -> View | None:
        return _view(grey, rectangle, grey, np.zeros(2))

    def follow(self, grey: Picture, rectangle: Rectangle, before: View, /) -> View | None:
        return _view(grey, rectangle, *window_around(grey, before.pixels))


def _view(grey: Picture, rectangle: Rectangle, window: Picture, start: Floats) -> View | None:
    """The View of the sheet in a part of the picture that begins at a pixel (2,).

    The reading nearest to upright in the picture comes first, the others are the View's alternatives.
    """
    found = find_blank_sheet(window, image_middle(grey.shape[1], grey.shape[0]) - start)
    if found is None:
        return None
    corners = found.corners + start
    orders = _possible(rectangle, corners, _readings(corners), grey.shape)
    points = rectangle.corners
    return View(
        rectangle.name,
        points,
        corners[orders[0]],
        alternatives=tuple(points[np.argsort(order)][orders[0]] for order in orders[1:]),
        sigma=found.sigma,
        common=found.common[orders[0]],
    )


def _readings(corners: Floats) -> list[list[int]]:
    """Orders that put clockwise image corners into Eq. 4's order, the most upright first."""
    orders = [[(start + k) % 4 for k in range(4)] for start in range(4)]
    # Eq. 4's first side runs leftwards along the bottom: width; so what is most upright has it point most to -x.
    leftward = []
    for order in orders:
        first = corners[order[1]] - corners[order[0]] + corners[order[2]] - corners[order[3]]
        leftward.append(-first[0] / max(np.linalg.norm(first), 1e-9))
    return [orders[k] for k in np.argsort(leftward)[::-1]]


def _possible(
    rectangle: Rectangle, corners: Floats, orders: list[list[int]], shape: tuple[int, ...]
) -> list[list[int]]:
    """The orders that some focal length explains; those of a quarter turn seldom are, unless the sheet is square.

    A homography has one constraint more than an unknown focal needs (orthogonal sides, and their ratio): it is spent
    on the choice here, with the principal point in the image's middle.
    """
    misfits = [_misfit(rectangle, corners[order], shape) for order in orders]
    limit = max(_SURELY_WRONG, 3 * min(misfits))
    kept = [order for order, misfit in zip(orders, misfits, strict=True) if misfit <= limit]
    return sorted(kept, key=lambda order: misfits[orders.index(order)] > _SURELY_WRONG / 3)


def _misfit(rectangle: Rectangle, corners: Floats, shape: tuple[int, ...]) -> float:
    """Least share by which right angle or side ratio are missed, over all focals from fisheye to telephoto."""
    middle = image_middle(shape[1], shape[0])
    plane = rectangle.corners[:, :2].astype(np.float32)
    homography = cv2.getPerspectiveTransform(plane, (corners - middle).astype(np.float32))
    focals = max(shape) * np.geomspace(0.3, 8.0, 60)
    rays = homography[None, :, :2] / np.stack([focals, focals, np.ones_like(focals)], axis=1)[:, :, None]
    first, second = np.linalg.norm(rays[..., 0], axis=1), np.linalg.norm(rays[..., 1], axis=1)
    cosine = np.abs(np.sum(rays[..., 0] * rays[..., 1], axis=1)) / (first * second)
    return float(np.min(np.hypot(cosine, np.log(first / second))))
