"""The least errors that any estimator can have in a world of benchmarks/body_worlds.py: the bound of Cramer and Rao,
by the derivatives at the truth and the noise that was drawn, with the priors that the truth was drawn from."""

from dataclasses import replace

import numpy as np
from body_worlds import NOISE, Carried

from quadrig.rig.adjustment.bordered import expand, solve_bordered
from quadrig.rig.adjustment.levenberg_marquardt import FreeParameters
from quadrig.rig.adjustment.motion import motion
from quadrig.rig.adjustment.pose_priors import LayoutPrior
from quadrig.rig.adjustment.priors import estimated_lenses, first_priors
from quadrig.rig.adjustment.schur import reduced_inverse
from quadrig.rig.adjustment.state import State
from quadrig.rig.adjustment.systematic_errors import SystematicErrors, systematic_errors
from quadrig.rig.adjustment.tables import tables_of
from quadrig.rig.problem.build import Problem, build_problem
from quadrig.rig.problem.layouts import body_of
from quadrig.single.arrays import Floats
from quadrig.single.pose import stacked, step_by_camera_twist

# What the truth has none of is held at zero by so much, 1/px^2.
_NONE = 1e9
# So many draws give a median to 2 %.
_DRAWN = 4000


def least_errors(world: Carried, *, exact: bool = False, lenses: bool = True) -> Floats:
    """Of each camera but the first: the median errors (C - 1, 2) of rotation (degrees) and position (mm).

    Lenses are what lenses are before any picture, sheets what prints are. exact: sheets as they should be; lenses:
    False where they are known. nan where the motion leaves a direction wholly open.
    """
    problem = build_problem(world.made.inputs, world.made.rectangles, world.made.views)
    observations, cameras = problem.observations(), len(problem.cameras)
    state, priors = true_state(world, problem), first_priors(problem, world.lenses[:, 0])
    found = problem.layouts.found
    free = FreeParameters(
        estimated_lenses(problem) & lenses,
        np.arange(cameras) > 0,
        np.ones(observations.nodes, bool),
        state.lens,
        priors.information,
        layouts=LayoutPrior(state.body_from_rect[:found], problem.layouts.information[:found]),
    )
    errors = _of_sheets(systematic_errors(problem, observations), exact)
    there = expand(errors, observations, state, free, NOISE, tables_of(observations))
    none = np.zeros(len(errors.held))
    try:
        firm = reduced_inverse(there.reduced)
        bordered = solve_bordered(there.border, errors, none, there.adjustment, there.reduced, firm)
    except np.linalg.LinAlgError:
        return np.full((cameras - 1, 2), np.nan)
    covariance = bordered.widened(None, None)
    size, first = there.reduced.free.shape[1], len(there.adjustment.columns)
    by_twist = step_by_camera_twist(world.rig_from_camera)
    errors_of = []
    for camera in range(1, cameras):
        own = camera * size + first + np.arange(6)
        step = by_twist[camera] @ covariance[np.ix_(own, own)] @ by_twist[camera].T
        errors_of.append((np.degrees(_median(step[:3, :3])), 1e3 * _median(step[3:, 3:])))
    return np.array(errors_of)


def _median(covariance: Floats) -> float:
    """The median length of a normal vector of that covariance (3, 3)."""
    drawn = np.random.default_rng(0).normal(size=(_DRAWN, 3))
    return float(np.median(np.linalg.norm(drawn @ np.linalg.cholesky(covariance).T, axis=1)))


def true_state(world: Carried, problem: Problem) -> State:
    """The truth, in the frame of the first camera."""
    cam0_from_rig = world.rig_from_camera[0].inverse()
    camera_from_rig = (cam0_from_rig @ world.rig_from_camera).inverse()
    names, layouts = list(problem.rectangles), problem.layouts
    places = {name: cam0_from_rig @ world.made.world_from_rect[name] for name in names}
    frames = {
        body_of(rectangle): name
        for (name, rectangle), row in zip(problem.rectangles.items(), layouts.number, strict=True)
        if row < 0
    }
    bodies = [places[frames[node.body]][node.frameset] for node in problem.nodes]
    on_body = [
        places[frames[body_of(problem.rectangles[name])]][0].inverse() @ places[name][0] for name in layouts.names
    ]
    state = State(world.lenses, camera_from_rig, stacked(bodies), stacked(on_body))
    if not world.clocks.any():
        return state
    moved = motion(problem, state.rig_from_body, world.clocks)
    return state if moved is None else replace(state, motion=moved, clocks=world.clocks)


def _of_sheets(errors: SystematicErrors, exact: bool) -> SystematicErrors:
    """The same where lenses leave nothing over, and sheets nothing where they are exact."""
    held, none = errors.held.copy(), slice(None) if exact else errors.lens_rows.ravel()
    held[none] += _NONE
    return replace(errors, held=held)
