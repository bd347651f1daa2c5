"""What is known of a lens before its Views speak, and what of that stays in doubt when they did."""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.camera_input import LensChoice
from quadrig.single.arrays import Floats, Mask
from quadrig.single.lens import LENS_PARAMETERS
from quadrig.single.lens_prior import LensClasses, lens_classes

# So many points, spread over a board, determine a pose and a lens well enough to start from: every point has its say
# at the end.
ENOUGH_POINTS = 16
# What others follow is good enough once a step would lower chi-square by this little: three sigmas of one number,
# of the hundreds that are estimated.
ROUGH = 10.0

_FISHEYE_LENS = ("focal", "cx", "cy", "k1", "k2", "p1", "p2", "aspect")
"""A fisheye's k3 and k4 stand in the places of p1 and p2."""

_ESTIMATED: dict[LensChoice, tuple[str, ...]] = {
    "f": ("focal",),
    "f k1": ("focal", "k1"),
    "f k1 k2": ("focal", "k1", "k2"),
    "f c k1 k2": ("focal", "cx", "cy", "k1", "k2"),
    "full": LENS_PARAMETERS,
    "fisheye": _FISHEYE_LENS,
}


@dataclass(frozen=True, eq=False)
class LensPriors:
    """Gaussian priors of the lenses of all cameras: mean (C, 9), information (C, 9, 9). kinds (C, 6): how likely each
    of lens_prior.CLASS_NAMES is for each camera. focal_share (C,): what share of the information on its focal is
    real; its prior is held as much more firmly in the fit, and its variance is as much larger after it."""

    mean: Floats
    information: Floats
    kinds: Floats
    focal_share: Floats

    def holding_focals(self, share: Floats) -> "LensPriors":
        """The same where only a share (C,) of the information on the focals is real."""
        information = self.information.copy()
        information[:, 0, 0] *= self.focal_share / share
        return replace(self, information=information, focal_share=share)


def estimated_lenses(problem: Problem) -> Mask:
    """Which parameters (C, 9) of the lenses are estimated: all that the model has, or those that were asked for."""
    free = np.zeros((len(problem.cameras), len(LENS_PARAMETERS)), bool)
    for row, (camera, model) in enumerate(zip(problem.cameras, problem.models, strict=True)):
        names = _ESTIMATED.get(camera.lens, LENS_PARAMETERS if model == "pinhole" else _FISHEYE_LENS)
        if not camera.fixed:
            free[row] = [name in names for name in LENS_PARAMETERS]
        if camera.lens_covariance is not None:
            free[row] &= np.diag(camera.lens_covariance) > 0
    return free


def first_priors(problem: Problem, focal: Floats) -> LensPriors:
    """The priors before any data of this problem; focal (C,) px: about which they are linearised."""
    pull, information = _earlier_evidence(problem)
    classes = _classes(problem, focal)
    if information.any():
        classes = replace(classes, weight=classes.weigh(pull, information))
    return _priors(problem, classes)


def weighed_priors(problem: Problem, before: LensPriors, free: Mask, lens: Floats, covariance: Floats) -> LensPriors:
    """The priors with the classes weighed by the data.

    before: the priors of the fit that gave lens (C, 9) with covariance (C, 9, 9); free (C, 9): what it estimated.
    """
    pull, information = lens_evidence(before, free, lens, covariance)
    earlier = _earlier_evidence(problem)
    classes = _classes(problem, lens[:, 0])
    weight = classes.weigh(pull + earlier[0], information + earlier[1])
    return _priors(problem, replace(classes, weight=weight)).holding_focals(before.focal_share)


def lens_evidence(before: LensPriors, free: Mask, lens: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """What the Views alone say of each lens: pull (C, 9) and information (C, 9, 9) as LensEvidence has them.

    before: the priors of the fit that gave lens (C, 9) with covariance (C, 9, 9); free (C, 9): what it estimated.
    """
    scale = 1 / np.sqrt(np.diagonal(before.information, axis1=1, axis2=2))
    square = scale[:, :, None] * scale[:, None, :]
    both = free[:, :, None] & free[:, None, :]
    held = np.where(both, before.information * square, 0.0)
    # Of data and prior together, in units of the prior; what is not estimated says nothing.
    own = np.linalg.inv(np.where(both, covariance / square, np.eye(len(LENS_PARAMETERS))))
    values, axes = np.linalg.eigh(np.where(both, own, 0.0) - held)
    data = (axes * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(axes, 1, 2)
    away = np.where(free, (lens - before.mean) / scale, 0.0)
    # Data' pull is P^-1 x - Q m for the posterior (x, P) and the prior (m, Q): P^-1 (x - m) about m.
    pull = (np.where(both, own, 0.0) @ away[..., None])[..., 0] + (data @ (before.mean / scale)[..., None])[..., 0]
    return pull / scale, data / square


def _earlier_evidence(problem: Problem) -> tuple[Floats, Floats]:
    """What Views of earlier calibrations said of the lenses: pull (C, 9) and information (C, 9, 9), zero for none."""
    size, cameras = len(LENS_PARAMETERS), problem.cameras
    pull, information = np.zeros((len(cameras), size)), np.zeros((len(cameras), size, size))
    for row, camera in enumerate(cameras):
        if camera.lens_evidence is not None:
            pull[row], information[row] = camera.lens_evidence.pull, camera.lens_evidence.information
    return pull, information


def _classes(problem: Problem, focal: Floats) -> LensClasses:
    sizes = [(camera.width, camera.height) for camera in problem.cameras]
    # Evidence speaks for itself, through the classes: the lens that comes with it is where a fit begins.
    given = [(None if c.lens_evidence is not None else c.intrinsics, c.lens_covariance) for c in problem.cameras]
    return lens_classes(sizes, focal, problem.models, given)


def _priors(problem: Problem, classes: LensClasses) -> LensPriors:
    """The Gaussian of the classes as they are weighed, and with it what earlier Views said."""
    mean, own = classes.gaussian()
    pull, earlier = _earlier_evidence(problem)
    scale = 1 / np.sqrt(np.diagonal(own, axis1=1, axis2=2))
    # With the earlier Views' pull h and information L the mean moves by (Q + L)^-1 (h - L m).
    both = own + earlier
    short = scale * (pull - (earlier @ mean[..., None])[..., 0])
    moved = np.linalg.solve(both * scale[:, :, None] * scale[:, None, :], short[..., None])[..., 0]
    return LensPriors(mean + scale * moved, both, classes.kinds(), np.ones(len(mean)))
