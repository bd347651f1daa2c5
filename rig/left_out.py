"""What the fit would have said of framesets that it had not seen.

Each rectangle pose belongs to one fold. The reduced normal equations are sums over rectangle poses, so leaving a fold
out is a subtraction: one Newton step gives the cameras without it, and the fold's own rectangle poses are fitted to
them. Equal to a fit without the fold to second order (shown by a test against real refits).
"""

from dataclasses import replace

import numpy as np

from quadrig.single.rotation import Array

from .adjust import view_steps
from .elimination import Reduced, eliminate, node_steps, solve_cameras
from .joint import Joint
from .normal_equations import State, layout, linearise, normal_equations
from .observations import Observations
from .problem import Problem

# Five folds leave four fifths to fit: near enough to the whole that the figure speaks of the rig that is delivered.
_FOLDS = 5


def left_out_squares(problem: Problem, joint: Joint) -> Array:
    """Sum of squared residuals (V,) px^2 of each View, as predicted without it; nan where that cannot be said."""
    fold = _folds(problem)[joint.observations.node]
    count = int(fold.max(initial=-1)) + 1
    if count < 2:
        return np.full(len(fold), np.nan)
    adjustment, freedom = joint.adjustment, joint.freedom
    # A copy of every camera for each fold: then each copy's sums are those of its fold alone, all in one pass.
    copies = _copied(joint.observations, fold, count)
    tables = layout(copies)
    fit, predicted = _copied_state(adjustment.state, count), _copied_state(joint.predicted, count)
    weighing = adjustment.linearised.gram if adjustment.softened is None else adjustment.softened.gram
    free = np.tile(joint.reduced.free, (count, 1))
    normal = normal_equations(copies, tables, fit, weighing)
    own = eliminate(normal, tables, free, freedom.node)
    steps = np.concatenate([_steps_without(joint, own, number, fold == number) for number in range(count)])
    gram, at_prediction = weighing, own
    if adjustment.softened is not None:
        # What the rig says of the pictures has no View straying: another state, with derivatives of its own.
        gram = linearise(joint.observations, joint.predicted, adjustment.columns, joint.noise, False).gram
        normal = normal_equations(copies, tables, predicted, gram)
    if adjustment.softened is not None or not freedom.node.all():
        at_prediction = eliminate(normal, tables, free, np.ones_like(freedom.node))
    poses = node_steps(normal, tables, at_prediction, steps)
    step = view_steps(copies, predicted, steps, poses, len(adjustment.columns))
    residual = np.concatenate([step, -np.ones((len(step), 1))], axis=1)[:, None]
    squares = (residual @ gram @ np.swapaxes(residual, -1, -2))[:, 0, 0]
    return squares * (joint.noise * problem.sigmas) ** 2 / problem.shares


def _folds(problem: Problem) -> Array:
    """The fold (N,) of each node: framesets dealt out in turn, still rectangles likewise."""
    framesets = sorted({n.frameset for n in problem.nodes if n.frameset >= 0})
    place = {frameset: index for index, frameset in enumerate(framesets)}
    still = 0
    folds = []
    for node in problem.nodes:
        if node.frameset >= 0:
            folds.append(place[node.frameset] % _FOLDS)
        else:
            folds.append(still % _FOLDS)
            still += 1
    return np.array(folds, int)


def _copied(observations: Observations, fold: Array, count: int) -> Observations:
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


def _steps_without(joint: Joint, own: Reduced, number: int, out: Array) -> Array:
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
    if not joint.freedom.node[joint.observations.node[out]].all():
        # The rectangle that held the rig frame is left out itself: a camera holds the frame in its stead.
        lens = len(joint.adjustment.columns)
        free = free.copy()
        free[0, lens : lens + 6] = False
    try:
        return solve_cameras(replace(whole, blocks=blocks, gradient=gradient, free=free))
    except np.linalg.LinAlgError:
        return np.full_like(gradient, np.nan)
