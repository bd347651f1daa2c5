"""What limits a calibration from one View, in words, with figures: what a better View would give."""

from typing import Protocol

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_vector

# A focal known better than this needs no advice: other errors (the lens, the flatness of the sheet) are larger.
_GOOD_FOCAL = 0.005
# The tilt at which a sheet is advised to be held: beyond it little is gained and corners blur.
_ADVISED_TILT = np.radians(40.0)
# Below this share of it a tilt is small; what room there must be to say "nearer", and how much nearer is sensible.
_TILTED_ENOUGH, _LEAST_NEARER, _MOST_NEARER = 0.75, 1.5, 4.0
# An improvement is worth saying where it takes a third off the sigma.
_WORTH_SAYING = 2 / 3


def view_tilt(camera_from_rect: Pose) -> Floats:
    """Angle (...) in radians between the sheet's normal and the line of sight to its middle."""
    translation = camera_from_rect.translation
    sight = translation / np.linalg.norm(translation, axis=-1, keepdims=True)
    return np.arccos(np.clip((camera_from_rect.rotation[..., 2] * sight).sum(axis=-1), -1, 1))


class Expected(Protocol):
    """The sigma of a focal over the focal as it would be with the rectangle at another pose, and where the principal
    point is known, or what the lens distorts."""

    def __call__(self, pose: Pose, *, centre_known: bool = False, distortion_known: bool = False) -> float: ...


def focal_advice(
    points: Floats,
    focal: float,
    camera_from_rect: Pose,
    expected: Expected,
    relative_sigma: float,
    principal_point_sigma: float,
    image_size: tuple[int, int],
) -> list[str]:
    """Sentences on what would make the focal better known, the most useful first; none where it is good.

    points (P, 3) metres and the pose and focal px found; relative_sigma: sigma of the focal over the focal;
    principal_point_sigma: px, how well that is known; image_size: width and height px, which bound how near the sheet
    can come.
    """
    if not np.isfinite(focal) or relative_sigma < _GOOD_FOCAL:
        return []
    tilt, known = float(view_tilt(camera_from_rect)), f"the focal is known to {percent(relative_sigma)}"
    options: list[tuple[float, str, str]] = []
    if tilt < _TILTED_ENOUGH * _ADVISED_TILT:
        better = expected(_tilted(camera_from_rect, _ADVISED_TILT))
        words = f"tilt the sheet more: at {np.degrees(tilt):.0f} degrees"
        options.append((better, words, f"at {np.degrees(_ADVISED_TILT):.0f} degrees"))
    scale = min(_room(points, focal, camera_from_rect, image_size), _MOST_NEARER)
    if scale > _LEAST_NEARER:
        nearer = Pose(camera_from_rect.rotation, camera_from_rect.translation / scale)
        words = "bring the sheet nearer, so that it fills the picture:"
        options.append((expected(nearer), words, f"at 1/{scale:.1f} of the distance"))
    if principal_point_sigma > 0:
        words = f"the principal point is only known to {principal_point_sigma:.0f} px:"
        options.append((expected(camera_from_rect, centre_known=True), words, "with the principal point given"))
    words = f"{len(points)} points cannot show all that the lens distorts:"
    options.append((expected(camera_from_rect, distortion_known=True), words, "with that known"))
    worth = sorted(option for option in options if option[0] < _WORTH_SAYING * relative_sigma)
    if not worth:
        return [f"{known}: take more points of the sheet, or several Views with one camera"]
    return [f"{words} {known}, {then} it would be {percent(promised)}" for promised, words, then in worth]


def percent(share: float) -> str:
    """A share in per cent with two figures that matter; beyond all bounds in words."""
    if not np.isfinite(share) or share > 1:
        return "no more than its order of magnitude"
    return f"{100 * share:.2g} %"


def _tilted(camera_from_rect: Pose, tilt: float) -> Pose:
    """The sheet at the same position, tilted further the way it leans."""
    sight = camera_from_rect.translation / np.linalg.norm(camera_from_rect.translation)
    normal = camera_from_rect.rotation[:, 2]
    axis = np.cross(sight, normal)
    size = np.linalg.norm(axis)
    # A sheet that faces the camera leans no way: take the picture's vertical.
    axis = axis / size if size > 1e-6 else np.cross(sight, [0.0, 1.0, 0.0])
    axis = axis / np.linalg.norm(axis)
    angle = tilt - float(view_tilt(camera_from_rect))
    return Pose(rotation_from_vector(axis * angle) @ camera_from_rect.rotation, camera_from_rect.translation)


def _room(points: Floats, focal: float, camera_from_rect: Pose, image_size: tuple[int, int]) -> float:
    """How many times larger the sheet could appear before it is larger than the picture."""
    located = camera_from_rect.transform(points)
    seen = focal * located[:, :2] / located[:, 2:]
    extent = np.ptp(seen, axis=0)
    return float(np.min(0.95 * np.array(image_size) / np.maximum(extent, 1e-9)))
