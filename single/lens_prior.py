"""What is known of a lens before its Views: a mixture of the classes of lenses that people use.

No class is ever chosen. The prior of a fit is the Gaussian with the mean and covariance of the whole mixture, its
classes weighed by what the Views say of them; so classes that remain possible stay in the covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from quadrig.single.arrays import Floats, Ints
from quadrig.single.lens import Intrinsics, LensModel, image_middle
from quadrig.single.lens_table import ASPECT, CENTRE, FISHEYE, FISHEYE_FOCAL, FOCAL, RADIAL, TANGENTIAL

CLASS_NAMES = ("barrel", "nearly straight", "pincushion", "uncommon", "fisheye", "as given")
"""What `LensClasses.kind` counts: the radial classes of lens_table.RADIAL, fisheyes, and lenses that were given."""
_FISHEYE_KIND, _GIVEN_KIND = 4, 5

# A lens that is given without sigmas is as good as calibrations that are handed on (another focus, another crop), and
# as likely to be right as to be another camera's, until the Views speak.
_GIVEN = 0.5
# Sigmas of its parameters: of the focal a share of it, of the principal point of the larger side.
_GIVEN_SIGMA = np.array([0.01, 0.005, 0.005, 0.02, 0.02, 0.001, 0.001, 0.02, 0.001])
# Telephoto lenses are hardly in the table: its width of focals is taken a quarter larger. No class of its own for
# them: a fit that runs away, as flat-on Views let it, would seem to be one.
_FOCAL_WIDENED = 1.25
# Beyond so many sigmas of the logarithm a focal is no guide to where its own prior lies.
_FARTHEST = 3.0
# Sigma of a number that a lens model does not have.
_NOTHING = 1e-6


@dataclass(frozen=True, eq=False)
class LensEvidence:
    """What Views said of a lens, without what lenses are like: a Gaussian likelihood.

    information (9, 9), which may be singular where they said nothing, and pull (9,): information times the likeliest
    lens, both in the order of LENS_PARAMETERS.
    """

    pull: Floats
    information: Floats


@dataclass(frozen=True, eq=False)
class LensClasses:
    """A mixture of Gaussians over the lens of each camera: weight (C, K), mean (C, K, 9), covariance (C, K, 9, 9),
    in `unit` (C, 9) from `offset` (C, 9). kind (C, K): which of CLASS_NAMES."""

    weight: Floats
    mean: Floats
    covariance: Floats
    kind: Ints
    offset: Floats
    unit: Floats

    def moments(self) -> tuple[Floats, Floats]:
        """Mean (C, 9) and covariance (C, 9, 9) of the whole mixture."""
        mean = (self.weight[..., None] * self.mean).sum(axis=1)
        off = self.mean - mean[:, None]
        spread = (self.weight[..., None, None] * self.covariance).sum(axis=1)
        spread = spread + np.swapaxes(self.weight[..., None] * off, 1, 2) @ off
        return self.offset + self.unit * mean, spread * self.unit[:, :, None] * self.unit[:, None, :]

    def weigh(self, pull: Floats, information: Floats) -> Floats:
        """Weights (C, K) of the classes after data of this likelihood.

        information (C, 9, 9), which may be singular where the data say nothing, and pull (C, 9), information times
        the likeliest lens.
        """
        data = information * self.unit[:, :, None] * self.unit[:, None, :]
        pull = self.unit * (pull - (information @ self.offset[..., None])[..., 0])
        # Log evidence of a class N(m, P) under information L and pull h, but for what all share: with d = h - L m,
        # (2 h - L m)' m / 2 less the misfit, and d' P (1 + L P)^-1 d / 2 - log|1 + L P| / 2.
        both = np.eye(9) + data[:, None] @ self.covariance
        at = (data[:, None] @ self.mean[..., None])[..., 0]
        short = pull[:, None] - at
        gained = (self.covariance @ np.linalg.solve(both, short[..., None]))[..., 0]
        log = ((pull[:, None] - at / 2) * self.mean).sum(axis=-1) + (short * gained).sum(axis=-1) / 2
        with np.errstate(divide="ignore"):
            log = np.log(self.weight) + log - np.linalg.slogdet(both)[1] / 2
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        return weight / weight.sum(axis=1, keepdims=True)

    def kinds(self) -> Floats:
        """Probability (C, 6) of each of CLASS_NAMES."""
        return (self.weight[..., None] * (self.kind[..., None] == np.arange(len(CLASS_NAMES)))).sum(axis=1)


def lens_classes(
    sizes: Sequence[tuple[int, int]],
    focal: Floats,
    models: Sequence[LensModel],
    given: Sequence[tuple[Intrinsics | None, Floats | None]] | None = None,
) -> LensClasses:
    """The classes of lenses of cameras with pictures of these sizes (width, height) px.

    focal (C,) px: about which the prior of its logarithm is linearised, and which scales how much a radial term
    shows. given: lenses known beforehand, None where there is none: one without a covariance (9, 9) becomes half of
    its camera's mixture, one with it is all that is known.
    """
    side = np.array([float(max(size)) for size in sizes])
    middle = np.array([image_middle(*size) for size in sizes])
    pinhole = np.array([model == "pinhole" for model in models])
    focal = usual_focal(side, models, focal)
    half = np.where(pinhole, side / 2 / focal, 1.0)
    offset, unit = np.zeros((len(side), 9)), np.ones((len(side), 9))
    offset[:, 0], offset[:, 1:3], offset[:, 8] = focal * (1 - np.log(focal / side)), middle, 1.0
    unit[:, 0], unit[:, 1:3] = focal, side[:, None]
    unit[:, [3, 4, 7]] = half[:, None] ** -np.array([2.0, 4.0, 6.0])
    weight, mean, covariance, kind = (np.stack(parts) for parts in zip(*map(_template, models), strict=True))
    for row, (lens, known) in enumerate(given or []):
        if lens is None:
            continue
        sigma = _GIVEN_SIGMA * np.array([lens.focal, side[row], side[row], *np.ones(6)])
        own = np.diag(sigma**2) if known is None else known
        share = _GIVEN if known is None else 1.0
        weight[row] *= 1 - share
        weight[row, -1] = share
        mean[row, -1] = (lens.parameters - offset[row]) / unit[row]
        covariance[row, -1] = own / np.outer(unit[row], unit[row]) + _NOTHING**2 * np.eye(9)
    return LensClasses(weight, mean, covariance, kind, offset, unit)


def usual_focal(side: Floats, models: Sequence[LensModel], focal: Floats | None = None) -> Floats:
    """Focals (C,) px within what lenses have, as near to the given ones as that allows; the usual ones for None.

    There a fit begins, and a prior of their logarithm is linearised. side (C,) px: the larger side of the pictures.
    """
    usual = np.array([FOCAL if model == "pinhole" else FISHEYE_FOCAL for model in models]).reshape(-1, 2)
    if focal is None:
        return side * np.exp(usual[:, 0])
    far = _FARTHEST * usual[:, 1]
    return np.clip(focal, side * np.exp(usual[:, 0] - far), side * np.exp(usual[:, 0] + far))


@cache
def _template(model: LensModel) -> tuple[Floats, Floats, Floats, Ints]:
    """Weight (K,), mean (K, 9), covariance (K, 9, 9) and kind (K,) of the classes, in units of the picture; the last
    has no weight: it is where a given lens stands. Models have as many classes, some of them with no weight."""
    bends = [(w, m, np.array(c), number) for number, (w, m, c) in enumerate(RADIAL)]
    places, tangentials, (log_focal, log_width) = [3, 4, 7], TANGENTIAL, FOCAL
    if model == "fisheye":
        bends = [(1.0, FISHEYE[0], np.diag(np.square(FISHEYE[1])), _FISHEYE_KIND)]
        places, tangentials, (log_focal, log_width) = [3, 4, 5, 6], ((1.0, 0.0),), FISHEYE_FOCAL
    rows = [
        (bend, centre, tangential, aspect)
        for bend in bends
        for centre in CENTRE
        for tangential in tangentials
        for aspect in ASPECT
    ]
    count = len(RADIAL) * len(CENTRE) * len(TANGENTIAL) * len(ASPECT) + 1
    weight, kind = np.zeros(count), np.full(count, _GIVEN_KIND)
    mean, covariance = np.zeros((count, 9)), np.tile(_NOTHING**2 * np.eye(9), (count, 1, 1))
    mean[:, 0] = log_focal
    for row, (bend, centre, tangential, aspect) in enumerate(rows):
        weight[row] = bend[0] * centre[0] * tangential[0] * aspect[0]
        mean[row, places] = bend[1]
        kind[row] = bend[3]
        sigma = np.array([_FOCAL_WIDENED * log_width, centre[1], centre[1], 0, 0, *[tangential[1]] * 2, 0, aspect[1]])
        covariance[row] += np.diag(sigma**2)
        covariance[row][np.ix_(places, places)] += bend[2]
    return weight / weight.sum(), mean, covariance, kind
