"""Did a lens change while it was recorded? Autofocus moves the focal at some instant, by a few per cent.

A View with a pose of its own says of its lens what it says whatever moved, and whichever clock was off. Where all
Views of a camera from one instant on agree on another focal than those before, and neither noise nor what
neighbouring Views have in common explains it (Newey and West 1987), its lens was focused anew.
"""

import numpy as np

from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.single.arrays import Floats, Ints

# Twice the logarithm of the odds from which a change is told. A real camera that was seen to refocus has 34, the next
# of that recording 15; of 150 cameras that stayed as they were, boards waved out of step before a rolling shutter,
# none passes.
_SURE = 25.0
# By how much refocusing changes a focal, as a share of it; more than the larger share is zoom, or another fault.
_USUAL, _LARGEST = 0.02, 0.06
# Views on either side, that no single one that is off be taken for a change.
_FEWEST = 3
# Instants that are tried: further ones lie between two that are.
_MOST_INSTANTS = 200
# So many Views in a row go together.
_LAGS = 4
# Added to what a View says of its pose (1/rad^2, 1/m^2): far below what any contributes that is not rejected.
_LEAST_INFORMATION = 1e-9


def refocused(problem: Problem, joint: Joint) -> list[str]:
    """A sentence for each camera whose focal changed while it was recorded."""
    columns, free = joint.adjustment.columns, joint.free
    information, pull = _without_poses(joint)
    frameset = np.array([view.frameset for view in problem.views])
    sentences = []
    for camera in np.flatnonzero(free.lens[:, 0]):
        own = np.flatnonzero((problem.camera == camera) & ~joint.inliers.rejected)
        own = own[np.argsort(frameset[own], kind="stable")]
        instants = np.arange(_FEWEST, len(own) - _FEWEST + 1)
        if not len(instants):
            continue
        instants = instants[:: -(-len(instants) // _MOST_INSTANTS)]
        known = np.flatnonzero(free.lens[camera, columns])
        prior = free.information[camera][np.ix_(columns[known], columns[known])]
        lens, mean = joint.adjustment.state.lens[camera], free.prior_mean[camera]
        pulled = prior @ (mean - lens)[columns[known]]
        steps, sigmas = focal_steps(
            information[own][:, known[:, None], known], pull[own][:, known], prior, pulled, instants
        )
        usual = (_USUAL * lens[0] / sigmas) ** 2
        odds = (steps / sigmas) ** 2 * usual / (1 + usual) - np.log1p(usual)
        odds = np.where(np.abs(steps) < _LARGEST * lens[0], odds, 0.0)
        best = int(np.argmax(odds))
        if odds[best] > _SURE:
            views = [problem.views[index] for index in own]
            first = views[instants[best]]
            late = first.time - views[0].time
            when = f" ({late:.1f} s after it saw its first rectangle)" if np.isfinite(late) else ""
            part = "before" if instants[best] < len(own) / 2 else "from then on"
            sentences.append(
                f"{problem.cameras[camera].name}: its focal changed by {steps[best]:+.0f} ± {sigmas[best]:.0f} px at "
                f"about frameset {first.frameset}{when}: the lens was focused anew, and no lens fits the whole "
                f"recording; switch autofocus off, or leave out its pictures {part}"
            )
    return sentences


def focal_steps(
    information: Floats, pull: Floats, prior: Floats, pulled: Floats, instants: Ints
) -> tuple[Floats, Floats]:
    """By how much the first parameter of a lens is another from each of some instants (I,) on, and its sigma (I,).

    information (V, K, K), pull (V, K): what each View says of the lens, in order of time; prior (K, K), pulled (K,):
    what is known of it beforehand. instants: counts of the Views before.
    """
    views = len(information)
    inverse = np.linalg.inv(information.sum(axis=0) + prior)
    alike = inverse @ (pull.sum(axis=0) + pulled)
    after = np.arange(views) >= instants[:, None]
    by_lens = after @ information[:, 0]
    others = by_lens @ inverse
    known = np.maximum(by_lens[:, 0] - (others * by_lens).sum(axis=1), np.finfo(float).tiny)
    steps = (after @ pull[:, 0] - by_lens @ alike) / known
    # What each View's residuals, with the step in, still pull at it.
    lens = alike - steps[:, None] * others
    left = (
        pull - np.einsum("vkl,il->ivk", information, lens) - (steps[:, None] * after)[..., None] * information[:, 0]
    )
    own = np.where(after, left[..., 0], 0.0) - np.einsum("ivk,ik->iv", left, others)
    spread = (own**2).sum(axis=1)
    for lag in range(1, min(_LAGS, views)):
        spread += 2 * (1 - lag / _LAGS) * (own[:, lag:] * own[:, :-lag]).sum(axis=1)
    # No surer than noise allows.
    return steps, np.sqrt(np.maximum(spread, known)) / known


def _without_poses(joint: Joint) -> tuple[Floats, Floats]:
    """Information (V, K, K) of each View on its lens, and its pull (V, K), where its pose is its own."""
    gram, lens = joint.adjustment.linearised.gram, len(joint.adjustment.columns)
    pose = slice(-7, -1)
    inverse = np.linalg.inv(gram[:, pose, pose] + _LEAST_INFORMATION * np.eye(6))
    left = gram - gram[:, :, pose] @ inverse @ gram[:, pose, :]
    return left[:, :lens, :lens], left[:, :lens, -1]
