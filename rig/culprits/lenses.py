"""Lenses that were given and are not those that the Views show."""

from collections.abc import Sequence
from dataclasses import replace

from quadrig.rig.joint.clock_rounds import Solved
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.rig.words import with_sigma
from quadrig.single.lens_prior import GIVEN_KIND

# A lens that was given is none that the Views allow once its class is as improbable as this beside all others.
_IMPROBABLE = 0.01


def freed(problem: Problem) -> Problem:
    """The problem with every lens that is fixed estimated from what is given."""
    return replace(problem, cameras=tuple(replace(camera, fixed=False) for camera in problem.cameras))


def wrong_lenses(solved: Solved) -> set[str]:
    """The cameras whose Views rule out the lens that was given, of those whose lens was estimated. What earlier Views
    said is in no class of its own: whether these contradict them is known_lenses' to say."""
    improbable = solved.joint.priors.kinds[:, GIVEN_KIND] < _IMPROBABLE
    return {
        camera.name
        for camera, is_wrong in zip(solved.problem.cameras, improbable, strict=True)
        if is_wrong and camera.intrinsics is not None and not camera.fixed and camera.lens == "auto"
        if camera.lens_evidence is None
    }


def lens_sentences(given: Sequence[CameraInput], wrong: set[str], rig: Rig) -> list[str]:
    """What to say of the lenses that were given and are wrong, and whether all corners speak for another size."""
    sentences = []
    for one in given:
        if one.name in wrong and one.intrinsics is not None:
            lens = rig.camera(one.name).intrinsics
            held = ", fixed though it was," if one.fixed else ""
            sentences.append(
                f"{one.name}: the lens that was given (focal {one.intrinsics.focal:.0f} px){held} is not the one "
                f"that its Views show ({with_sigma(lens.focal, rig.focal_sigma(one.name))} px), which was taken: "
                "check that it is this camera's, at this zoom and size of picture"
            )
    return sentences
