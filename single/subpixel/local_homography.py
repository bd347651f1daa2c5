"""Many small homographies at once: where a point of a plane lies, by the known points around it."""

import numpy as np

from quadrig.single.arrays import Floats


def local_homographies(plane: Floats, image: Floats) -> Floats:
    """Homographies (N, 3, 3), last entry 1, of N sets of points: plane (N, P, 2) to image (N, P, 2); P >= 4.

    Least squares of the linear equations (Hartley and Zisserman 4.1), with the last entry set to 1: the plane's
    origin must be seen, as it is where each set surrounds or adjoins it. Plane points should be of the order of 1.
    nan where the points of a set do not fix a homography.
    """
    centre = image.mean(axis=1, keepdims=True)
    scale = np.maximum(np.abs(image - centre).max(axis=(1, 2), keepdims=True), 1e-9)
    x, y = plane[..., 0], plane[..., 1]
    u, v = np.moveaxis((image - centre) / scale, -1, 0)
    one, zero = np.ones_like(x), np.zeros_like(x)
    rows = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y], axis=-1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y], axis=-1),
        ],
        axis=1,
    )
    normal = np.swapaxes(rows, 1, 2) @ rows
    right = (np.swapaxes(rows, 1, 2) @ np.concatenate([u, v], axis=1)[..., None])[..., 0]
    # Points in one line leave a null direction: its eigenvalue is that of rounding, 1e-10 of the largest or less.
    values = np.linalg.eigvalsh(normal)
    fixed = values[:, 0] > 1e-9 * values[:, -1]
    solution = np.full((len(plane), 9), np.nan)
    solution[:, 8] = 1
    if fixed.any():
        solution[fixed, :8] = np.linalg.solve(normal[fixed], right[fixed][..., None])[..., 0]
    homography = solution.reshape(-1, 3, 3)
    shift = np.zeros((len(plane), 3, 3))
    shift[:, [0, 1], [0, 1]] = scale[:, 0]
    shift[:, :2, 2] = centre[:, 0]
    shift[:, 2, 2] = 1
    return shift @ homography


def square_homographies(corners: Floats) -> Floats:
    """Homographies (N, 3, 3) from the unit square, (0, 0), (1, 0), (1, 1), (0, 1), to corners (N, 4, 2), in closed
    form (Heckbert, 1989, section 2.2.3). Not finite where three corners lie in one line."""
    first, second, third, fourth = np.moveaxis(corners, 1, 0)
    across, down, skew = second - third, fourth - third, first - second + third - fourth
    with np.errstate(divide="ignore", invalid="ignore"):
        g, h = (
            (one[:, :1] * other[:, 1:] - one[:, 1:] * other[:, :1])
            / (across[:, :1] * down[:, 1:] - across[:, 1:] * down[:, :1])
            for one, other in ((skew, down), (across, skew))
        )
        columns = second - first + g * second, fourth - first + h * fourth, first
    homography = np.ones((len(corners), 3, 3))
    homography[:, :2] = np.stack(columns, axis=2)
    homography[:, 2:, 0], homography[:, 2:, 1] = g, h
    return homography


def mapped(homographies: Floats, points: Floats) -> Floats:
    """Image points (N, Q, 2) of plane points (N, Q, 2) or (Q, 2)."""
    points = np.broadcast_to(points, (len(homographies), *points.shape[-2:]))
    seen = points @ np.swapaxes(homographies[:, :, :2], 1, 2) + homographies[:, None, :, 2]
    return seen[..., :2] / seen[..., 2:]
