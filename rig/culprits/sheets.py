"""Rectangles whose size is not the one that was given, as the others have it."""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.systematic_errors import sheet_rows
from quadrig.rig.joint.clock_rounds import Solved
from quadrig.rig.problem.build import Problem, rebuilt
from quadrig.rig.problem.layouts import sheets_of
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.rig.words import WRONG_SIZE
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.posterior.sheet_shape import SHAPE_PARAMETERS
from quadrig.single.view import View

# Sizes that are off by less than this are misprints, for which sheets have a shape; what a ruler shows is more.
_LEAST = 0.015
# Sigmas from which a size is off: of dozens of sheets in a hundred rigs none is by chance.
_SURE = 5.0
# Sigmas that are left of that once all are solved with the size open.
_STANDS = 3.0
# Of the Views of a rectangle, of what others saw too, so many are rejected where its size is wrong.
_REJECTED = 0.5
# Two cameras that see one rectangle agree on how it is turned to this (rad), and on where it is to this share of the
# distance between them: what first poses are good for.
_SAME_TURN, _CLOSES = 0.3, 0.15
# Factors beyond these are no misprint but another rectangle.
_SMALLEST, _LARGEST = 0.5, 2.0
# A size that is open is held no further than this, as a share of it.
_OPEN = 0.09


@dataclass(frozen=True)
class WrongSize:
    """A rectangle's true size over the one that was given, with its sigma. rivals: the rectangles that may be wrong
    instead, where nobody can tell."""

    name: str
    factor: float
    sigma: float
    rivals: tuple[str, ...] = ()

    @property
    def stands(self) -> bool:
        """Whether it is more than a misprint, and sure."""
        return abs(self.factor - 1) > max(_LEAST, _STANDS * self.sigma)

    def sentence(self, problem: Problem) -> str:
        """What is wrong and what to check."""
        size = problem.rectangles[self.name]
        change = f"{100 * abs(self.factor - 1):.1f} ± {100 * self.sigma:.1f} %"
        larger = "larger" if self.factor > 1 else "smaller"
        if self.rivals:
            others = " and ".join(repr(name) for name in self.rivals)
            return (
                f"{self.name!r} or {others}: {WRONG_SIZE} is wrong, {self.name!r} being {change} {larger} "
                f"beside {others}; all lengths are as unsure as that: measure both"
            )
        return (
            f"{self.name!r}: {WRONG_SIZE}, {size.width:.4g} x {size.height:.4g} m, is wrong: beside the "
            f"other rectangles it is {change} {larger}, which was taken; measure it"
        )


def wrong_size(solved: Solved) -> WrongSize | None:
    """The rectangle whose size contradicts the others' most, roughly; None where none does."""
    scale, linking = _scale_errors(solved), _linking(solved.problem)
    names = list(solved.problem.rectangles)
    if linking.sum() < 2:
        return None
    off = _of_rejected(solved, linking)
    for row in np.flatnonzero(linking):
        error, sigma = scale[row]
        if _SMALLEST < 1 + error < _LARGEST and abs(error) > max(_SURE * sigma, _LEAST):
            off.setdefault(names[row], (1 + error, sigma))
    if not off:
        return None
    others = [names[row] for row in np.flatnonzero(linking) if names[row] not in off]
    if len(others) == 1 and len(off) > 1:
        # All others against one: it is that one.
        factors = [1 / factor for factor, _ in off.values()]
        return WrongSize(others[0], float(np.median(factors)), float(np.ptp(factors) / 2))
    name = max(off, key=lambda one: abs(np.log(off[one][0])) / off[one][1])
    rivals = tuple(names[row] for row in np.flatnonzero(linking) if names[row] != name)
    return WrongSize(name, *off[name], rivals if len(rivals) == 1 else ())


def _linking(problem: Problem) -> Mask:
    """The rectangles (R,) that two cameras saw at one time: they say how long the distances between cameras are."""
    names = [view.rectangle for view in problem.views]
    seen = set(zip(names, problem.node.tolist(), problem.camera.tolist(), strict=True))
    watched = Counter((rectangle, node) for rectangle, node, _ in seen)
    several = {rectangle for (rectangle, _), cameras in watched.items() if cameras > 1}
    return np.array([name in several for name in problem.rectangles], bool)


def _scale_errors(solved: Solved) -> Floats:
    """By how much (R, 2) each rectangle would be too large, were its size alone not known, and the sigma of that.

    From the end of the fit, to first order: a score test against the prior of the sheets' shapes.
    """
    joint, step = solved.joint, len(SHAPE_PARAMETERS)
    rows = np.arange(len(solved.problem.rectangles)) * step
    held, common = joint.errors.held[rows], joint.errors.common
    score = joint.errors.pull(joint.bordered.values)[rows]
    # The prior less what it makes of the covariance from both sides, of each row with itself.
    product, own = joint.bordered.error_products(common), joint.bordered.error_covariances(rows[:, None])[:, 0, 0]
    crossed = 2 * held * common[rows] * product[rows]
    seen = held - held**2 * own + crossed - common[rows] ** 2 * (1 + common @ product)
    known = seen > 0
    seen = np.where(known, seen, 1.0)
    return np.stack([np.where(known, score / seen, 0.0), np.where(known, 1 / np.sqrt(seen), np.inf)], axis=1)


def _of_rejected(solved: Solved, linking: Mask) -> dict[str, tuple[float, float]]:
    """Size over the given one, and its sigma, of the rectangles most of whose Views were rejected: the factor that
    closes the triangles of two cameras and the rectangle."""
    problem, rejected = solved.problem, solved.joint.inliers.rejected
    names = np.array([view.rectangle for view in problem.views])
    suspects = [
        name
        for name, links in zip(problem.rectangles, linking, strict=True)
        if links and rejected[names == name].mean() >= _REJECTED
    ]
    if not suspects:
        return {}
    found = {}
    rays = _Rays.of(solved)
    for name in suspects:
        factors = rays.factors(np.flatnonzero(names[rays.view] == name))
        factor = float(np.median(factors)) if len(factors) else 1.0
        if _SMALLEST < factor < _LARGEST and abs(factor - 1) > _LEAST:
            found[name] = factor, max(float(np.std(factors)) / np.sqrt(len(factors)), _LEAST / _SURE)
    return found


@dataclass(frozen=True, eq=False)
class _Rays:
    """Of each candidate (K,) its View, node and camera; how its rectangle is turned (K, 3, 3), and where it is from
    the camera (K, 3) m, both along the axes of the rig; at (K, 3): the camera."""

    view: Ints
    node: Ints
    camera: Ints
    turn: Floats
    ray: Floats
    at: Floats

    @staticmethod
    def of(solved: Solved) -> "_Rays":
        problem = solved.problem
        candidates = first_cameras(_with_found_lenses(solved)).candidates
        view = candidates.view
        rig_from_camera = solved.joint.adjustment.state.camera_from_rig.inverse()[problem.camera[view]]
        turn = rig_from_camera.rotation @ candidates.camera_from_rect.rotation
        ray = np.einsum("kij,kj->ki", rig_from_camera.rotation, candidates.camera_from_rect.translation)
        return _Rays(view, problem.node[view], problem.camera[view], turn, ray, rig_from_camera.translation)

    def factors(self, rows: Ints) -> Floats:
        """What rays are to be multiplied by so that those of two cameras to one rectangle meet: of all two Views that
        some rows have of it in one place."""
        left, right = (rows[side] for side in np.triu_indices(len(rows), 1))
        met = (self.node[left] == self.node[right]) & (self.camera[left] != self.camera[right])
        left, right = left[met], right[met]
        trace = np.einsum("kij,kij->k", self.turn[left], self.turn[right])
        # Of twins and readings those that are turned alike.
        order = np.argsort(-trace, kind="stable")
        pairs = np.stack([self.view[left[order]], self.view[right[order]]])
        likeliest = order[np.unique(pairs, axis=1, return_index=True)[1]] if len(order) else order
        left, right, trace = left[likeliest], right[likeliest], trace[likeliest]
        across, between = self.ray[left] - self.ray[right], self.at[right] - self.at[left]
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = (across * between).sum(axis=1) / (across**2).sum(axis=1)
            miss = np.linalg.norm(factor[:, None] * across - between, axis=1) / np.linalg.norm(between, axis=1)
            alike = (np.arccos(np.clip((trace - 1) / 2, -1, 1)) < _SAME_TURN) & (miss < _CLOSES)
        return factor[alike]


def _with_found_lenses(solved: Solved) -> Problem:
    """The problem with the lenses that were found: distances from one picture are as right as its focal."""
    cameras = []
    for row, camera in enumerate(solved.problem.cameras):
        found = camera.first_lens.with_parameters(solved.joint.adjustment.state.lens[row])
        cameras.append(replace(camera, intrinsics=found, fixed=True))
    return replace(solved.problem, cameras=tuple(cameras))


def measured(wrong: WrongSize, solved: Solved) -> WrongSize:
    """The same as the fit of the resized problem has it."""
    names = list(solved.problem.rectangles)
    if wrong.rivals:
        return wrong
    bordered, row = solved.joint.bordered, sheet_rows(names, wrong.name)[0]
    sigma = float(np.sqrt(bordered.error_covariances(np.array([[row]]))[0, 0, 0]))
    return replace(wrong, factor=wrong.factor * float(1 + bordered.values[row]), sigma=sigma)


def resized(problem: Problem, wrong: WrongSize) -> Problem:
    """The problem with that rectangle of the size that its Views show, which is then left open; where its one rival
    may be the wrong one, that one's too."""
    loose, sheet_of = min(abs(wrong.factor - 1), _OPEN), sheets_of(problem.rectangles)

    def of_size(view: View) -> View:
        if sheet_of[view.rectangle] != wrong.name:
            return view
        scaled = tuple(wrong.factor * points for points in view.alternatives)
        return replace(view, points=wrong.factor * view.points, alternatives=scaled)

    rectangles = [
        replace(r, scale_sigma=max(r.scale_sigma, loose)) if r.name in (wrong.name, *wrong.rivals) else r
        for r in problem.rectangles.values()
    ]
    return rebuilt(problem, rectangles=rectangles, views=[of_size(view) for view in problem.views])
