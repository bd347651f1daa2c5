"""The camera's tone curve, as far as edges feel it: light is the grey value to the power gamma.

A lens blurs light; the camera's curve comes after. In grey values a blurred edge is therefore not symmetric, and a
symmetric step fitted to it lies on the dark side of where the edge is (0.44 px at blur 1 and gamma 2.2). So edges and
corners are fitted in light, and gamma is found from the picture itself. What the edge moves by is, nearly,
proportional to the logarithm of gamma: that is the unknown, and its derivatives are named by_gamma.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture, Reals, Singles
from quadrig.single.subpixel.blurred_step import block_sums

# Before a picture says more: between 1 and 2.6 the world over, most near that of sRGB; the logarithm's sigma.
_USUAL, _USUAL_SIGMA = 2.0, 0.45
# What is no tone curve: a fit that asks for it follows something else.
_LEAST, _MOST = 0.4, 8.0
# Least light, of 255, that has a logarithm: what noise and the slopes of a fit make less is taken for this.
_LEAST_LIGHT = 0.01


@dataclass(frozen=True)
class Tone:
    """light / 255 = (grey / 255) ** gamma; sigma: standard deviation of the logarithm of gamma."""

    gamma: float = _USUAL
    sigma: float = _USUAL_SIGMA

    def light(self, grey: Reals) -> Reals:
        """Light, 0 to 255, of grey levels."""
        return 255 * (np.maximum(grey, 0) / 255) ** self.gamma

    def table(self) -> Singles:
        """Light (256,) of each grey level."""
        return self.light(np.arange(256.0)).astype(np.float32)

    def grey(self, light: Reals) -> Reals:
        """Grey levels, fractions included, of light."""
        return 255 * (np.maximum(light, 0) / 255) ** (1 / self.gamma)

    def by_grey(self, light: Reals) -> Reals:
        """How much light one grey level more is."""
        light = np.maximum(light, _LEAST_LIGHT)
        return self.gamma * light / self.grey(light)

    def updated(self, pull: float, weight: float) -> "Tone":
        """The tone after evidence: slope and curvature of a log likelihood of log gamma, here.

        The prior is the usual tone, however often evidence is weighed anew.
        """
        prior = _USUAL_SIGMA**-2
        step = (pull + prior * np.log(_USUAL / self.gamma)) / (weight + prior)
        return Tone(float(np.clip(self.gamma * np.exp(step), _LEAST, _MOST)), float((weight + prior) ** -0.5))

    def doubted(self, sigma: float) -> "Tone":
        """The same, with so much more doubt of log gamma."""
        return Tone(self.gamma, float(np.hypot(self.sigma, sigma)))


USUAL_TONE = Tone()


@dataclass(frozen=True, eq=False)
class LightImage:
    """The light of a grey picture (h, w), as a tone reads it."""

    grey: Picture
    tone: Tone = USUAL_TONE

    def at(self, columns: Ints, rows: Ints) -> tuple[Singles, Mask]:
        """Light, 0 to 255, at whole pixels, and which of them lie in the picture."""
        height, width = self.grey.shape
        inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
        return self.tone.table()[self.grey[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]], inside


@dataclass(frozen=True, eq=False)
class Evidence:
    """What fits say of a tone: pull, weight (N,), slope and curvature of the log likelihood of log gamma where all
    else follows it; excess (N,): variance of the pull over that of independent pixels; follow (N, K): how the fitted
    parameters change with log gamma."""

    pull: Floats
    weight: Floats
    excess: Floats
    follow: Floats


def gamma_evidence(
    model: Singles, residual: Singles, jacobian: Singles, weight: Singles, inverse: Floats
) -> Evidence:
    """From the light (N, P) of fitted models, its residual and weight (1 over variance), the jacobian (N, K, P) and
    the inverse normal matrix (N, K, K).

    The derivative is at the light of the model, not of the pixel: noise would pull gamma with it (Box and Cox, 1964).
    """
    light = np.maximum(model, np.float32(_LEAST_LIGHT))
    change = light * np.log(light * np.float32(1 / 255))
    follow = (inverse @ (jacobian @ (weight * change)[..., None]))[..., 0]
    alone = weight * (change - (follow[:, None] @ jacobian)[:, 0])
    curvature = np.sum(alone * change, axis=1)
    scores = block_sums(alone * residual)
    excess = np.sum(scores**2, axis=1) / np.maximum(curvature, 1e-12)
    return Evidence(-np.sum(scores, axis=1), curvature, excess, follow)
