"""The homography between a rectangle and its picture, in batches."""

import numpy as np

from quadrig.single.arrays import Floats


def homographies(points: Floats, pixels: Floats, weights: Floats | None = None) -> Floats:
    """H (..., 3, 3) with pixels ~ H (x, y, 1), least squares of the linear form (Hartley and Zisserman, 4.1).

    points (..., P, 2) in the plane, pixels (..., P, 2), P >= 4; weights (..., P): zero leaves a point out. The last
    element is 1: the middle of the points must not lie on the horizon, which is so wherever all points are seen.
    Exact for exact points. nan where the points do not determine a homography: fewer than four
    places, or three of four on a line.
    """
    points, pixels = np.asarray(points, float), np.asarray(pixels, float)
    weights = np.ones(pixels.shape[:-1]) if weights is None else np.asarray(weights, float)
    plane, from_points = _normalised(points, weights)
    image, from_pixels = _normalised(pixels, weights)
    shape = np.broadcast_shapes(plane.shape, image.shape)[:-1]
    rows = np.zeros((*shape, 2, 9))
    rows[..., 0, :2] = rows[..., 1, 3:5] = plane
    rows[..., 0, 2] = rows[..., 1, 5] = 1
    rows[..., :, 6:8] = -image[..., :, None] * plane[..., None, :]
    rows[..., :, 8] = image
    rows *= np.sqrt(weights)[..., None, None]
    flat = rows.reshape(*shape[:-1], 2 * shape[-1], 9)
    gram = np.swapaxes(flat, -1, -2) @ flat
    solution = _solve_each(gram[..., :8, :8], gram[..., :8, 8])
    normalised = np.concatenate([solution, np.ones((*solution.shape[:-1], 1))], axis=-1)
    result = np.linalg.inv(from_pixels) @ normalised.reshape(*solution.shape[:-1], 3, 3) @ from_points
    return result / result[..., 2:, 2:]


def _solve_each(matrices: Floats, right: Floats) -> Floats:
    """Each symmetric system of a batch; nan for those that are singular, which must not cost the others an answer."""
    size = matrices.shape[-1]
    unknown = ~np.all(np.isfinite(matrices), axis=(-1, -2))
    safe = np.where(unknown[..., None, None], np.eye(size), matrices)
    eigenvalues = np.linalg.eigvalsh(safe)
    # The smallest over the largest: the corners of a rectangle seen at 80 degrees give 3e-3, points on a line the
    # rounding of 1e-16. What lies below this has lost all digits but four.
    singular = unknown | (eigenvalues[..., 0] < 1e-12 * eigenvalues[..., -1])
    safe = np.where(singular[..., None, None], np.eye(size), safe)
    return np.where(singular[..., None], np.nan, np.linalg.solve(safe, right[..., None])[..., 0])


def _normalised(points: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Points about their mean with unit spread (..., P, 2), and the similarity (..., 3, 3) that made them so."""
    total = weights.sum(axis=-1)[..., None]
    mean = (points * weights[..., None]).sum(axis=-2) / total
    centred = points - mean[..., None, :]
    spread = np.sqrt(((centred**2) * weights[..., None]).sum(axis=(-1, -2)) / (2 * total[..., 0]))
    scale = 1 / np.where(spread > 0, spread, 1.0)
    similarity = np.zeros((*scale.shape, 3, 3))
    similarity[..., 0, 0] = similarity[..., 1, 1] = scale
    similarity[..., :2, 2] = -mean * scale[..., None]
    similarity[..., 2, 2] = 1
    return centred * scale[..., None, None], similarity
