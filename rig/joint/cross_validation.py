"""What the fit would have said of framesets that it had not seen, and whether parts of the recording agree.

Each pose of a body belongs to one fold: framesets a fifth of the recording at a time, so that what a fold shares
with its neighbours in time (a clock, a light, a bent board) is held out with it. The reduced normal equations are
sums over the bodies' poses, so holding a fold out is a subtraction: one Newton step gives cameras, layouts, shapes of
sheets and what lenses leave over without it, and the fold's own poses of bodies are fitted to them. Equal to a fit
without the fold to second order (shown by a test against real refits).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.banded import BandBordered, System
from quadrig.rig.adjustment.bordered import Border, DenseBordered, Matrix, bordered_matrix, dense, error_rows
from quadrig.rig.adjustment.levenberg_marquardt import view_steps
from quadrig.rig.adjustment.normal_equations import linearise, normal_equations
from quadrig.rig.adjustment.schur import Reduced, block_matrix, eliminate, node_steps, solve_for
from quadrig.rig.adjustment.tables import tables_of
from quadrig.rig.blas_threads import one_thread
from quadrig.rig.joint.folds import folds_of
from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.single.arrays import Floats, Ints, Mask

# What noise alone explains has the weight of so many numbers, in the figure of all cameras and in each camera's own:
# folds of a recording are few, and what they disagree on shows in some ten of a camera's numbers.
_TRUSTED = 20.0

# Of an error that all its Views take with them, rounding leaves less than this share of what they said.
_SEEN = 1e-9
# So many numbers of what folds make of a covariance are held at a time: a quarter of a gigabyte.
_AT_ONCE = 2**24


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


@one_thread
def cross_validate(problem: Problem, joint: Joint) -> CrossValidation:
    """Hold each fold out in turn."""
    of_node = folds_of(problem)
    fold = of_node[joint.observations.node]
    count = int(fold.max(initial=-1)) + 1
    if count < 2:
        return CrossValidation(np.full(len(fold), np.nan), np.ones(joint.observations.cameras))
    adjustment, free_nodes = joint.adjustment, joint.free.node
    # A copy of every unit for each fold: then each copy's sums are those of its fold alone, all in one pass.
    tables = tables_of(joint.observations, fold)
    weighing = adjustment.linearised.gram if adjustment.eliminated is None else adjustment.eliminated.gram
    free = np.tile(joint.reduced.free, (count, 1))
    normal = normal_equations(joint.observations, tables, adjustment.state, weighing)
    own = eliminate(normal, tables, free, free_nodes)
    border = joint.bordered.border
    without = [_without(joint, own, number, fold == number) for number in range(count)]
    steps, errors = np.concatenate([each[0] for each in without]), np.array([each[1] for each in without])
    at_prediction = own
    if adjustment.eliminated is not None:
        # What the rig says of the pictures has no View straying: another state, with derivatives of its own.
        gram = linearise(joint.observations, joint.predicted, adjustment.columns, joint.noise).gram
        normal = normal_equations(joint.observations, tables, joint.predicted, gram)
    if adjustment.eliminated is not None or not free_nodes.all():
        at_prediction = eliminate(normal, tables, free, np.ones_like(free_nodes))
    followed = (border.passed @ errors.T).reshape(-1, 6, count)[np.arange(len(of_node)), :, of_node]
    poses = node_steps(normal, tables, at_prediction, steps) - followed
    step = view_steps(joint.observations, tables, joint.predicted, steps, poses, len(adjustment.columns))
    squares = _squares(joint, step, errors[fold])
    squares = squares * (joint.noise * problem.sigmas) ** 2 / problem.shares
    used = np.zeros(len(fold))
    for group in joint.observations.groups:
        used[group.view] = group.weights.sum(axis=1)
    share = np.bincount(fold, used, count) / max(used.sum(), np.finfo(float).tiny)
    return CrossValidation(squares, _dispersion(joint, own, share))


def _squares(joint: Joint, step: Floats, errors: Floats) -> Floats:
    """Sum of the weighted squared residuals (V,) after steps (V, K + 6) and of the errors (V, U), to first order;
    the line time follows the lens, where things move."""
    squares, columns = np.zeros(len(step)), joint.adjustment.columns
    for one in error_rows(joint.errors, joint.observations, joint.predicted, columns):
        part, rows, moves = one.part, one.rows, one.moves
        count, fields = len(part.view), moves.by_lens.shape[1]
        own = np.take_along_axis(errors[part.view], moves.index, axis=1)
        few, halves = np.split(own, [own.shape[1] - 2 * fields], axis=1)
        taken = np.concatenate([step[part.view], -np.ones((count, 1)), few], axis=1)[:, None]
        left = (taken @ np.swapaxes(rows.reshape(len(rows), count, -1), 0, 1)).reshape(count, 2, -1)
        left = left + halves.reshape(count, 2, fields) @ moves.by_lens
        squares[part.view] = ((left**2).sum(axis=1) * part.weights).sum(axis=1)
    return squares / joint.noise**2


def _without(joint: Joint, own: Reduced, number: int, out: Mask) -> tuple[Floats, Floats]:
    """Steps (E, M) of the units and (U,) of the systematic errors when the Views `out` (V,) of a fold are taken
    from the fit; nan if they must stay.

    own: the folds' reduced systems, of which this fold's is taken off the whole.
    """
    whole, units = joint.reduced, len(joint.reduced.free)
    chosen = own.left // units == number
    key = own.left[chosen] % units * units + own.right[chosen] % units
    blocks = whole.blocks.copy()
    blocks[np.searchsorted(whole.left * units + whole.right, key)] -= own.blocks[chosen]
    gradient = whole.gradient - own.gradient[number * units : (number + 1) * units]
    free = whole.free
    if not joint.free.node[joint.observations.node[out]].all():
        # The body that held the rig frame is held out itself: a camera holds the frame in its stead.
        lens = len(joint.adjustment.columns)
        free = free.copy()
        free[0, lens : lens + 6] = False
    border = joint.bordered.border
    ties, information = border.all_units - border.units[number], border.all_information - border.information[number]
    # A sheet that only this fold shows keeps its shape, as it keeps its pose: both are its own.
    shown = information.diagonal() > _SEEN * border.all_information.diagonal()
    pull = border.gradient.sum(axis=0) - border.gradient[number] - joint.errors.pull(joint.values)
    reduced = replace(whole, blocks=blocks, gradient=np.where(free, gradient, 0.0), free=free)
    try:
        if isinstance(joint.bordered, BandBordered):
            system = System.of(reduced, ties, information, joint.errors, shown)
            solved = system.solution(system.factorised(), np.concatenate([reduced.gradient.ravel(), pull]))
            return solved[: free.size].reshape(free.shape), solved[free.size :]
        return _dense_step(reduced, dense(ties), dense(information) + joint.errors.information, pull, shown)
    except np.linalg.LinAlgError:
        return np.full_like(gradient, np.nan), np.full_like(pull, np.nan)


def _dense_step(
    reduced: Reduced, ties: Floats, information: Floats, pull: Floats, shown: Mask
) -> tuple[Floats, Floats]:
    """Steps (E, M) of the units and (U,) of the errors that are shown (U,), of their system."""
    ties, errors = ties[:, shown] * reduced.free.ravel()[:, None], np.zeros_like(pull)
    solved = solve_for(reduced, np.column_stack([reduced.gradient.ravel(), ties]))
    left = information[np.ix_(shown, shown)] - ties.T @ solved[:, 1:]
    errors[shown] = np.linalg.solve(left, pull[shown] - ties.T @ solved[:, 0])
    return (solved[:, 0] - solved[:, 1:] @ errors[shown]).reshape(reduced.free.shape), errors


def _dispersion(joint: Joint, own: Reduced, share: Floats) -> Floats:
    """Variance (C,) between the folds of each camera's lens, as a multiple of what noise alone makes it.

    With C the covariance, D and g a fold's information and gradient at the optimum: the fold moves the cameras by C
    g, of which the covariance is C (D - D C D) C (the infinitesimal jackknife; Jaeckel 1972). Of g its share (F,), by
    weight, of the sum of all folds' gradients is taken off, which is what priors pull: folds that agree with one
    another against a prior disagree on nothing. All cameras together are measured by g' C g, each by its lens in
    units of the lens's own covariance: neither depends on where the rig frame stands. A ratio counts for as many
    numbers as it was measured on, times the folds.
    """
    cameras, lens, count = joint.observations.cameras, len(joint.adjustment.columns), len(share)
    units, size = joint.reduced.free.shape
    free = joint.reduced.free[:cameras, :lens]
    both = free[:, :, None] & free[:, None, :]
    columns = joint.adjustment.columns
    own_lens = joint.bordered.lens_covariances(joint.adjustment)[:, columns[:, None], columns]
    inverse = np.where(both, np.linalg.inv(np.where(both, own_lens, np.eye(lens))), 0.0)
    parts = [_of_fold(own, joint.bordered.border, number, units) for number in range(count)]
    gradients = np.array([gradient for gradient, _ in parts])
    gradients -= share[:, None] * gradients.sum(axis=0)
    informations = [information for _, information in parts]
    if isinstance(joint.bordered, BandBordered):
        steps = joint.bordered.system.solution(joint.bordered.band, gradients.T).T
        expected, traces = _expected_in_band(joint.bordered, informations, share, inverse)
    else:
        assert isinstance(joint.bordered, DenseBordered)
        covariance = joint.bordered.joint_covariance
        steps = gradients @ covariance
        expected, traces = _expected(covariance, informations, share, inverse, size)
    of_each = steps[:, : units * size].reshape(count, units, size)[:, :cameras, None, :lens]
    seen = (of_each @ inverse @ np.swapaxes(of_each, 2, 3)).sum(axis=(0, 2, 3))
    together, by_chance = float((gradients * steps).sum()), float(traces.sum())
    if not by_chance > 0:
        return np.ones(cameras)
    # Cameras of one rig are not independent: together they count for as much as one of them.
    weight, pooled_weight = count * np.maximum(expected, 0.0), count * by_chance / cameras
    pooled = (_TRUSTED + pooled_weight * together / by_chance) / (_TRUSTED + pooled_weight)
    return (_TRUSTED * pooled + count * seen) / (_TRUSTED + weight)


def _expected(
    covariance: Floats, folds: "Sequence[Matrix]", share: Floats, inverse: Floats, size: int
) -> tuple[Floats, Floats]:
    """What noise alone makes of the lenses (C,), each in units of its own covariance, of which inverse is the inverse
    (C, K, K), and of all numbers (F,). size: M."""
    cameras, lens = inverse.shape[:2]
    expected, traces = np.zeros(cameras), np.zeros(len(folds))
    for rows, chosen in _runs(len(covariance), cameras, size, len(folds)):
        passed = _Passed.of(covariance, folds, rows)
        traces += passed.traces(share)
        columns = (size * chosen[:, None] + np.arange(lens)).ravel()
        expected[chosen] = passed.of_lenses(covariance, columns, share, inverse[chosen])
    return expected, traces


def _expected_in_band(
    bordered: BandBordered, folds: "Sequence[Matrix]", share: Floats, inverse: Floats
) -> tuple[Floats, Floats]:
    """The same: what information D makes of the covariance C, C D C and C D C D C, is how the inverse of the system
    changes with e where e D is added to it."""
    from scipy.sparse import csr_array

    rows = np.arange(len(inverse))[:, None] * bordered.unit_steps.shape[1] + np.arange(inverse.shape[1])
    row, column = rows[:, :, None], rows[:, None]
    sparse = [csr_array(fold) for fold in folds]
    every = sum(sparse[1:], sparse[0])
    of_every = bordered.system.factorised(every, 2)
    whole = of_every.elements(row, column, 1)
    expected, traces = np.zeros(len(inverse)), np.zeros(len(folds))
    for number, (fold, own) in enumerate(zip(sparse, share, strict=True)):
        change = fold - own * every
        series = bordered.system.factorised(change, 3)
        # C D C of the fold itself: the series has it of the fold less its share of all.
        first = -series.elements(row, column, 1) - own * whole
        spread = (1 - 2 * own) * first - own**2 * whole - series.elements(row, column, 2)
        expected += (spread * inverse).sum(axis=(1, 2))
        first = (1 - 2 * own) * bordered.band.times(fold) + own**2 * bordered.band.times(every)
        traces[number] = first + series.times(change, 1)
    return expected, traces


def _runs(total: int, cameras: int, size: int, folds: int) -> Iterator[tuple[slice, Ints]]:
    """All numbers (total,) in runs so short that what the folds make of them takes less memory than their covariance,
    and the cameras, of so many numbers each, that are in a run."""
    step = max(_AT_ONCE // (folds * total * size), 1)
    for first in range(0, cameras, step):
        last = min(first + step, cameras)
        yield slice(size * first, size * last), np.arange(first, last)
    for first in range(size * cameras, total, size * step):
        yield slice(first, min(first + size * step, total)), np.zeros(0, int)


@dataclass(frozen=True, eq=False)
class _Passed:
    """What the information D of each of F folds makes of the covariance C (T, T) of all numbers, for a run (a slice)
    of R of them: columns F times (T, R) of D C, and rows F times (R, T) of it."""

    run: slice
    columns: list[Floats]
    rows: list[Floats]

    @staticmethod
    def of(covariance: Floats, folds: "Sequence[Matrix]", run: slice) -> "_Passed":
        """folds: the information (T, T) of each."""
        return _Passed(run, [each @ covariance[:, run] for each in folds], [each[run] @ covariance for each in folds])

    def traces(self, share: Floats) -> Floats:
        """This run's part of the trace (F,) of (D - D C D) C, of each fold less its share (F,) of the sum of all."""
        every, every_rows = sum(self.columns[1:], self.columns[0]), sum(self.rows[1:], self.rows[0])
        whole = float(np.trace(every[self.run]) - (every * every_rows.T).sum())
        found = np.zeros(len(share))
        for number, (columns, rows) in enumerate(zip(self.columns, self.rows, strict=True)):
            trace = float(np.trace(columns[self.run]))
            # The fold's own, less twice what it has in common with the sum of all, and that sum's own part.
            crossed = trace - float((columns * every_rows.T).sum())
            own = trace - float((columns * rows.T).sum())
            found[number] = own + share[number] ** 2 * whole - 2 * share[number] * crossed
        return found

    def of_lenses(self, covariance: Floats, chosen: Ints, share: Floats, inverse: Floats) -> Floats:
        """The same of each lens by itself (C',): C (D - D C D) C in units of its own covariance, of which inverse is
        the inverse (C', K, K). chosen (C' K,): the lenses' numbers, all in this run."""
        if not len(chosen):
            return np.zeros(len(inverse))
        across, shape = covariance[chosen], inverse.shape[:2]
        columns = [each[:, chosen - self.run.start] for each in self.columns]
        left = [across - each.T @ covariance for each in columns]

        def of_lens(before: Floats, after: Floats) -> Floats:
            """Each camera's own block (C', K, K) of a product."""
            return before.reshape(*shape, len(after)) @ after.reshape(len(after), *shape).swapaxes(0, 1)

        of_every = sum(left[1:], left[0]) - (len(left) - 1) * across
        whole, total = of_lens(of_every, sum(columns[1:], columns[0])), np.zeros(shape[0])
        for of_fold, column, own in zip(left, columns, share, strict=True):
            spread = of_lens(of_fold - 2 * own * of_every, column) + own**2 * whole
            total += (spread * inverse).sum(axis=(1, 2))
        return total


def _of_fold(own: Reduced, border: Border, number: int, units: int) -> "tuple[Floats, Matrix]":
    """The gradient (E M + U,) of a fold, of units and systematic errors, and its information (E M + U, E M + U)."""
    chosen, rows = own.left // units == number, slice(number * units, (number + 1) * units)
    of_units = block_matrix(own.blocks[chosen], own.left[chosen] % units, own.right[chosen] % units, units)
    ties, among = border.units[number], border.information[number]
    gradient = np.where(own.free[rows], own.gradient[rows], 0.0).ravel()
    return np.concatenate([gradient, border.gradient[number]]), bordered_matrix(of_units, ties, among)
