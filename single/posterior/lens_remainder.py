"""What a lens leaves beside its model: a smooth field of shifts over the picture, small where the model fits.

Products of Legendre polynomials, each of mean square one over the picture and without those of the lowest degrees,
which the lens model has itself; the higher the degree the smaller the prior, as of a smooth Gaussian process. How
large the field is, is learned with its own doubt, camera by camera. Where no corner was seen the prior remains.
"""

from functools import cache

import numpy as np

from quadrig.single.arrays import Floats, Ints

# Degree of the finest field, and the first degree that no lens model has.
_FINEST, _COARSEST = 4, 2
# So many numbers of all cameras together, at most: the border's matrix is dense.
_MOST_NUMBERS = 1200
# Variance falls with the degree to this power: the fields that splined lenses show beside radial polynomials do.
_SMOOTHNESS = 3.0
# Powers of that factor that are tried: from a ten-thousandth of a pixel to what no usable lens leaves beside its
# model; more is another fault.
_SMALLEST, _LARGEST = -8.0, 5.0
# Root mean square of the field (px in a picture 1280 px wide) over most lenses, and by which factor it varies; tried
# at so many sizes.
_USUAL, _FACTOR, _SIZES = 0.03, 2.0, 41


def degrees_of(cameras: int) -> Ints:
    """Degrees (B, 2) across and down of the field's functions for so many cameras: finer where they are few."""
    for finest in range(_FINEST, _COARSEST - 1, -1):
        pairs = [(i, n - i) for n in range(_COARSEST, finest + 1) for i in range(n + 1)]
        if 2 * len(pairs) * cameras <= _MOST_NUMBERS:
            return np.array(pairs)
    return np.zeros((0, 2), int)


def field_basis(degrees: Ints, pixels: Floats, size: Floats) -> Floats:
    """The functions (..., B, P) at pixels (..., P, 2) of pictures of size (..., 2) px, width and height."""
    if not len(degrees):
        return np.zeros((*pixels.shape[:-2], 0, pixels.shape[-2]))
    # Beyond the picture, where a wrong corner may lie, the polynomials would explode.
    at = np.clip((2 * pixels + 1) / size[..., None, :] - 1, -1.0, 1.0)
    legendre = [np.ones_like(at), at]
    for n in range(1, int(degrees.max())):
        # Bonnet's recursion.
        legendre.append(((2 * n + 1) * at * legendre[n] - n * legendre[n - 1]) / (n + 1))
    unit = [np.sqrt(2 * n + 1.0) * each for n, each in enumerate(legendre)]
    return np.stack([unit[i][..., 0] * unit[j][..., 1] for i, j in degrees], axis=-2)


def shares_of(degrees: Ints) -> Floats:
    """What share (B,) of the field's variance each of its functions has before any picture."""
    share = degrees.sum(axis=1).astype(float) ** -_SMOOTHNESS
    return share / max(share.sum(), 1e-300)


@cache
def _sizes() -> tuple[Floats, Floats]:
    """Mean squares (S,) px^2 that are tried for 1280 px of width, and the logarithms (S,) of their prior odds."""
    steps = np.linspace(_SMALLEST, _LARGEST, _SIZES)
    return (_USUAL * _FACTOR**steps) ** 2, -0.5 * steps**2


def largest_field(width: float) -> float:
    """Root mean square (px) of the largest field that is looked for: more is no lens's, and in no sigma."""
    return float(_USUAL * width / 1280 * _FACTOR**_LARGEST)


def usual_variance(widths: Floats) -> Floats:
    """Mean square (C,) px^2 of the fields of pictures so wide (C,) px before any is seen, of one coordinate."""
    variance, odds = _sizes()
    return (widths / 1280) ** 2 * (np.exp(odds) @ variance / np.exp(odds).sum())


def learned_variance(information: Floats, pull: Floats, share: Floats, widths: Floats) -> Floats:
    """Mean square (C,) px^2 of each camera's field, averaged over sizes by how likely the Views make each.

    information (C, N, N), pull (C, N): what Views say of the field's numbers, quadratic about a field of zero; share
    (N,); widths (C,) px of the pictures.
    """
    root = np.sqrt(share)
    values, axes = np.linalg.eigh(information * root * root[:, None])
    values = np.maximum(values, 0.0)[:, None]
    along = ((root * pull)[:, None] @ axes) ** 2
    variance, odds = _sizes()
    variance = (widths[:, None] / 1280) ** 2 * variance
    grown = variance[..., None] * values
    evidence = 0.5 * (variance[..., None] * along / (1 + grown) - np.log1p(grown)).sum(axis=2) + odds
    weight = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    return (weight * variance).sum(axis=1) / weight.sum(axis=1)
