"""What the fit would have said of framesets that it had not seen, and whether parts of the recording agree.

Each rectangle pose belongs to one fold: framesets a fifth of the recording at a time, so that what a fold shares
with its neighbours in time (a clock, a light, a bent board) is held out with it. The reduced normal equations are
sums over rectangle poses, so holding a fold out is a subtraction: one Newton step gives the cameras without it, and
the fold's own rectangle poses are fitted to them. Equal to a fit without the fold to second order (shown by a test
against real refits).
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import view_steps
from quadrig.rig.adjustment.normal_equations import State, layout, linearise, normal_equations
from quadrig.rig.adjustment.schur import Reduced, block_matrix, eliminate, node_steps, solve_cameras
from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Ints, Mask

# Five folds leave four fifths to fit: near enough to the whole that the figure speaks of the rig that is delivered.
_FOLDS = 5
# What noise alone explains has the weight of so many numbers, in the figure of all cameras and in each camera's own:
# folds of a recording are few, and what they disagree on shows in some ten of a camera's numbers.
_TRUSTED = 20.0


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """squares (V,): sum of squared residuals (px^2) of each View, as predicted without it; nan where that cannot be
    said. dispersion (C,): the variance between the folds of each camera's numbers as a multiple of what noise
    explains, 1 on average where nothing else is at work; drawn towards that of all cameras, and that towards 1."""

    squares: Floats
    dispersion: Floats

    @property
    def widening(self) -> Floats:
        """What the variances of each camera (C,) are multiplied by; folds that agree by chance make none surer."""
        return np.maximum(self.dispersion, 1.0)


def cross_validate(problem: Problem, joint: Joint) -> CrossValidation:
    """Hold each fold out in turn."""
    fold = _folds(problem)[joint.observations.node]
    count = int(fold.max(initial=-1)) + 1
    if count < 2:
        return CrossValidation(np.full(len(fold), np.nan), np.ones(joint.observations.cameras))
    adjustment, free_nodes = joint.adjustment, joint.free.node
    # A copy of every camera for each fold: then each copy's sums are those of its fold alone, all in one pass.
    copies = _copied(joint.observations, fold, count)
    tables = layout(copies)
    fit, predicted = _copied_state(adjustment.state, count), _copied_state(joint.predicted, count)
    weighing = adjustment.linearised.gram if adjustment.eliminated is None else adjustment.eliminated.gram
    free = np.tile(joint.reduced.free, (count, 1))
    normal = normal_equations(copies, tables, fit, weighing)
    own = eliminate(normal, tables, free, free_nodes)
    steps = np.concatenate([_steps_without(joint, own, number, fold == number) for number in range(count)])
    gram, at_prediction = weighing, own
    if adjustment.eliminated is not None:
        # What the rig says of the pictures has no View straying: another state, with derivatives of its own.
        gram = linearise(joint.observations, joint.predicted, adjustment.columns, joint.noise).gram
        normal = normal_equations(copies, tables, predicted, gram)
    if adjustment.eliminated is not None or not free_nodes.all():
        at_prediction = eliminate(normal, tables, free, np.ones_like(free_nodes))
    poses = node_steps(normal, tables, at_prediction, steps)
    step = view_steps(copies, predicted, steps, poses, len(adjustment.columns))
    residual = np.concatenate([step, -np.ones((len(step), 1))], axis=1)[:, None]
    squares = (residual @ gram @ np.swapaxes(residual, -1, -2))[:, 0, 0]
    squares = squares * (joint.noise * problem.sigmas) ** 2 / problem.shares
    return CrossValidation(squares, _dispersion(joint, own, count))


def _folds(problem: Problem) -> Ints:
    """The fold (N,) of each node: framesets in a row, about as many Views in each fold, still rectangles in turn."""
    frameset = np.array([node.frameset for node in problem.nodes], int)
    folds = np.zeros(len(frameset), int)
    moving = frameset >= 0
    if moving.any():
        order = np.unique(frameset[moving], return_inverse=True)[1]
        views = np.bincount(problem.node, minlength=len(frameset))[moving]
        total = np.bincount(order, views)
        middle = np.cumsum(total) - total / 2
        # Few framesets, or ones of many Views, may skip a fold: numbers are closed up.
        number = np.unique((_FOLDS * middle / total.sum()).astype(int), return_inverse=True)[1]
        folds[moving] = number[order]
    folds[~moving] = np.arange(int((~moving).sum())) % _FOLDS
    return folds


def _copied(observations: Observations, fold: Ints, count: int) -> Observations:
    return replace(
        observations,
        groups=(),
        camera=observations.camera + fold * observations.cameras,
        cameras=observations.cameras * count,
    )


def _copied_state(state: State, count: int) -> State:
    cameras = np.tile(np.arange(len(state.lens)), count)
    offsets = None if state.offsets is None else state.offsets[cameras]
    return replace(state, lens=state.lens[cameras], camera_from_rig=state.camera_from_rig[cameras], offsets=offsets)


def _steps_without(joint: Joint, own: Reduced, number: int, out: Mask) -> Floats:
    """Steps (C, M) of the cameras when the Views `out` (V,) of a fold are taken from the fit; nan if they must stay.

    own: the folds' reduced systems, of which this fold's is taken off the whole.
    """
    whole, cameras = joint.reduced, joint.observations.cameras
    chosen = own.left // cameras == number
    key = own.left[chosen] % cameras * cameras + own.right[chosen] % cameras
    blocks = whole.blocks.copy()
    blocks[np.searchsorted(whole.left * cameras + whole.right, key)] -= own.blocks[chosen]
    gradient = whole.gradient - own.gradient[number * cameras : (number + 1) * cameras]
    free = whole.free
    if not joint.free.node[joint.observations.node[out]].all():
        # The rectangle that held the rig frame is held out itself: a camera holds the frame in its stead.
        lens = len(joint.adjustment.columns)
        free = free.copy()
        free[0, lens : lens + 6] = False
    try:
        return solve_cameras(replace(whole, blocks=blocks, gradient=gradient, free=free))
    except np.linalg.LinAlgError:
        return np.full_like(gradient, np.nan)


def _dispersion(joint: Joint, own: Reduced, count: int) -> Floats:
    """Variance (C,) between the folds of each camera's lens, as a multiple of what noise alone makes it.

    With C the covariance, and D and g a fold's information and gradient at the optimum: the fold moves the cameras by
    C g, of which the covariance is C (D - D C D) C (the infinitesimal jackknife; Jaeckel 1972). All cameras together
    are measured by g' C g, each by its lens in units of the lens's own covariance: neither depends on where the rig
    frame stands. A ratio counts for as many numbers as it was measured on, times the folds.
    """
    cameras, lens = joint.observations.cameras, len(joint.adjustment.columns)
    size = len(joint.covariance) // cameras
    free = joint.reduced.free[:, :lens]
    both, each = free[:, :, None] & free[:, None, :], np.arange(cameras)

    def of_lens(matrix: Floats) -> Floats:
        return matrix.reshape(cameras, size, cameras, size)[each, :, each][:, :lens, :lens]

    inverse = np.where(both, np.linalg.inv(np.where(both, of_lens(joint.covariance), np.eye(lens))), 0.0)
    seen, expected, together, by_chance = np.zeros(cameras), np.zeros(cameras), 0.0, 0.0
    for number in range(count):
        chosen = own.left // cameras == number
        left, right = own.left[chosen] % cameras, own.right[chosen] % cameras
        rows = slice(number * cameras, (number + 1) * cameras)
        gradient = np.where(own.free[rows], own.gradient[rows], 0.0).ravel()
        moved = joint.covariance @ gradient
        together += float(gradient @ moved)
        of_each = moved.reshape(cameras, 1, size)[:, :, :lens]
        seen += (of_each @ inverse @ np.swapaxes(of_each, 1, 2))[:, 0, 0]
        pulled = block_matrix(own.blocks[chosen], left, right, cameras) @ joint.covariance
        by_chance += float(np.trace(pulled) - (pulled * pulled.T).sum())
        expected += (of_lens(joint.covariance @ (pulled - pulled @ pulled)) * inverse).sum(axis=(1, 2))
    if not by_chance > 0:
        return np.ones(cameras)
    # Cameras of one rig are not independent: together they count for as much as one of them.
    weight, pooled_weight = count * np.maximum(expected, 0.0), count * by_chance / cameras
    pooled = (_TRUSTED + pooled_weight * together / by_chance) / (_TRUSTED + pooled_weight)
    return (_TRUSTED * pooled + count * seen) / (_TRUSTED + weight)
