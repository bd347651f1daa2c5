"""What is taken for granted of a lens before its Views speak."""

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.single.arrays import Floats
from quadrig.single.lens import LENS_PARAMETERS, image_middle

# Less than any detector's noise (px): keeps a View that its own few unknowns explain wholly from infinite weight.
LEAST_NOISE = 0.02
# Standard deviations of lens parameters before any data, for lenses people use: without data they stay neutral.
PRIOR_SIGMA = {"k1": 0.3, "k2": 0.2, "p1": 0.003, "p2": 0.003, "k3": 0.2, "aspect": 0.005}
# So many points, spread over a board, determine a pose and a lens well enough to start from: every point has its say
# at the end.
ENOUGH_POINTS = 16
# What others follow is good enough once a step would lower chi-square by this little: three sigmas of one number,
# of the hundreds that are estimated.
ROUGH = 10.0


def prior(problem: Problem, principal_sigma: float) -> tuple[Floats, Floats]:
    """Prior mean and information (C, 9) of the lenses; principal_sigma as a share of the image's larger side."""
    mean, information = np.zeros((len(problem.cameras), 9)), np.zeros((len(problem.cameras), 9))
    mean[:, 8] = 1.0
    for row, camera in enumerate(problem.cameras):
        mean[row, 1:3] = image_middle(camera.width, camera.height)
        information[row, 1:3] = 1 / (principal_sigma * max(camera.width, camera.height)) ** 2
        if camera.intrinsics is not None:
            mean[row] = camera.intrinsics.parameters
    for column, name in enumerate(LENS_PARAMETERS):
        if name in PRIOR_SIGMA:
            information[:, column] = 1 / PRIOR_SIGMA[name] ** 2
    return mean, information
