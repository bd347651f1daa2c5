"""Views that were not taken at quite the same instant: each may stray a little from the common rectangle pose.

A moving rectangle has one pose in a frameset, but cameras out of step see it where it was a moment before or after.
What such a View shows of its lens stays true; what it shows of its camera's pose does not. So its
camera_from_rect may differ from the chain of Eq. 50 by a step of its own, its slack, with a Gaussian prior whose
width is learned from the Views (random effects of a mixed model; Dempster, Laird and Rubin 1977 for the learning).
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Mask

# Degrees of freedom of Student's t for the slack: low enough for stray Views to stray, high enough for a variance.
_STUDENT = 4.0

# Student's t of those degrees of freedom leaves one View in some ten thousand beyond this many widths (root mean
# square over the six): such a View was taken at another instant. Nearer ones keep a voice, as loud as t lets them.
_STRAY = 10.0


@dataclass(frozen=True, eq=False)
class SlackPrior:
    """Gaussian prior of each View's slack: precision (6,), 1/variance, times the View's weight (V,).

    loose (V,) bool: Views that have any slack.
    """

    loose: Mask
    weight: Floats
    precision: Floats

    @staticmethod
    def wide(loose: Mask, width: float) -> "SlackPrior":
        """The same width, rad and m, for every loose View."""
        return SlackPrior(loose, np.ones(len(loose)), np.full(6, width**-2))

    @property
    def information(self) -> Floats:
        """(V, 6), infinite where a View has no slack."""
        return np.where(self.loose[:, None], self.weight[:, None] * self.precision, np.inf)


@dataclass(frozen=True, eq=False)
class EliminatedSlack:
    """Gram matrices (V, K+7, K+7) with the slack of every View eliminated, and what leads back to the slack.

    inverse (V, 6, 6): of the slack's own normal matrix. rows (V, 6, K+7): of the slack, over all columns.
    """

    gram: Floats
    inverse: Floats
    rows: Floats


def eliminate_slack(gram: Floats, slack: Floats, information: Floats) -> EliminatedSlack:
    """Eliminate slack (V, 6) with prior information (V, 6); where that is infinite the View has none."""
    lens = gram.shape[-1] - 7
    loose = np.all(np.isfinite(information), axis=1)
    held = np.where(loose[:, None], information, 0.0)
    rows = gram[:, lens : lens + 6, :].copy()
    rows[:, :, -1] -= held * slack
    own = gram[:, lens : lens + 6, lens : lens + 6] + held[:, :, None] * np.eye(6)
    inverse = np.zeros_like(own)
    inverse[loose] = np.linalg.inv(own[loose])
    reduced = gram - np.swapaxes(gram[:, lens : lens + 6, :], -1, -2) @ inverse @ rows
    # The residual column alone carries the prior's pull; the row is its mirror, so that the matrix stays symmetric.
    reduced[:, -1, :] = reduced[:, :, -1]
    return EliminatedSlack(reduced, inverse, rows)


def slack_steps(eliminated: EliminatedSlack, steps: Floats) -> Floats:
    """Steps (V, 6) of the slack that go with steps (V, K+6) of lens and chained camera_from_rect."""
    pulled = eliminated.rows[:, :, -1:] - eliminated.rows[:, :, :-1] @ steps[..., None]
    return (eliminated.inverse @ pulled)[..., 0]


def slack_variances(eliminated: EliminatedSlack, by_node: Floats, node_covariance: Floats) -> Floats:
    """Variances (V, 6) of the slack, with the doubt of the rectangle poses that it is reckoned from.

    by_node (V, 6, 6): derivative of the chained camera_from_rect by its node's twist; node_covariance (V, 6, 6): of
    that twist. Without it a rectangle pose that one View alone sees would follow that View, and its slack would seem
    to be none (restricted against plain maximum likelihood; Patterson and Thompson 1971).
    """
    lens = eliminated.gram.shape[-1] - 7
    passed = eliminated.inverse @ eliminated.rows[:, :, lens : lens + 6] @ by_node
    return np.einsum("vii->vi", eliminated.inverse + passed @ node_covariance @ np.swapaxes(passed, -1, -2))


def learned(slack: Floats, variances: Floats, prior: SlackPrior) -> SlackPrior:
    """The prior of the slack by one step of expectation-maximisation from the last one.

    slack, variances (V, 6). Rotation and translation have one width each, and every View a weight of its own: slack
    follows Student's t, since a rectangle is now held still and now swung.
    """
    square = (slack**2 + variances)[prior.loose]
    weight = (_STUDENT + 6) / (_STUDENT + (square * prior.precision).sum(axis=1))
    rotation, translation = ((weight[:, None] * square[:, part]).mean() for part in (slice(0, 3), slice(3, 6)))
    every = np.ones(len(slack))
    every[prior.loose] = weight
    return SlackPrior(prior.loose, every, 1 / np.array([rotation] * 3 + [translation] * 3))


def strays(slack: Floats, prior: SlackPrior) -> Mask:
    """Views (V,) bool whose slack is far beyond the width that the Views together have."""
    return prior.loose & ((slack**2 * prior.precision).sum(axis=1) > 6 * _STRAY**2)
