"""What the fit would have said of framesets that it had not seen.

Each rectangle pose belongs to one fold. The reduced normal equations are sums over rectangle poses, so leaving a fold
out is a subtraction: one Newton step gives the cameras without it, and the fold's own rectangle poses are fitted to
them. Equal to a fit without the fold to second order (shown by a test against real refits).
"""

from dataclasses import replace

import numpy as np

from quadrig.single.rotation import Array

from .adjust import view_steps, with_prior
from .elimination import eliminate, node_steps, solve_cameras
from .joint import Joint
from .normal_equations import linearise, normal_equations
from .problem import Problem

# Five folds leave four fifths to fit: near enough to the whole that the figure speaks of the rig that is delivered.
_FOLDS = 5


def left_out_squares(problem: Problem, joint: Joint) -> Array:
    """Sum of squared residuals (V,) px^2 of each View, as predicted without it; nan where that cannot be said."""
    fold = _folds(problem)
    result = np.full(len(problem.views), np.nan)
    gram = _gram_of_prediction(joint)
    scale = (joint.noise * problem.sigmas) ** 2 / problem.shares
    for number in range(int(fold.max(initial=-1)) + 1):
        out = fold[joint.observations.node] == number
        if out.any() and not out.all():
            squares = _squares_of(joint, gram, out) * scale
            result[out] = squares[out]
    return result


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


def _gram_of_prediction(joint: Joint) -> Array:
    """Gram matrices (V, K+7, K+7) at what the rig says of the pictures."""
    adjustment = joint.adjustment
    if adjustment.softened is None:
        return adjustment.linearised.gram
    return linearise(joint.observations, joint.predicted, adjustment.columns, joint.noise, False).gram


def _squares_of(joint: Joint, gram: Array, out: Array) -> Array:
    """Squared residuals (V,), in units of the noise, of Views `out` for the cameras that the others make."""
    adjustment, freedom = joint.adjustment, joint.freedom
    observations, tables, state = joint.observations, adjustment.layout, adjustment.state
    weighing = adjustment.linearised.gram if adjustment.softened is None else adjustment.softened.gram
    kept = normal_equations(observations, tables, state, np.where(out[:, None, None], 0.0, weighing))
    training = with_prior(kept, state, freedom, adjustment.columns)
    if not freedom.node[observations.node[out]].all():
        # The rectangle that held the rig frame is left out itself: a camera holds the frame in its stead.
        held = np.arange(len(freedom.pose)) != 0
        freedom = replace(freedom, pose=freedom.pose & held, node=np.ones_like(freedom.node))
    unknowns = freedom.unknowns(adjustment.columns, state)
    try:
        steps = solve_cameras(eliminate(training, tables, unknowns, freedom.node))
    except np.linalg.LinAlgError:
        return np.full(len(gram), np.nan)
    predicted = joint.predicted
    left = normal_equations(observations, tables, predicted, np.where(out[:, None, None], gram, 0.0))
    poses = node_steps(left, tables, eliminate(left, tables, unknowns, freedom.node), steps)
    step = view_steps(observations, predicted, steps, poses, len(adjustment.columns))
    step = np.concatenate([step, -np.ones((len(step), 1))], axis=1)
    return np.einsum("vi,vij,vj->v", step, gram, step, optimize=True)
