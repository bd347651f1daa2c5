"""Errors that many corners share: the shape of a sheet in all its Views, what a tone curve does in all of a camera's.

They are unknowns like any other, small, with priors, and linear: what they move is worked out once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.observations import ObservationGroup, Observations
from quadrig.rig.sheet_shape import SHAPE_PARAMETERS, shape_basis, shape_covariance
from quadrig.single.arrays import Floats, Ints

_SHAPES = len(SHAPE_PARAMETERS)


@dataclass(frozen=True, eq=False)
class SystematicErrors:
    """U unknowns in all: seven of each sheet in the order of Problem.rectangles, then the tone of each camera.

    For each group of Views: index (V, E), which unknowns act on a View; by_point (V, P, 7, 3) m, how points move with
    the first seven of them, in the frame of the View's node; by_pixel (V, P, E - 7, 2) px, how pixels move with the
    others. information (U, U): of the prior, whose mean is zero.
    """

    index: tuple[Ints, ...]
    by_point: tuple[Floats, ...]
    by_pixel: tuple[Floats, ...]
    information: Floats

    def corrected(self, observations: Observations, values: Floats) -> Observations:
        """The Views with errors of these values (U,) taken off: points as they are on the sheets, pixels as they
        would be without them."""
        groups = []
        for group, index, by_point, by_pixel in zip(
            observations.groups, self.index, self.by_point, self.by_pixel, strict=True
        ):
            own = values[index][:, None, :, None]
            points = group.points + (by_point * own[:, :, :_SHAPES]).sum(axis=2)
            pixels = group.pixels - (by_pixel * own[:, :, _SHAPES:]).sum(axis=2)
            groups.append(replace(group, points=points, pixels=pixels))
        return replace(observations, groups=tuple(groups))


def systematic_errors(problem: Problem, observations: Observations) -> SystematicErrors:
    """Those of a problem; observations: its Views, in the readings that are chosen."""
    rectangles = list(problem.rectangles.values())
    number = {name: row for row, name in enumerate(problem.rectangles)}
    rectangle = np.array([number[view.rectangle] for view in problem.views], int)
    shared = any(view.common is not None for view in problem.views)
    index, by_point, by_pixel = [], [], []
    for group in observations.groups:
        own = rectangle[group.view]
        columns = [_SHAPES * own[:, None] + np.arange(_SHAPES)]
        if shared:
            columns.append(_SHAPES * len(rectangles) + group.camera[:, None])
        index.append(np.concatenate(columns, axis=1))
        moves = np.zeros((*group.points.shape[:2], _SHAPES, 3))
        for row in np.unique(own):
            moves[own == row] = _shape_moves(problem, row, group.points[own == row])
        by_point.append(moves)
        by_pixel.append(_tone_moves(problem, group) if shared else np.zeros((*group.pixels.shape[:2], 0, 2)))
    information = np.linalg.inv(shape_covariance(rectangles))
    if shared:
        information = _with_units(information, observations.cameras)
    return SystematicErrors(tuple(index), tuple(by_point), tuple(by_pixel), information)


def _shape_moves(problem: Problem, row: int, points: Floats) -> Floats:
    """How points (..., 3) in the frame of the node of a rectangle move with its shape: (..., 7, 3)."""
    rectangle = list(problem.rectangles.values())[row]
    pose = rectangle.world_from_rect
    if pose is None:
        return shape_basis(rectangle, points)
    return shape_basis(rectangle, pose.inverse().transform(points)) @ pose.rotation.T


def _tone_moves(problem: Problem, group: ObservationGroup) -> Floats:
    """How pixels of the Views of a group move with the tone of their cameras: (V, P, 1, 2)."""
    moves = np.zeros((*group.pixels.shape[:2], 1, 2))
    for row, view in enumerate(group.view):
        common = problem.views[view].common
        if common is not None:
            moves[row, : len(common), 0] = common
    return moves


def _with_units(information: Floats, count: int) -> Floats:
    size = len(information)
    whole = np.eye(size + count)
    whole[:size, :size] = information
    return whole


def sheet_values(values: Floats, covariance: Floats, rectangles: Sequence[str], name: str) -> tuple[Floats, Floats]:
    """The values (7,) and covariance (7, 7) of one sheet, of all unknowns."""
    rows = _SHAPES * list(rectangles).index(name) + np.arange(_SHAPES)
    return values[rows], covariance[np.ix_(rows, rows)]
