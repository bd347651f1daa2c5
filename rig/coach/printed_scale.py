"""Whether the sizes of rectangles agree: a sheet printed at 97 % makes every camera stand 3 % too near."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.coach.fault import Fault
from quadrig.rig.doubt.information import scaled_inverse
from quadrig.rig.doubt.linear_rows import instances, pose_of, rows_of
from quadrig.rig.result import CAMERA_PARAMETERS, Rig
from quadrig.rig.words import WRONG_SIZE
from quadrig.single.arrays import Floats

# Printers err by more than this when they "fit to page" (94 to 98 %); a ruler reads an A4 sheet to 0.2 %.
_LEAST_ERROR = 0.004
# Five sigmas of the data's own noise: a false word in a million rigs.
_LEAST_SIGMAS = 5.0
# Sigma of each lens parameter beyond what the Views say (focal, cx, cy, k1, k2, p1, p2, k3, aspect): weak, so that
# two rectangles at one distance do not leave focal and scale to each other.
_LENS_PRIOR = np.array([500.0, 50.0, 50.0, 1.0, 1.0, 0.1, 0.1, 1.0, 0.1])


@dataclass(frozen=True, eq=False)
class Scales:
    """Size of each rectangle against its stated one, relative to the first: log ratio and sigma (R,)."""

    names: tuple[str, ...]
    log_ratio: Floats
    sigma: Floats


def scale_fault(rig: Rig) -> Fault | None:
    """Whether two rectangles' sizes disagree, in words: the rig's own, where it has found it."""
    said = [sentence for sentence in rig.weak if WRONG_SIZE in sentence]
    if said:
        return Fault("wrong scale", said[0])
    scales = relative_scales(rig)
    if scales is None:
        return None
    middle = float(np.median(scales.log_ratio)) if len(scales.names) > 2 else 0.0
    error = scales.log_ratio - middle
    doubt = np.maximum(scales.sigma, scales.sigma[scales.sigma > 0].min(initial=np.inf))
    worst = int(np.argmax(np.abs(error) / doubt))
    if abs(error[worst]) < max(_LEAST_ERROR, _LEAST_SIGMAS * doubt[worst]):
        return None
    name, percent = scales.names[worst], 100 * float(np.expm1(error[worst]))
    other = scales.names[0] if len(scales.names) == 2 else "the others"
    bigger = "larger" if percent > 0 else "smaller"
    return Fault(
        "wrong scale",
        f"{name} is {abs(percent):.1f} % {bigger} than its size in rig.toml says, if {other} is right; measure both "
        "with a ruler (printers shrink to fit) and correct rig.toml",
    )


def relative_scales(rig: Rig) -> Scales | None:
    """One Gauss-Newton step for the sizes of the rectangles, beside everything else the rig solved.

    None where fewer than two rectangles were used. The first rectangle's size is taken as true.
    """
    names = tuple(sorted({fit.view.rectangle for fit in rig.fits if pose_of(rig, fit) is not None}))
    if len(names) < 2:
        return None
    count = len(rig.cameras)
    size = count * (CAMERA_PARAMETERS + 1)
    normal, gradient = np.zeros((size + len(names),) * 2), np.zeros(size + len(names))
    for group in instances(rig):
        rows = rows_of(rig, rig.cameras, group)
        by_sizes = np.zeros((len(rows.by_size), len(names)))
        by_sizes[:, names.index(group[0].view.rectangle)] = rows.by_size
        by_all = np.concatenate([rows.by_cameras, rows.by_tones, by_sizes], axis=1)
        inner = np.linalg.pinv(rows.by_pose.T @ rows.by_pose) @ rows.by_pose.T
        projected = by_all - rows.by_pose @ (inner @ by_all)
        normal += projected.T @ projected
        gradient += projected.T @ rows.residuals
    noise = rig.noise if np.isfinite(rig.noise) and rig.noise > 0 else 1.0
    normal, gradient = normal / noise**2, gradient / noise**2
    prior = np.tile(np.concatenate([1 / _LENS_PRIOR**2, np.zeros(6)]), count)
    # A tone curve makes a tag look larger: as many sigmas as its Views leave open.
    normal[np.diag_indices(size)] += np.concatenate([prior, np.ones(count)])
    free = np.diag(normal) > 0
    free[_reference_rows(rig)] = False
    free[size] = False
    covariance = np.zeros_like(normal)
    covariance[np.ix_(free, free)] = scaled_inverse(normal[np.ix_(free, free)])
    step = covariance @ gradient
    # What the rig has found of a sheet's scale already is no residual any more.
    found = {placed.name: placed.shape.values[0] for placed in rig.rectangles if placed.shape is not None}
    known = np.array([found.get(name, 0.0) for name in names])
    ratio = step[size:] + known - known[0]
    return Scales(names, ratio, np.sqrt(np.maximum(np.diag(covariance)[size:], 0)))


def _reference_rows(rig: Rig) -> slice:
    """Pose rows that are held: the reference camera's, or the first one's where a rectangle is the reference."""
    names = [camera.name for camera in rig.cameras]
    start = (names.index(rig.reference) if rig.reference in names else 0) * CAMERA_PARAMETERS + 9
    return slice(start, start + 6)
