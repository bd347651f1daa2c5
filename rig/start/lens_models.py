"""Which model lenses have of which nothing is given: a pinhole, unless it misses what a fisheye meets."""

from dataclasses import replace

import numpy as np

from quadrig.rig.problem.build import Problem, of_cameras
from quadrig.rig.start.lenses_and_poses import FirstCameras, first_cameras
from quadrig.single.lens import LENS_PARAMETERS

# A first lens that misses its corners by so many times their noise may be of another model, which is tried.
_MISSED = 2.5
# By how much less a fisheye must miss: where both can bend as the lens does, a pinhole is what other software knows.
_BETTER = 0.5
# Degrees of freedom of a camera's Views, its lens's own taken off, from which so much less is no chance: the odds are
# 2 to that power, and one lens in ten is a fisheye. Fewer cannot tell.
_ENOUGH = 40
# Steps by which lenses of both models are compared: what a fit is short of is not to be taken for a model's fault. Of
# pinholes whose first focal is far off, 15 are too few.
_STEPS = 40


def with_lens_models(problem: Problem, alone: FirstCameras) -> tuple[Problem, FirstCameras]:
    """The problem with fisheyes where the Views show them, and its cameras each by itself. alone: as it was given."""
    freedom = np.bincount(problem.camera, [2 * len(view.pixels) - 6 for view in problem.views], len(problem.cameras))
    open_ = (alone.misfit > _MISSED * problem.expected_noise) & (freedom - len(LENS_PARAMETERS) > _ENOUGH)
    nothing_given = [camera.intrinsics is None and camera.lens == "auto" for camera in problem.cameras]
    tried = np.flatnonzero(open_ & nothing_given).tolist()
    if not tried:
        return problem, alone
    as_pinholes = of_cameras(problem, tried)
    wide = tuple(replace(camera, lens="fisheye") for camera in as_pinholes.cameras)
    misfits = [first_cameras(p, _STEPS).misfit for p in (as_pinholes, replace(as_pinholes, cameras=wide))]
    names = {camera.name for camera, one, other in zip(wide, *misfits, strict=True) if other < _BETTER * one}
    if not names:
        return problem, alone
    cameras = [replace(c, lens="fisheye") if c.name in names else c for c in problem.cameras]
    found = replace(problem, cameras=tuple(cameras))
    return found, first_cameras(found, _STEPS)
