"""Poses on bodies that were measured beforehand, and stand elsewhere than all others have them."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.adjustment.pose_priors import LayoutPrior
from quadrig.rig.joint.clock_rounds import Solved
from quadrig.rig.joint.placed import layout_covariance
from quadrig.rig.problem.build import Problem, with_sheet
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.words import length
from quadrig.single.arrays import Floats
from quadrig.single.pose import step_by_left_twist

# One calibration in a thousand of surveys that hold accuses an entry, however many entries there are.
_BY_CHANCE = 1e-3
# Of a direction of which the others say nothing they cannot contradict: they add less than this to what was given.
_LEAST_SAID = 0.05


@dataclass(frozen=True)
class Misplaced:
    """A rectangle that stands elsewhere on its body than was measured, as all others have it. by, turned: how far, m
    and rad; sigmas (2,): of what was given, rad and m. rival: the entry that may be wrong instead, where the body has
    but two and nobody can tell; else empty."""

    name: str
    body: str
    by: float
    turned: float
    sigmas: tuple[float, float]
    rival: str = ""

    @property
    def sentence(self) -> str:
        """What is wrong, and what to do."""
        turn, shift = self.sigmas
        either = f" or {self.rival!r}, each as the other has it," if self.rival else ""
        return (
            f"{self.name!r}{either} of body {self.body!r} is given {length(self.by)} and "
            f"{np.degrees(self.turned):.1f} degrees from where it was seen, with sigmas of {length(shift)} and "
            f"{np.degrees(turn):.2g} degrees; where {self.name!r} stands was found instead: measure it again"
        )


def misplaced(solved: Solved) -> Misplaced | None:
    """The rectangle whose given pose all others contradict most, beyond chance; None where none is.

    What the others have, against what was given, is leave-one-out: the pose that was found is the mean of both by
    their information, so that it differs from the given one by a step of covariance prior minus posterior, whose
    chi-square is that of the two against each other (deleted residuals: Cook and Weisberg, Residuals and Influence in
    Regression, 1982, section 2.2).
    """
    problem, state = solved.problem, solved.joint.predicted
    layouts = problem.layouts
    rows = np.flatnonzero(layouts.is_given[: layouts.found])
    if not len(rows):
        return None
    steps = LayoutPrior(layouts.given[: layouts.found], layouts.information[: layouts.found]).steps(state)
    by_twist = step_by_left_twist(state.body_from_rect[: layouts.found])
    found = layout_covariance(solved.joint)
    worst, least, by = None, float(np.log(_BY_CHANCE / len(rows))), np.zeros(6)
    for row in rows:
        own = by_twist[row] @ found[row, :, row] @ by_twist[row].T
        chance, apart = _contradiction(steps[row], np.sqrt(1 / layouts.information[row]), own)
        if chance < least:
            worst, least, by = row, chance, apart
    if worst is None:
        return None
    rectangle = problem.rectangles[layouts.names[worst]]
    others = [
        name
        for name in layouts.names
        if name != rectangle.name
        and body_of(problem.rectangles[name]) == body_of(rectangle)
        and problem.rectangles[name].body_from_rect is not None
    ]
    turned, shifted = (float(np.linalg.norm(part)) for part in (by[:3], by[3:]))
    rival = others[0] if len(others) == 1 else ""
    return Misplaced(rectangle.name, body_of(rectangle), shifted, turned, rectangle.layout_sigma, rival)


def _contradiction(step: Floats, sigmas: Floats, posterior: Floats) -> tuple[float, Floats]:
    """By which chance (log) a found pose is a step (6,) from the given one, and the step (6,) from that to where the
    others have it. sigmas (6,): of what is given; posterior (6, 6): the covariance of what is found."""
    from scipy.special import chdtrc

    said, axes = np.linalg.eigh(np.eye(6) - posterior / np.outer(sigmas, sigmas))
    told = said > _LEAST_SAID
    along = axes.T[told] @ (step / sigmas)
    alone = sigmas * (axes[:, told] @ (along / said[told]))
    with np.errstate(divide="ignore"):
        chance = float(np.log(chdtrc(max(int(told.sum()), 1), (along**2 / said[told]).sum())))
    return chance, alone


def found_instead(problem: Problem, name: str) -> Problem:
    """The problem with the pose of that rectangle on its body not given."""
    return with_sheet(problem, name, body_from_rect=None, layout_sigma=(0.0, 0.0))
