"""Residuals over the picture: a lens model that does not fit leaves a pattern behind, and this measures it."""

from dataclasses import dataclass

import numpy as np

from quadrig.single.rotation import Array

from .result import Rig

COLUMNS, ROWS = 8, 6
"""Fields of the picture, across and down, in which coverage and mean residuals are counted."""


@dataclass(frozen=True, eq=False)
class ResidualField:
    """Used corners of one camera. pixels (P, 2) and residuals (P, 2), px, seen minus predicted.

    counts (ROWS, COLUMNS): corners in each field of the picture; means (ROWS, COLUMNS, 2): mean residual there, nan
    in empty fields. pattern: by how much the means are larger than chance would have them (mean of the squared means
    over their variances): 1 where the lens fits. covered: share of the fields with a corner.
    """

    pixels: Array
    residuals: Array
    counts: Array
    means: Array
    pattern: float
    covered: float

    @property
    def lengths(self) -> Array:
        """Length of each residual (P,), px."""
        return np.linalg.norm(self.residuals, axis=1)


def residual_field(rig: Rig, camera: str) -> ResidualField:
    """The used residuals of a camera over its picture. Raises KeyError where the rig has no such camera."""
    lens = rig.camera(camera).intrinsics
    fits = [fit for fit in rig.fits if fit.view.camera == camera and not fit.rejected]
    pixels = np.concatenate([np.zeros((0, 2)), *(fit.view.pixels[fit.used] for fit in fits)])
    residuals = np.concatenate([np.zeros((0, 2)), *(fit.residuals[fit.used] for fit in fits)])
    told = np.isfinite(residuals).all(axis=1)
    pixels, residuals = pixels[told], residuals[told]
    column = np.clip((pixels[:, 0] + 0.5) * COLUMNS / lens.width, 0, COLUMNS - 1).astype(int)
    row = np.clip((pixels[:, 1] + 0.5) * ROWS / lens.height, 0, ROWS - 1).astype(int)
    field = row * COLUMNS + column
    counts = np.bincount(field, minlength=ROWS * COLUMNS)
    sums = np.stack([np.bincount(field, residuals[:, axis], ROWS * COLUMNS) for axis in (0, 1)], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = sums / counts[:, None]
    return ResidualField(
        pixels,
        residuals,
        counts.reshape(ROWS, COLUMNS),
        means.reshape(ROWS, COLUMNS, 2),
        _pattern(counts, means, residuals),
        float(np.mean(counts > 0)),
    )


def _pattern(counts: Array, means: Array, residuals: Array) -> float:
    # Fields of fewer corners say little of a mean, and one outlier there would speak for a pattern.
    told = counts >= 5
    variance = np.mean(residuals**2) if len(residuals) else 0.0
    if not told.any() or variance == 0:
        return float("nan")
    return float(np.mean(counts[told, None] * means[told] ** 2) / variance)
