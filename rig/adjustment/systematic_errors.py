"""Errors that many corners share: the shape of a sheet in all its Views, what a tone curve and a lens beside its
model do in all pictures of a camera.

They are unknowns like any other, small, with priors, and linear: what they move is worked out once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.observations import ObservationGroup, Observations
from quadrig.single.arrays import Floats, Ints
from quadrig.single.posterior.lens_remainder import (
    degrees_of,
    field_basis,
    learned_variance,
    shares_of,
    usual_variance,
)
from quadrig.single.posterior.sheet_shape import SHAPE_PARAMETERS, shape_basis, shape_information

_SHAPES = len(SHAPE_PARAMETERS)


@dataclass(frozen=True, eq=False)
class Moves:
    """How the points and pixels of a group of Views move with the errors.

    index (V, E): which unknowns act on a View: seven of its sheet, then the tone of its camera, then twice B of its
    camera's lens, across and down. by_shape (V, 7, 3, P) m: of points, in the rectangle's frame. by_tone
    (V, T, 2, P) px, T one or none; by_lens (V, B, P): of a pixel's either coordinate, for one px.
    """

    index: Ints
    by_shape: Floats
    by_tone: Floats
    by_lens: Floats

    def part(self, rows: slice) -> "Moves":
        """Some of the Views."""
        return Moves(self.index[rows], self.by_shape[rows], self.by_tone[rows], self.by_lens[rows])

    def corrected(self, group: ObservationGroup, values: Floats) -> ObservationGroup:
        """The Views with errors of these values (U,) taken off."""
        own = values[self.index][:, None]
        tones, fields = self.by_tone.shape[1], self.by_lens.shape[1]
        shape, tone, across, down = np.split(own, np.cumsum([_SHAPES, tones, fields]), axis=2)
        count, size = group.weights.shape
        moved = (shape @ self.by_shape.reshape(count, _SHAPES, -1)).reshape(count, 3, size)
        shift = np.concatenate([across, down], axis=1) @ self.by_lens
        if tones:
            shift = shift + (tone @ self.by_tone.reshape(count, tones, -1)).reshape(count, 2, size)
        points, pixels = group.points + np.swapaxes(moved, 1, 2), group.pixels - np.swapaxes(shift, 1, 2)
        return replace(group, points=points, pixels=pixels)


@dataclass(frozen=True, eq=False)
class SystematicErrors:
    """U unknowns in all: seven of each sheet in the order of Problem.rectangles, the tone of each camera where a View
    has one, then twice B of each camera's lens. moves: of each group. held, common (U,): the information of the
    prior, whose mean is zero, is diag(held) - common common^T. lens_rows (C, 2 B): where the unknowns of each lens
    stand; widths (C,) px of the pictures; share (2 B,)."""

    moves: tuple[Moves, ...]
    held: Floats
    common: Floats
    lens_rows: Ints
    widths: Floats
    share: Floats

    @cached_property
    def information(self) -> Floats:
        """(U, U): of the prior."""
        return np.diag(self.held) - np.outer(self.common, self.common)

    def pull(self, values: Floats) -> Floats:
        """The information, times values (U,)."""
        return self.held * values - self.common * (self.common @ values)

    def corrected(self, observations: Observations, values: Floats) -> Observations:
        """The Views with errors of these values (U,) taken off: points as they are on the sheets, pixels as they
        would be without them."""
        groups = tuple(m.corrected(g, values) for m, g in zip(self.moves, observations.groups, strict=True))
        return replace(observations, groups=groups)

    def is_like(self, other: "SystematicErrors", share: float) -> bool:
        """Whether fields of lenses are expected to be as large as there, to a share."""
        own, others = self.held[self.lens_rows], other.held[self.lens_rows]
        return bool((np.abs(own - others) <= share * others).all())

    def with_learned_fields(self, values: Floats, covariances: Floats) -> "SystematicErrors":
        """The same with priors of the lenses' fields as large as the Views make likely, sheets and other lenses
        explaining what they can of it: values (U,) of all errors, and covariances (C, 2 B, 2 B) of each lens's
        own, under the priors as they are."""
        if not self.lens_rows.size:
            return self
        # Of each field by itself, all other errors taking any value that their priors allow.
        both, held = np.linalg.inv(covariances), self.held[self.lens_rows][:, None] * np.eye(len(self.share))
        pull = (both @ values[self.lens_rows][..., None])[..., 0]
        variances = learned_variance(both - held, pull, self.share, self.widths)
        return replace(self, held=_with_fields(self.held, self.lens_rows, variances, self.share))


def _with_fields(held: Floats, rows: Ints, variances: Floats, share: Floats) -> Floats:
    """The prior's information (U,) where the fields of lenses have these mean squares (C,)."""
    whole = held.copy()
    whole[rows] = 1 / (variances[:, None] * share)
    return whole


def systematic_errors(problem: Problem, observations: Observations) -> SystematicErrors:
    """Those of a problem; observations: its Views, in the readings that are chosen."""
    rectangles = list(problem.rectangles.values())
    cameras, shapes = observations.cameras, _SHAPES * len(rectangles)
    tones = int(any(view.common is not None for view in problem.views))
    degrees = degrees_of(cameras)
    first_field, fields = shapes + tones * cameras, 2 * len(degrees)
    sizes = np.array([(camera.width, camera.height) for camera in problem.cameras], float)
    moves = []
    for group in observations.groups:
        own = problem.rectangle[group.view]
        parts = [
            _SHAPES * own[:, None] + np.arange(_SHAPES),
            (shapes + group.camera)[:, None] + np.zeros(tones, int),
            first_field + fields * group.camera[:, None] + np.arange(fields),
        ]
        count, size = group.weights.shape
        by_shape = np.zeros((count, _SHAPES, 3, size))
        for row in np.unique(own):
            by_shape[own == row] = shape_basis(rectangles[row], group.points[own == row]).transpose(0, 2, 3, 1)
        by_tone = _tone_moves(problem, group) if tones else np.zeros((count, 0, 2, size))
        by_lens = field_basis(degrees, group.pixels, sizes[group.camera])
        moves.append(Moves(np.concatenate(parts, axis=1), by_shape, by_tone, by_lens))
    held, common = np.ones(first_field + fields * cameras), np.zeros(first_field + fields * cameras)
    held[:shapes], common[:shapes] = shape_information(rectangles)
    rows = first_field + np.arange(fields * cameras).reshape(cameras, fields)
    share, usual = np.tile(shares_of(degrees), 2), usual_variance(sizes[:, 0])
    held = _with_fields(held, rows, usual, share)
    return SystematicErrors(tuple(moves), held, common, rows, sizes[:, 0], share)


def _tone_moves(problem: Problem, group: ObservationGroup) -> Floats:
    """How pixels of the Views of a group move with the tone of their cameras: (V, 1, 2, P)."""
    moves = np.zeros((len(group.view), 1, 2, group.weights.shape[1]))
    for row, view in enumerate(group.view):
        common = problem.views[view].common
        if common is not None:
            moves[row, 0, :, : len(common)] = common.T
    return moves


def sheet_rows(rectangles: Sequence[str], name: str) -> Ints:
    """Where (7,) the shape of a sheet stands among the unknowns."""
    return _SHAPES * list(rectangles).index(name) + np.arange(_SHAPES)
