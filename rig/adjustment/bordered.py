"""The adjustment with systematic errors: few unknowns that touch many Views, as a border of the reduced system.

With C the inverse of the reduced system over the cameras, B what ties the errors to it and D their own part, both
after the rectangle poses are eliminated: the errors' covariance is S = (D + prior - B' C B)^-1, and the cameras' is
C + C B S B' C.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import Adjustment, FreeParameters, stepped
from quadrig.rig.adjustment.normal_equations import State, chain_derivatives, view_rows
from quadrig.rig.adjustment.schur import Reduced, node_steps
from quadrig.rig.adjustment.slack import eliminate_slack
from quadrig.rig.adjustment.systematic_errors import SystematicErrors
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Ints

if TYPE_CHECKING:
    import scipy.sparse


@dataclass(frozen=True, eq=False)
class Border:
    """What ties the errors to the cameras, rectangle poses eliminated.

    cameras (C M, U): B above. information (U, U): D with the prior; gradient (U,) down the cost, prior included.
    pairs (C M, 6 N) and passed (6 N, U), sparse: what leads to the steps of the nodes.
    """

    cameras: Floats
    information: Floats
    gradient: Floats
    pairs: "scipy.sparse.csr_array"
    passed: "scipy.sparse.csr_array"

    def information_lost(self) -> Floats:
        """(C M, C M): by how much less the reduced system says when the errors may take any value."""
        lost = self.cameras @ np.linalg.solve(self.information, self.cameras.T)
        return (lost + lost.T) / 2


def border_of(
    errors: SystematicErrors,
    values: Floats,
    observations: Observations,
    found: Adjustment,
    free: FreeParameters,
    noise: float,
    reduced: Reduced,
) -> Border:
    """The border at the end of an adjustment by least squares, made with errors of these values (U,) taken off.

    reduced: of that adjustment. noise: px.
    """
    from scipy.sparse import bsr_array, coo_array

    cameras, size = reduced.free.shape
    nodes, tables = observations.nodes, found.layout
    own = _Sums.of(errors, observations, found, free, noise, size, len(values))
    node_inverse = bsr_array((reduced.node_inverse, np.arange(nodes), np.arange(nodes + 1)), shape=(6 * nodes,) * 2)
    row = tables.pair_camera[:, None, None] * size + np.arange(size)[:, None]
    column = tables.pair_node[:, None, None] * 6 + np.arange(6)
    at = [axis.ravel() for axis in np.broadcast_arrays(row, column)]
    pairs = coo_array((found.normal.pairs.ravel(), at), shape=(cameras * size, 6 * nodes)).tocsr()
    passed = node_inverse @ own.nodes
    border = np.where(reduced.free.ravel()[:, None], own.cameras - (pairs @ passed).toarray(), 0.0)
    information = own.errors - (own.nodes.T @ passed).toarray() + errors.information
    gradient = own.gradient - passed.T @ found.normal.node_gradient.ravel() - errors.information @ values
    return Border(border, information, gradient, pairs, passed)


@dataclass(frozen=True, eq=False)
class Bordered:
    """One step to the minimum over cameras, rectangle poses and systematic errors together.

    values (U,): of the errors; covariance (U, U). state: where the rest went. by_camera (C M, U), by_node (N, 6, U):
    by how much cameras and nodes move with each of U independent errors of one sigma: by_camera @ by_camera.T is
    what they add to the cameras' covariance. fall: of chi-square, that is expected. effective: how many unknowns the
    errors count for, less what priors hold.
    """

    values: Floats
    covariance: Floats
    state: State
    by_camera: Floats
    by_node: Floats
    fall: float
    effective: float

    def with_errors(self, camera_covariance: Floats) -> Floats:
        """The covariance (C M, C M) of the cameras with the errors' doubt, from that without."""
        return camera_covariance + self.by_camera @ self.by_camera.T


def solve_bordered(
    errors: SystematicErrors,
    values: Floats,
    observations: Observations,
    found: Adjustment,
    free: FreeParameters,
    noise: float,
    reduced: Reduced,
    camera_covariance: Floats,
) -> Bordered:
    """The step from the end of an adjustment, as `border_of` has it; camera_covariance (C M, C M): without the
    errors."""
    from scipy.linalg import solve_triangular

    border = border_of(errors, values, observations, found, free, noise, reduced)
    through = camera_covariance @ border.cameras
    information = border.information - border.cameras.T @ through
    lower = np.linalg.cholesky((information + information.T) / 2)
    root = solve_triangular(lower, np.eye(len(values)), lower=True).T
    gradient = np.where(reduced.free, reduced.gradient, 0.0).ravel()
    pulled = border.gradient - through.T @ gradient
    step = root @ (root.T @ pulled)
    steps = (camera_covariance @ gradient - through @ step).reshape(reduced.free.shape)
    poses = node_steps(found.normal, found.layout, reduced, steps) - (border.passed @ step).reshape(-1, 6)
    by_camera = -through @ root
    pulled_nodes = (border.pairs.T @ by_camera).reshape(-1, 6, len(values))
    by_node = -reduced.node_inverse @ pulled_nodes - (border.passed @ root).reshape(-1, 6, len(values))
    covariance = root @ root.T
    return Bordered(
        values + step,
        covariance,
        stepped(observations, found.columns, found.state, found.eliminated, steps, poses),
        by_camera,
        by_node,
        float(step @ pulled),
        len(values) - float((errors.information * covariance).sum()),
    )


@dataclass(frozen=True, eq=False)
class _Sums:
    """The errors' part of the normal equations: with cameras (C M, U), with nodes (6 N, U) sparse, among themselves
    (U, U), and the gradient (U,)."""

    cameras: Floats
    nodes: "scipy.sparse.csr_array"
    errors: Floats
    gradient: Floats

    @staticmethod
    def of(
        errors: SystematicErrors,
        observations: Observations,
        found: Adjustment,
        free: FreeParameters,
        noise: float,
        size: int,
        unknowns: int,
    ) -> "_Sums":
        """size: M, of a camera's unknowns."""
        from scipy.sparse import coo_array

        lens = len(found.columns)
        gram, index = _gram(errors, observations, found, noise)
        count = index.shape[1]
        if free.slack is not None and found.state.slack is not None:
            gram = eliminate_slack(gram, found.state.slack, free.slack.information).gram
        by_camera, by_node = chain_derivatives(observations, found.state)
        pose = slice(lens + count, lens + count + 6)
        rows = gram[:, lens : lens + count]
        with_camera = np.concatenate([rows[:, :, :lens], rows[:, :, pose] @ by_camera], axis=2)
        result = np.zeros((observations.cameras, size, unknowns))
        places = observations.camera[:, None, None], np.arange(size)[:, None], index[:, None, :]
        np.add.at(result, places, np.swapaxes(with_camera, 1, 2))
        with_node = np.swapaxes(rows[:, :, pose] @ by_node, 1, 2)
        row = observations.node[:, None, None] * 6 + np.arange(6)[:, None]
        at = [axis.ravel() for axis in np.broadcast_arrays(row, index[:, None, :])]
        nodes = coo_array((with_node.ravel(), at), shape=(6 * observations.nodes, unknowns)).tocsr()
        own, gradient = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        np.add.at(own, (index[:, :, None], index[:, None, :]), rows[:, :, lens : lens + count])
        np.add.at(gradient, index, rows[:, :, -1])
        return _Sums(result.reshape(-1, unknowns), nodes, own, gradient)


def _gram(
    errors: SystematicErrors, observations: Observations, found: Adjustment, noise: float
) -> tuple[Floats, Ints]:
    """Gram matrices (V, K+E+7, K+E+7) over [lens columns, errors, step of camera_from_rect, residual], and which
    errors (V, E) these are."""
    state, lens, views = found.state, len(found.columns), len(observations.camera)
    chained = state.camera_from_rect(observations)
    count = errors.index[0].shape[1]
    gram, which = np.zeros((views, lens + count + 7, lens + count + 7)), np.zeros((views, count), int)
    for group, index, by_point, by_pixel in zip(
        observations.groups, errors.index, errors.by_point, errors.by_pixel, strict=True
    ):
        pose = chained[group.view]
        rows, _ = view_rows(group, state.lens[group.camera], pose, found.columns)
        located = by_point @ np.swapaxes(pose.rotation, -1, -2)[:, None]
        of_shapes = np.einsum("avip,vpsa->svip", rows[lens + 3 : lens + 6], located)
        every = np.concatenate([rows[:lens], of_shapes, by_pixel.transpose(2, 0, 3, 1), rows[lens:]])
        every = np.where(np.isfinite(every), every, 0.0) * np.sqrt(group.weights / noise**2)[:, None, :]
        flat = every.reshape(len(every), len(group.view), -1).transpose(1, 0, 2)
        gram[group.view], which[group.view] = flat @ np.swapaxes(flat, -1, -2), index
    return gram, which
