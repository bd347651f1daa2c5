"""How far off the directions of a camera's pixels may be, from the doubt of its lens alone."""

import numpy as np

from quadrig.rig.result import Rig
from quadrig.rig.words import length
from quadrig.single.lens import project_with_derivatives
from quadrig.single.rotation import cross_matrix

# Fields across and down whose middles stand for the picture: more change the figure by less than its second digit.
_FIELDS = 8
# Of the picture's width: a guess from its size alone is hardly worse.
_NO_LENS = 0.1
# Of what was seen, what two cameras saw: below this share the volume that was covered is not one to triangulate in.
_MOSTLY = 0.5


def lens_accuracy(rig: Rig, name: str) -> float:
    """Sigma (px) of where a camera sees a point far away, along the worse axis, root mean square over its picture.

    The part that is one rotation of the camera is taken out: that is its pose's doubt, not the lens's. nan where the
    doubt of the lens is not known, or no pixel has a direction. Raises KeyError where there is no such camera.
    """
    lens = rig.camera(name).intrinsics
    middles = (np.arange(_FIELDS) + 0.5) / _FIELDS
    across, down = np.meshgrid(middles * lens.width - 0.5, middles * lens.height - 0.5)
    rays = lens.unproject(np.column_stack([across.ravel(), down.ravel()]))
    rays, covariance = rays[np.isfinite(rays).all(axis=1)], rig.lens_covariance(name)
    if len(rays) < 3 or not np.isfinite(covariance).all():
        return float("nan")
    _, by_lens, by_ray = project_with_derivatives(lens.parameters, rays, lens.model)
    turning, _ = np.linalg.qr((by_ray @ cross_matrix(rays)).reshape(-1, 3))
    moved = by_lens.reshape(-1, by_lens.shape[-1])
    shape = (moved - turning @ (turning.T @ moved)).reshape(by_lens.shape)
    blocks = shape @ covariance @ np.swapaxes(shape, -1, -2)
    return float(np.sqrt(np.maximum(np.linalg.eigvalsh(blocks)[:, -1], 0).mean()))


def accuracy_in_words(rig: Rig) -> str:
    """What a rig is good for: points in the volume it covered; where its cameras are, if it is carried and hardly two
    of them see one place; directions, where it is of one camera."""
    if len(rig.cameras) > 1 and poses_alone(rig):
        shift = accuracy(rig)
        turn = np.degrees(max(rig.rotation_sigma(camera.name) for camera in rig.cameras))
        known = f"{length(shift)} and {turn:.2g} degrees"
        return f"where its cameras are, to {known} (what one of them sees hardly another does)"
    if len(rig.cameras) > 1:
        return f"{length(rig.working_accuracy)} in the volume you covered"
    camera = next(iter(rig.cameras))
    sigma = lens_accuracy(rig, camera.name)
    if not np.isfinite(sigma):
        return "an unknown accuracy"
    degrees = np.degrees(sigma / camera.intrinsics.focal)
    return f"directions to {sigma:.2g} px ({degrees:.2g} degrees) over the picture of {camera.name}"


def is_determined(rig: Rig) -> bool:
    """Whether a rig has the figure that heads it: of points, of poses where it is carried, or of directions where it
    is of one camera."""
    if len(rig.cameras) > 1:
        return bool(np.isfinite(rig.working_accuracy)) or poses_alone(rig)
    camera = next(iter(rig.cameras))
    # A lens that was only given has no sigma.
    return bool(0 < lens_accuracy(rig, camera.name) < _NO_LENS * camera.intrinsics.width)


def accuracy(rig: Rig) -> float:
    """The working accuracy, m, or of a rig that is for poses alone the sigma of the camera that is least sure."""
    if not poses_alone(rig):
        return rig.working_accuracy
    return max(rig.position_sigma(camera.name) for camera in rig.cameras)


def poses_alone(rig: Rig) -> bool:
    """Whether a rig is carried and most of what was seen was seen by one of its cameras, so that poses are all that
    it is for: in slivers that two cameras share at the rims of their pictures no point is triangulated well."""
    if rig.room is None or not rig.is_doubt_known:
        return False
    return not np.isfinite(rig.working_accuracy) or _shared(rig) < _MOSTLY


def _shared(rig: Rig) -> float:
    """Of what was seen, a rectangle at a time, the share that two cameras saw or more; 1 where no View is known."""
    watchers: dict[tuple[str, int], set[str]] = {}
    for fit in rig.fits:
        if not fit.rejected:
            watchers.setdefault((fit.view.rectangle, fit.view.frameset), set()).add(fit.view.camera)
    return float(np.mean([len(cameras) > 1 for cameras in watchers.values()])) if watchers else 1.0
