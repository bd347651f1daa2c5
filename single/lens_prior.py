"""What is known of a lens before its Views: a mixture of the classes of lenses that people use.

No class is ever chosen. The prior of a fit is the Gaussian with the mean and covariance of the whole mixture, its
classes weighed by what the Views say of them; so classes that remain possible stay in the covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.lens import Intrinsics, LensModel, image_middle
from quadrig.single.lens_table import ASPECT, CENTRE, FISHEYE, FISHEYE_FOCAL, FOCAL, RADIAL, RADIAL_FOCAL, TANGENTIAL

CLASS_NAMES = ("barrel", "nearly straight", "pincushion", "uncommon", "fisheye", "as given")
"""What `LensClasses.kind` counts: the radial classes of lens_table.RADIAL, fisheyes, and lenses that were given."""
_FISHEYE_KIND, GIVEN_KIND = 4, 5

# A lens that is given without sigmas is as good as calibrations that are handed on (another focus, another crop), and
# as likely to be right as to be another camera's, until the Views speak.
_GIVEN = 0.5
# Sigmas of its parameters: of the focal a share of it, of the principal point of the larger side.
_GIVEN_SIGMA = np.array([0.01, 0.005, 0.005, 0.02, 0.02, 0.001, 0.001, 0.02, 0.001])
# Telephoto lenses are hardly in the table: its width of focals is taken a quarter larger. No class of its own for
# them: a fit that runs away, as flat-on Views let it, would seem to be one.
_FOCAL_WIDENED = 1.25
# Weight and width, in sigmas of the others, of lenses that are none of the usual focal.
_UNUSUAL_SHARE, _UNUSUAL_WIDTH = 0.05, 3.0
# Weight and sigma of the axis, of the larger side, in pictures that are parts of others: a guess of both, made large
# enough that an axis a quarter of the picture off leaves the focal open.
_CROPPED = (0.05, 0.25)
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

    def gaussian(self) -> tuple[Floats, Floats]:
        """Mean (C, 9) and information (C, 9, 9) of the whole mixture."""
        mean, covariance = self.moments()
        scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        square = scale[:, :, None] * scale[:, None, :]
        return mean, np.linalg.inv(covariance / square) / square

    def weigh(self, pull: Floats, information: Floats) -> Floats:
        """Weights (C, K) of the classes after data of this likelihood.

        information (C, 9, 9), which may be singular where the data say nothing, and pull (C, 9), information times
        the likeliest lens.
        """
        short = pull - (information @ self.offset[..., None])[..., 0]
        return _shares(self._whitened(np.zeros_like(self.offset), short, information).log)[1]

    def posterior(self, lens: Floats, pull: Floats, information: Floats) -> "LensPosterior":
        """What data make of the mixture: of these lenses (C, 9) the logarithm of their likelihood has the slope
        pull (C, 9) and minus the curvature information (C, 9, 9)."""
        at = (lens - self.offset) / self.unit
        log, mean, covariance = self._class_posteriors(at, pull, information)
        total, weight = _shares(log)
        middle = (weight[..., None] * mean).sum(axis=1)
        off = mean - middle[:, None]
        spread = (weight[..., None, None] * covariance).sum(axis=1)
        spread = spread + np.swapaxes(weight[..., None] * off, 1, 2) @ off
        return LensPosterior(
            total,
            weight,
            self.offset + self.unit * middle,
            spread * self.unit[:, :, None] * self.unit[:, None, :],
        )

    def _class_posteriors(self, at: Floats, pull: Floats, information: Floats) -> tuple[Floats, Floats, Floats]:
        """Log evidence (C, K) of each class against the likelihood at `at` (C, 9), mean and covariance in `unit`."""
        found = self._whitened(at, pull, information)
        covariance = found.root @ np.linalg.inv(found.whole) @ np.swapaxes(found.root, -1, -2)
        return found.log, self.mean + found.gained, covariance

    def _whitened(self, at: Floats, pull: Floats, information: Floats) -> "_Whitened":
        data, pull = information * self.unit[:, :, None] * self.unit[:, None, :], self.unit * pull
        # About a class's mean m its covariance is P = C C^T, and with x = m + C w the likeliest w solves
        # (1 + C^T L C) w = C^T (h - L m), which no rounding makes singular, for information L and pull h.
        mean = self.mean - at[:, None]
        root = np.asarray(np.linalg.cholesky(self.covariance), float)
        root_t = np.swapaxes(root, -1, -2)
        whole = np.eye(9) + root_t @ data[:, None] @ root
        short = pull[:, None] - (data[:, None] @ mean[..., None])[..., 0]
        w = np.asarray(np.linalg.solve(whole, root_t @ short[..., None]), float)[..., 0]
        gained = (root @ w[..., None])[..., 0]
        # What is gained there, written so that an error of w counts by its square.
        found = mean + gained
        log = (pull[:, None] * found).sum(axis=-1) - 0.5 * (w * w).sum(axis=-1)
        log -= 0.5 * (found * (data[:, None] @ found[..., None])[..., 0]).sum(axis=-1)
        with np.errstate(divide="ignore"):
            log = np.log(self.weight) + log - np.linalg.slogdet(whole)[1] / 2
        return _Whitened(log, gained, root, whole)

    def unusual(self) -> Floats:
        """Probability (C,) that a lens is of no usual kind, or its picture a part of another."""
        rare = self.kind == CLASS_NAMES.index("uncommon")
        # Rounding is all that this leaves room for.
        rare |= self.covariance[..., 1, 1] > 0.99 * _CROPPED[1] ** 2
        return (self.weight * rare).sum(axis=1)

    def at_focals(self, focal: Floats) -> tuple[Floats, "LensClasses"]:
        """Logarithm (C,) of the density of the focal's logarithm at these focals (C,) px, but for a constant, and the
        mixtures of lenses that have them. Broad at its ends, so that a telephoto lens that Views show well is not
        pulled towards the usual ones."""
        off = ((focal - self.offset[:, 0]) / self.unit[:, 0])[:, None] - self.mean[..., 0]
        spread = self.covariance[..., 0, 0]
        square = off**2 / spread
        usual = np.exp(-0.5 * square) * (1 - _UNUSUAL_SHARE)
        density = usual + np.exp(-0.5 * square / _UNUSUAL_WIDTH**2) * _UNUSUAL_SHARE / _UNUSUAL_WIDTH
        with np.errstate(divide="ignore"):
            log, weight = _shares(np.log(self.weight) + np.log(density) - 0.5 * np.log(spread))
        slope = self.covariance[..., 0] / spread[..., None]
        # A focal that is none of a class's own says nothing of how that class bends.
        far = _FARTHEST * np.sqrt(spread)
        mean = self.mean + slope * np.clip(off, -far, far)[..., None]
        mean[..., 0] = self.mean[..., 0] + off
        covariance = self.covariance - slope[..., :, None] * self.covariance[..., :1, :]
        covariance[..., 0, 0] = _NOTHING**2
        return log, replace(self, weight=weight, mean=mean, covariance=covariance)

    def held(self, which: Mask, lens: Floats, sigma: Floats) -> "LensClasses":
        """The same with some parameters (9,) known to be those of a lens (9,), to a sigma (9,) of each."""
        mean = np.where(which, ((lens - self.offset) / self.unit)[:, None], self.mean)
        own = np.where(which[:, None] | which, 0.0, self.covariance)
        spread = np.where(which, np.maximum(sigma / self.unit, _NOTHING) ** 2, 0.0)
        return replace(self, mean=mean, covariance=own + (spread[..., None] * np.eye(9))[:, None])

    def kinds(self) -> Floats:
        """Probability (C, 6) of each of CLASS_NAMES."""
        return (self.weight[..., None] * (self.kind[..., None] == np.arange(len(CLASS_NAMES)))).sum(axis=1)


@dataclass(frozen=True, eq=False)
class _Whitened:
    """Classes after data: log evidence (C, K), what each class's mean gains (C, K, 9), a root of its covariance
    before them (C, K, 9, 9), and the information after them where that root is the unit (C, K, 9, 9)."""

    log: Floats
    gained: Floats
    root: Floats
    whole: Floats


@dataclass(frozen=True, eq=False)
class LensPosterior:
    """A mixture after data: log (C,), the logarithm of what the likelihood is in the mean over the mixture, beside
    that of the lens asked about; weight (C, K) of the classes; mean (C, 9) and covariance (C, 9, 9)."""

    log: Floats
    weight: Floats
    mean: Floats
    covariance: Floats


def lens_classes(
    sizes: Sequence[tuple[int, int]],
    focal: Floats,
    models: Sequence[LensModel],
    given: Sequence[tuple[Intrinsics | None, Floats | None]] | None = None,
    own_focals: bool = False,
    cropped: bool = False,
) -> LensClasses:
    """The classes of lenses of cameras with pictures of these sizes (width, height) px.

    focal (C,) px: about which the prior of its logarithm is linearised, and which scales how much a radial term
    shows. given: lenses known beforehand, None where there is none: one without a covariance (9, 9) becomes half of
    its camera's mixture, one with it is all that is known. own_focals: whether each class has the focals of its own
    lenses, for a solver that goes through all focals, or all have the usual ones; cropped: whether pictures may be
    parts of others, with the axis anywhere.
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
    templates = [_template(model, own_focals, cropped) for model in models]
    weight, mean, covariance, kind = (np.stack(parts) for parts in zip(*templates, strict=True))
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


def _shares(log: Floats) -> tuple[Floats, Floats]:
    """Logarithm (C,) of the sum of exp(log) over the classes (C, K), and each one's share of it."""
    top = log.max(axis=1, keepdims=True)
    weight = np.exp(log - top)
    total = weight.sum(axis=1, keepdims=True)
    return (top + np.log(total))[:, 0], weight / total


@cache
def _template(model: LensModel, own_focals: bool, cropped: bool) -> tuple[Floats, Floats, Floats, Ints]:
    """Weight (K,), mean (K, 9), covariance (K, 9, 9) and kind (K,) of the classes, in units of the picture; the last
    has no weight: it is where a given lens stands. Models have as many classes, some of them with no weight."""
    bends = [(w, m, np.array(c), number) for number, (w, m, c) in enumerate(RADIAL)]
    places, tangentials, focals = (
        [3, 4, 7],
        TANGENTIAL,
        RADIAL_FOCAL if own_focals else ((*FOCAL, (0.0,) * 3),) * len(RADIAL),
    )
    if model == "fisheye":
        bends = [(1.0, FISHEYE[0], np.diag(np.square(FISHEYE[1])), _FISHEYE_KIND)]
        places, tangentials, focals = [3, 4, 5, 6], ((1.0, 0.0),), ((*FISHEYE_FOCAL, (0.0,) * 4),)
    centres = (*CENTRE, _CROPPED) if cropped else CENTRE
    rows = [
        (bend, centre, tangential, aspect)
        for bend in zip(bends, focals, strict=True)
        for centre in centres
        for tangential in tangentials
        for aspect in ASPECT
    ]
    count = len(RADIAL) * len(centres) * len(TANGENTIAL) * len(ASPECT) + 1
    weight, kind = np.zeros(count), np.full(count, GIVEN_KIND)
    mean, covariance = np.zeros((count, 9)), np.tile(_NOTHING**2 * np.eye(9), (count, 1, 1))
    mean[:, 0] = focals[0][0]
    for row, ((bend, focal), centre, tangential, aspect) in enumerate(rows):
        weight[row] = bend[0] * centre[0] * tangential[0] * aspect[0]
        mean[row, 0], mean[row, places] = focal[0], bend[1]
        kind[row] = bend[3]
        sigma = np.array([_FOCAL_WIDENED * focal[1], *[centre[1]] * 2, 0, 0, *[tangential[1]] * 2, 0, aspect[1]])
        covariance[row] += np.diag(sigma**2)
        slope = np.array(focal[2])
        # What the class varies by at one focal, and with it.
        covariance[row][np.ix_(places, places)] += bend[2] + np.outer(slope, slope) * (sigma[0] ** 2 - focal[1] ** 2)
        covariance[row, 0, places] = covariance[row, places, 0] = slope * sigma[0] ** 2
    return weight / weight.sum(), mean, covariance, kind
