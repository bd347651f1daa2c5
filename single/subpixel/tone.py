"""The camera's tone curve, as far as edges feel it: light is a grey value to the power gamma, once an S is undone.

A lens blurs light; the camera's curve comes after. In grey values a blurred edge is therefore not symmetric, and a
symmetric step fitted to it lies on the dark side of where the edge is (0.44 px at blur 1 and gamma 2.2). So edges and
corners are fitted in light, and the curve is found from the picture itself. What the edge moves by is, nearly,
proportional to the logarithm of gamma, and to the S that film and picture styles add: these are the unknowns, in
this order; where only the first is asked for, the S is none.
"""

from dataclasses import dataclass, field

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture, Reals, Singles
from quadrig.single.subpixel.blurred_step import block_sums

# Before a picture says more: gamma is between 1 and 2.6 the world over, most near that of sRGB, and an S between none
# and that of film, 0.7; sigmas of the logarithm and of the S.
_USUAL, _USUAL_S = 2.0, 0.2
_USUAL_SIGMA = np.array([0.45, 0.3])
# What is no tone curve: a fit that asks for it follows something else. From 1 on an S turns back on itself.
_LEAST, _MOST = 0.4, 8.0
_LEAST_S, _MOST_S = -0.5, 0.85
# Least light, of 255, that has a logarithm: what noise and the slopes of a fit make less is taken for this.
_LEAST_LIGHT = 0.01
# Steps by which the S is turned round: linear between them, it is right to a millionth.
_STEPS = 1024


@dataclass(frozen=True, eq=False)
class Tone:
    """light / 255 = v ** gamma, grey / 255 = v + s v (1 - v) (2 v - 1); covariance (2, 2) of log gamma and s."""

    gamma: float = _USUAL
    s: float = 0.0
    covariance: Floats = field(default_factory=lambda: np.diag(_USUAL_SIGMA**2))

    @property
    def sigma(self) -> float:
        """Standard deviation of the logarithm of gamma."""
        return float(np.sqrt(self.covariance[0, 0]))

    def light(self, grey: Reals) -> Reals:
        """Light, 0 to 255, of grey levels."""
        value = np.maximum(grey, 0) / 255
        if self.s:
            steps = np.linspace(0, 1, _STEPS + 1)
            beyond = np.maximum(value - 1, 0) / (1 - self.s)
            value = np.interp(value, self._bent(steps), steps) + beyond
        return 255 * value**self.gamma

    def table(self) -> Singles:
        """Light (256,) of each grey level."""
        return self.light(np.arange(256.0)).astype(np.float32)

    def grey(self, light: Reals) -> Reals:
        """Grey levels, fractions included, of light."""
        return 255 * self._bent((np.maximum(light, 0) / 255) ** (1 / self.gamma))

    def _bent(self, value: Reals) -> Reals:
        """The S; what is beyond white follows its end."""
        if not self.s:
            return value
        within = np.minimum(value, 1)
        return within + self.s * within * (1 - within) * (2 * within - 1) + (1 - self.s) * (value - within)

    def by_grey(self, light: Reals) -> Reals:
        """How much light one grey level more is."""
        light = np.maximum(light, _LEAST_LIGHT)
        value = (light / 255) ** (1 / self.gamma)
        return self.gamma * light / (255 * value * self._slope(value))

    def _slope(self, value: Reals) -> Reals:
        within = np.minimum(value, 1)
        return 1 - self.s + 6 * self.s * within * (1 - within)

    def changes(self, light: Singles, unknowns: int) -> Singles:
        """How light (N, P) of given grey values changes with the first unknowns: (N, D, P)."""
        light = np.maximum(light, np.float32(_LEAST_LIGHT))
        share = light * np.float32(1 / 255)
        by_gamma = light * np.log(share)
        if unknowns == 1:
            return by_gamma[:, None]
        value = share ** np.float32(1 / self.gamma)
        within = np.minimum(value, np.float32(1))
        bend = within * (1 - within) * (2 * within - 1) + within - value
        by_s = np.float32(-self.gamma) * light * bend / (value * self._slope(value))
        return np.stack([by_gamma, by_s.astype(np.float32)], axis=1)

    def beyond(self, other: "Tone", unknowns: int) -> Floats:
        """By how much the first unknowns (D,) are more than another tone's."""
        return np.array([np.log(self.gamma / other.gamma), self.s - other.s])[:unknowns]

    def updated(self, pull: Floats, weight: Floats) -> "Tone":
        """The tone after evidence: slope (D,) and curvature (D, D) of a log likelihood of the first unknowns, here.

        The prior is the usual tone, however often evidence is weighed anew.
        """
        count = len(pull)
        prior = np.diag(_USUAL_SIGMA[:count] ** -2)
        away = np.array([np.log(_USUAL / self.gamma), _USUAL_S - self.s])[:count]
        after = np.asarray(np.linalg.inv(weight + prior), float)
        step = np.append(after @ (pull + prior @ away), 0.0)
        covariance = np.diag(_USUAL_SIGMA**2)
        covariance[:count, :count] = after
        gamma = float(np.clip(self.gamma * np.exp(step[0]), _LEAST, _MOST))
        return Tone(gamma, float(np.clip(self.s + step[1], _LEAST_S, _MOST_S)), covariance)

    def doubted(self, sigma: float) -> "Tone":
        """The same, with so much more doubt of log gamma."""
        return Tone(self.gamma, self.s, self.covariance + np.diag([sigma**2, 0.0]))


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
    """What fits say of the D unknowns of a tone: pull (N, D), weight (N, D, D), slope and curvature of the log
    likelihood where all else follows them; excess (N,): variance of the pull over that of independent pixels; follow
    (N, K, D): how the fitted parameters change with them."""

    pull: Floats
    weight: Floats
    excess: Floats
    follow: Floats


def tone_evidence(
    changes: Singles, residual: Singles, jacobian: Singles, weight: Singles, inverse: Floats
) -> Evidence:
    """From the changes (N, D, P) of the light of fitted models with the unknowns, its residual (N, P) and weight (1
    over variance), the jacobian (N, K, P) and the inverse normal matrix (N, K, K).

    The changes are at the light of the model, not of the pixel: noise would pull gamma with it (Box and Cox, 1964).
    """
    weighed = weight[:, None] * changes
    follow = inverse @ (jacobian @ np.swapaxes(weighed, 1, 2))
    alone = weighed - weight[:, None] * (np.swapaxes(follow, 1, 2) @ jacobian)
    curvature = (alone @ np.swapaxes(changes, 1, 2)).astype(float)
    scores = block_sums(alone * residual[:, None]).astype(float)
    least = 1e-12 * np.eye(changes.shape[1])
    excess = np.sum(scores * np.linalg.solve(curvature + least, scores), axis=(1, 2)) / changes.shape[1]
    return Evidence(-np.sum(scores, axis=2), curvature, excess, follow)
