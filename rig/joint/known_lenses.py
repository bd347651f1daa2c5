"""Lenses known before: what all Views together say of a lens, and whether new ones contradict what was known."""

from dataclasses import replace

import numpy as np

from quadrig.rig.adjustment.priors import lens_evidence
from quadrig.rig.adjustment.state import LENS
from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import CAMERA_PARAMETERS, Camera
from quadrig.single.arrays import Floats
from quadrig.single.lens_prior import LensEvidence

# Lenses that differ by this many of their common sigmas, in the mean of what can be compared, are two lenses: bent
# boards and what lenses leave over are in those sigmas already, and one lens differs from itself by 0.6 to 1.3.
_ANOTHER_LENS = 3.0
# A fit that gives up so many of a camera's Views does so for the sake of its lens: wrong ids and instants are fewer.
_GIVEN_UP = 0.3
# What Views say that is less than this share of what was known compares nothing.
_COMPARABLE = 0.1


def with_evidence(
    problem: Problem, joint: Joint, cameras: tuple[Camera, ...], covariance: Floats
) -> tuple[tuple[Camera, ...], tuple[str, ...]]:
    """The cameras with what all Views say of their lenses, those of earlier calibrations among them; and a sentence
    for each whose Views contradict the lens that was known. covariance (15 C, 15 C): as Rig.covariance has it."""
    number = np.arange(len(cameras))
    blocks = covariance.reshape(len(cameras), CAMERA_PARAMETERS, len(cameras), CAMERA_PARAMETERS)
    own = blocks[number, :LENS, number, :LENS]
    lens = np.array([camera.intrinsics.parameters for camera in cameras])
    pulls, informations = lens_evidence(joint.priors, joint.free.lens, lens, own)
    result, sentences = [], []
    for row, (camera, given) in enumerate(zip(cameras, problem.cameras, strict=True)):
        seen = LensEvidence(pulls[row], informations[row])
        result.append(replace(camera, lens_evidence=_together(given, seen)))
        if given.lens_covariance is not None or given.lens_evidence is not None:
            away = _sigmas_away(joint.priors.mean[row], joint.free.information[row], seen)
            lost = joint.inliers.rejected[problem.camera == row]
            if away > _ANOTHER_LENS or lost.mean() > _GIVEN_UP:
                how = f"{away:.0f} sigmas" if away > _ANOTHER_LENS else f"{lost.sum()} of {len(lost)} were rejected"
                sentences.append(
                    f"{camera.name}: its Views contradict the lens that was known ({how}): look whether focus, zoom "
                    "or crop were changed or it is another camera's, and calibrate without it"
                )
    return tuple(result), tuple(sentences)


def _together(given: CameraInput, seen: LensEvidence) -> LensEvidence | None:
    """What Views said before and now; None for a lens that was held in part: they said what they did of the rest of
    it alone."""
    if given.lens_covariance is not None or given.fixed or given.lens not in ("auto", "full", "fisheye"):
        return None
    before = given.lens_evidence
    return seen if before is None else LensEvidence(seen.pull + before.pull, seen.information + before.information)


def _sigmas_away(mean: Floats, information: Floats, seen: LensEvidence) -> float:
    """How far what Views say lies from a prior, mean (9,) and information (9, 9), in their common sigmas."""
    free = np.diag(information) > 0
    if not free.any():
        return 0.0
    half = np.linalg.cholesky(information[np.ix_(free, free)])
    inverse = np.linalg.inv(half)
    pull = inverse @ (seen.pull - seen.information @ mean)[free]
    # In units of the prior the data's information is `values` along `axes`, and their pull there has the variance
    # values + values^2 where both are of one lens.
    values, axes = np.linalg.eigh(inverse @ seen.information[np.ix_(free, free)] @ inverse.T)
    known = values > _COMPARABLE
    square = (axes.T @ pull)[known] ** 2 / (values + values**2)[known]
    return float(np.sqrt(square.mean())) if known.any() else 0.0
