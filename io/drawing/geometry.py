"""What drawings of a rig in space share: which way is up, how large it is, where to look from, what is in doubt."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.rig.result import PlacedRectangle, Rig
from quadrig.single.arrays import Floats

RING = [0, 1, 2, 3, 0]


def up_direction(rig: Rig) -> Floats:
    """Up (3,) in the rig frame, as the cameras show it: people mount them with the sky at the top of the picture.

    Cameras that look straight down say nothing; where none says anything, up is against the mean gaze.
    """
    up = -np.mean([camera.rig_from_camera.rotation[:, 1] for camera in rig.cameras], axis=0)
    size = np.linalg.norm(up)
    # A third is what is left when the cameras stand around and look down by 70 degrees.
    if size > 1 / 3:
        return up / size
    gaze = np.mean([camera.rig_from_camera.rotation[:, 2] for camera in rig.cameras], axis=0)
    size = np.linalg.norm(gaze)
    return -gaze / size if size > 1 / 3 else np.array([0.0, -1.0, 0.0])


def outlines(placed: PlacedRectangle) -> Floats:
    """Closed outlines (F, 5, 3) in the rig frame, F = 1 for a static rectangle."""
    pose = placed.rig_from_rect
    batch = pose if pose.translation.ndim == 2 else pose[None]
    return batch[:, None].transform(placed.rectangle.corners[RING])


def dense_outline(corners: Floats, side_points: int) -> Floats:
    """Points (4 N, 3) along the sides between corners (4, 3), N on each, from its first corner on."""
    along = np.linspace(0, 1, side_points, endpoint=False)[:, None]
    sides = np.roll(corners, -1, axis=0) - corners
    return (corners[:, None] + along * sides[:, None]).reshape(-1, 3)


def positions(rig: Rig) -> Floats:
    """Camera positions (C, 3) in the rig frame."""
    return np.array([camera.rig_from_camera.translation for camera in rig.cameras]).reshape(-1, 3)


def bounds(rig: Rig) -> tuple[Floats, Floats]:
    """Lowest and highest coordinates (3,) of cameras and rectangles; but for a room that it is carried through."""
    around = rig.room.rectangles if rig.room is not None else ()
    points = [outlines(placed).reshape(-1, 3) for placed in rig.rectangles if placed.name not in around]
    every = np.concatenate([positions(rig), *points])
    every = every[np.isfinite(every).all(axis=1)]
    return every.min(axis=0), every.max(axis=0)


def extent(rig: Rig) -> float:
    """Diagonal of the bounds, m; at least a centimetre, so that things have a size."""
    low, high = bounds(rig)
    return float(max(np.linalg.norm(high - low), 0.01))


def ellipsoid(covariance: Floats) -> tuple[Floats, Floats]:
    """Half sizes (3,) of one sigma and axes (3, 3), right-handed columns, of a covariance of a position (3, 3).

    A point, which shows nothing, where the covariance is not known.
    """
    if not np.isfinite(covariance).all():
        return np.zeros(3), np.eye(3)
    variances, axes = np.linalg.eigh(covariance)
    axes = axes * np.sign(np.linalg.det(axes))
    return np.sqrt(np.maximum(variances, 0)), axes


def magnification(rig: Rig) -> float:
    """A round factor that shows the largest position ellipsoid at some 4 % of the rig's extent."""
    largest = max((ellipsoid(rig.pose_covariance(camera.name)[3:, 3:])[0].max() for camera in rig.cameras), default=0)
    if not largest > 0:
        return 1.0
    return max(round_down(0.04 * extent(rig) / largest), 1.0)


def round_down(factor: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... or their fractions that is no more than a positive factor."""
    step = 10.0 ** np.floor(np.log10(factor))
    return float(step * next(digit for digit in (5, 2, 1) if digit * step <= factor))


def level_axes(rig: Rig) -> Floats:
    """Rows right, ahead and up (3, 3) of a level view of the rig: ahead is where the cameras look on the whole."""
    up = up_direction(rig)
    gaze = np.mean([camera.rig_from_camera.rotation[:, 2] for camera in rig.cameras], axis=0)
    ahead = gaze - up * (up @ gaze)
    if np.linalg.norm(ahead) < 1e-3:
        ahead = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 0.0, 1.0])
    ahead = ahead / np.linalg.norm(ahead)
    return np.stack([np.cross(ahead, up), ahead, up])


@dataclass(frozen=True, eq=False)
class Eye:
    """From where a rig is looked at first: position, what lies in the middle of the view, and up, each (3,)."""

    position: Floats
    target: Floats
    up: Floats

    def look(self, points: Floats) -> Floats:
        """Tangents (N, 2) to the right and up, and depths: (N, 3) of points (N, 3)."""
        ahead = (self.target - self.position) / np.linalg.norm(self.target - self.position)
        right = np.cross(ahead, self.up)
        right = right / np.linalg.norm(right)
        offset = points - self.position
        depth = np.maximum(offset @ ahead, 1e-6)
        return np.stack([offset @ right / depth, offset @ np.cross(right, ahead) / depth, depth], axis=-1)


def first_eye(rig: Rig) -> Eye:
    """From behind the cameras, to the right and above: cameras side by side stay apart."""
    right, ahead, up = level_axes(rig)
    low, high = bounds(rig)
    middle, size = (low + high) / 2, extent(rig)
    return Eye(middle - 0.62 * size * ahead + 0.25 * size * right + 0.5 * size * up, middle, up)


def foot(rings: Floats, eye: Eye) -> Floats:
    """Below the middle of outlines (K, 5, 3), where their lowest corner ends: a name there covers none of them."""
    middle = rings[:, :4].mean(axis=(0, 1))
    return middle + ((rings - middle) @ eye.up).min() * eye.up


# A name's width, for each letter and beyond, and height, in tangents of a view of 55 degrees and some 460 points.
_LETTER, _MARGIN, _LINE = 0.019, 0.045, 0.06


def apart(eye: Eye, names: Sequence[str], anchors: Floats) -> Floats:
    """Where names at anchors (N, 3) are put, (N, 3): each stays or goes up until it is clear of those before it."""
    looks = eye.look(anchors)
    rise = rises(looks[:, :2], names, _LETTER, _MARGIN, _LINE)
    return (anchors + (rise * looks[:, 2])[:, None] * eye.up).reshape(-1, 3)


def rises(anchors: Floats, names: Sequence[str], letter: float, margin: float, line: float) -> Floats:
    """How far up (N,) each name goes from its anchor (N, 2), y upwards, to be clear of those before it.

    letter: width of a letter; margin: of the rest; line: height of a name; all in the units of the anchors.
    """
    taken: list[tuple[float, float, float]] = []
    found = np.zeros(len(names))
    for index, (name, (x, y)) in enumerate(zip(names, anchors, strict=True)):
        half = (letter * len(name) + margin) / 2
        while any(abs(x - u) < half + w and abs(y + found[index] - v) < line for u, v, w in taken):
            found[index] += line / 2
        taken.append((x, y + found[index], half))
    return found


def beside(boxes: Floats, sizes: Floats, room: tuple[float, float], gap: float) -> Floats:
    """Top middles (N, 2) of names of these sizes (N, 2), below, above, right or left of boxes (N, 4: x0 y0 x1 y1, y
    downwards), on no box and on no other name, inside a picture; nan where a name finds no room."""
    taken = list(boxes)
    found = np.full((len(boxes), 2), np.nan)
    for index, (box, (wide, high)) in enumerate(zip(boxes, sizes, strict=True)):
        x, y = (box[0] + box[2]) / 2, (box[1] + box[3] - high) / 2
        places = [(x, box[3] + gap), (x, box[1] - gap - high)]
        places += [(box[2] + gap + wide / 2, y), (box[0] - gap - wide / 2, y)]
        for place in places:
            own = np.array([place[0] - wide / 2, place[1], place[0] + wide / 2, place[1] + high])
            inside = own.min() >= 0 and own[2] <= room[0] and own[3] <= room[1]
            if inside and not any((own[:2] < other[2:]).all() and (other[:2] < own[2:]).all() for other in taken):
                taken.append(own)
                found[index] = place
                break
    return found
