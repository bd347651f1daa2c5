"""Residuals over the picture: a lens model that does not fit leaves a pattern behind, and this measures it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.rig.result import Rig, ViewFit
from quadrig.single.arrays import Floats, Ints

COLUMNS, ROWS = 8, 6
"""Fields of the picture, across and down, in which coverage and mean residuals are counted."""
_FEWEST_POSES = 4


@dataclass(frozen=True, eq=False)
class ResidualField:
    """Used corners of one camera. pixels (P, 2) and residuals (P, 2), px, seen minus predicted.

    counts (ROWS, COLUMNS): corners in each field of the picture; means (ROWS, COLUMNS, 2): mean residual there, nan
    in empty fields. pattern: how much more the residuals of different rectangle poses agree in a field than by
    chance: near 1 where the lens fits.
    """

    pixels: Floats
    residuals: Floats
    counts: Ints
    means: Floats
    pattern: float

    @property
    def lengths(self) -> Floats:
        """Length of each residual (P,), px."""
        return np.linalg.norm(self.residuals, axis=1)


def residual_field(rig: Rig, camera: str) -> ResidualField:
    """The used residuals of a camera over its picture. Raises KeyError where the rig has no such camera."""
    lens = rig.camera(camera).intrinsics
    fits = [fit for fit in rig.fits if fit.view.camera == camera and not fit.rejected]
    pixels = np.concatenate([np.zeros((0, 2)), *(fit.view.pixels[fit.used] for fit in fits)])
    residuals = np.concatenate([np.zeros((0, 2)), *(fit.residuals[fit.used] for fit in fits)])
    pose = np.repeat(_pose_numbers(rig, fits), [int(np.sum(fit.used)) for fit in fits])
    known = np.isfinite(residuals).all(axis=1)
    pixels, residuals, pose = pixels[known], residuals[known], pose[known]
    column = np.clip((pixels[:, 0] + 0.5) * COLUMNS / lens.width, 0, COLUMNS - 1).astype(int)
    row = np.clip((pixels[:, 1] + 0.5) * ROWS / lens.height, 0, ROWS - 1).astype(int)
    field = row * COLUMNS + column
    counts, means = _means(field, residuals, ROWS * COLUMNS)
    return ResidualField(
        pixels,
        residuals,
        counts.reshape(ROWS, COLUMNS),
        means.reshape(ROWS, COLUMNS, 2),
        _pattern(field, pose, residuals),
    )


def _pose_numbers(rig: Rig, fits: Sequence[ViewFit]) -> Ints:
    """A number for each pose of a rectangle: one for all framesets of a static one."""
    moving = {placed.name for placed in rig.rectangles if placed.rectangle.moving}
    keys = [(fit.view.rectangle, fit.view.frameset if fit.view.rectangle in moving else -1) for fit in fits]
    number = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    return np.array([number[key] for key in keys], int)


def _means(field: Ints, residuals: Floats, total: int) -> tuple[Ints, Floats]:
    """Counts (total,) and mean residuals (total, 2), nan where there are none."""
    counts = np.bincount(field, minlength=total)
    sums = np.stack([np.bincount(field, residuals[:, axis], total) for axis in (0, 1)], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return counts, sums / counts[:, None]


def _pattern(field: Ints, pose: Ints, residuals: Floats) -> float:
    """Corners of one pose err together (it moved, it bends), and those of a static rectangle err alike again and
    again: what its mean is in a field is one sample."""
    if not len(field):
        return float("nan")
    keys, inverse = np.unique(np.column_stack([field, pose]), axis=0, return_inverse=True)
    _, samples = _means(inverse.ravel(), residuals, len(keys))
    counts, means = _means(keys[:, 0], samples, ROWS * COLUMNS)
    # Fields of fewer poses say little of a mean, and one outlier there would speak for a pattern.
    enough = counts >= _FEWEST_POSES
    variance = np.mean(samples**2)
    if not enough.any() or variance == 0:
        return float("nan")
    return float(np.mean(counts[enough, None] * means[enough] ** 2) / variance)
