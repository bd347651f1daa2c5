"""A board's corners: windows around them, which ones are good, and how sure."""

import numpy as np

from quadrig.single.arrays import Floats, Mask
from quadrig.single.subpixel.corner_fit import CornerFit
from quadrig.single.subpixel.ellipse_fit import EllipseFit
from quadrig.single.subpixel.tone import USUAL_TONE, Tone

# A corner whose fit leaves more than this share of its contrast unexplained (rms) is covered, torn or no corner.
_UNEXPLAINED = 0.2
_ALWAYS_EXPLAINED = 0.05
# Grey levels between the squares below which a corner is lost in the noise.
_LEAST_CONTRAST = 12.0
# sigma (px) above which a corner says too little to be worth the risk.
_WORST_SIGMA = 0.5
# A corner this many px from the middle of its window is fitted again in a window of its own.
RECENTRE = 1.5
# px that the model is wrong by on real lenses, added to what noise explains.
_MODEL_SIGMA = 0.015
# A saddle stays where it is in any tone, so that one which is roughly right serves: what is left in log gamma.
_TONE_MATTERS = 0.15
# Largest window (px): farther out the lens bends the squares' edges.
_WIDEST = 7.0


def corner_window(axes: Floats) -> Floats:
    """Radius in px that holds the four squares of a corner and nothing beyond them."""
    return np.clip(0.7 * _across(axes), 2.0, _WIDEST)


def leak(axes: Floats, blur: Floats) -> Floats:
    """px (N,) by which light of what lies beyond the four squares moves a corner, where blur is wide against them.

    Measured on rendered AprilGrids: rms error beyond noise over blur is 0.054 at squares of 3.4 blurs, 0.033 at 3.9,
    0.009 at 4.6, none from 5 on; the formula runs through these.
    """
    return 0.2 * blur * np.exp(-((_across(axes) / blur / 3.2) ** 3))


def _across(axes: Floats) -> Floats:
    """px (N,) across a square where it is narrowest; axes (N, 2, 2) px of its sides."""
    return np.abs(np.linalg.det(axes)) / np.max(np.linalg.norm(axes, axis=2), axis=1)


def good_corners(fit: CornerFit | EllipseFit) -> Mask:
    """Which corners are well explained and sure enough to be used."""
    explained = fit.noise < _UNEXPLAINED * np.abs(fit.contrast)
    return (
        explained
        & (np.abs(fit.grey_contrast) > _LEAST_CONTRAST)
        & (fit.sigma < _WORST_SIGMA)
        & np.isfinite(fit.pixels).all(axis=1)
    )


def alike_corners(fit: CornerFit) -> Mask:
    """Which corners leave about as much unexplained as their fellows: one with much more is touched by something."""
    return fit.noise < np.maximum(3 * np.median(fit.noise), _ALWAYS_EXPLAINED * np.abs(fit.contrast))


def better_tone(fit: CornerFit, sure: Mask) -> Tone | None:
    """The tone by the corners that are sure, fitted in the usual one; None where the usual one will do."""
    tone = USUAL_TONE.updated(fit.pull[sure].sum(axis=0), fit.weight[sure].sum(axis=0))
    return tone if abs(np.log(tone.gamma / USUAL_TONE.gamma)) > _TONE_MATTERS else None


def view_sigma(sigma: Floats) -> float:
    """Standard deviation (px) of a View's pixel coordinates from those of its corners."""
    return float(np.hypot(np.sqrt(np.mean(sigma**2)), _MODEL_SIGMA))
