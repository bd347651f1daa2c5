"""Cameras that the others contradict: which it is, and why."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.culprits.pictures import in_a_quarter
from quadrig.rig.doubt.misfit import misses
from quadrig.rig.problem.build import Problem, of_cameras, rebuilt
from quadrig.rig.problem.connectivity import components, seen_by_others
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.view import View

Solve = Callable[[Problem], list[Rig]]

# Share of a camera's Views, of those that others saw too, which are rejected where it is the camera that is wrong.
_CONTRADICTS = 0.5
# Where no camera has so many rejected, and two Views at least are, no culprit is looked for.
_SUSPECT = 0.15
# Cameras that are tried as the culprit, those of most rejected Views.
_TRIED = 6
# Of the Views of a camera that agrees so many may be rejected.
_STRAY = 0.2


@dataclass(frozen=True, eq=False)
class _Agreement:
    """How the Views of a problem agree with a rig: which (V,) are rejected, or of cameras that were not placed though
    another saw the same rectangle at one time: of others of its body nobody may know how they stand to that."""

    problem: Problem
    rejected: Mask

    @staticmethod
    def of(problem: Problem, rig: Rig) -> "_Agreement":
        placed = {camera.name for camera in rig.cameras}
        # Views that clocks grouped anew are others, of the same pixels.
        out = {id(fit.view.pixels) for fit in rig.fits if fit.rejected}
        lost = np.array([view.camera not in placed for view in problem.views], bool)
        rejected = np.array([id(view.pixels) in out for view in problem.views], bool)
        return _Agreement(problem, rejected | (lost & seen_by_others(problem)))

    def shared(self, without: int = -1) -> Mask:
        """The Views (V,) of what two cameras saw at least, one camera (an index) not counted."""
        camera, node = self.problem.camera, self.problem.node
        watchers = np.zeros((len(self.problem.nodes), len(self.problem.cameras)), bool)
        watchers[node[camera != without], camera[camera != without]] = True
        return (watchers.sum(axis=1)[node] > 1) & (camera != without)

    def shares(self) -> tuple[Floats, Ints]:
        """Of each camera (C,), of its shared Views: the share that is rejected, and their number."""
        cameras, shared = len(self.problem.cameras), self.shared()
        count = np.bincount(self.problem.camera[shared], minlength=cameras)
        wrong = np.bincount(self.problem.camera[shared & self.rejected], minlength=cameras)
        return wrong / np.maximum(count, 1), count


def contradicting_camera(problem: Problem, rig: Rig, solve: Solve) -> str | None:
    """The camera that, left out, leaves the others in agreement; None where they agree already or nobody can say."""
    group = next(g for g in components(problem) if rig.cameras[0].name in {problem.cameras[i].name for i in g})
    before = _Agreement.of(problem, rig)
    share, count = before.shares()
    fits = not misses(rig)
    suspects = [i for i in sorted(group, key=lambda i: -share[i]) if share[i] >= _SUSPECT or not fits]
    if len(group) < 3 or not suspects or (fits and (share * count)[group].sum() < 2):
        return None
    wrong = [i for i in suspects if count[i] > 1 and share[i] >= _CONTRADICTS]
    if fits and len(wrong) == len(suspects) == 1:
        return problem.cameras[wrong[0]].name
    trials = []
    for camera in suspects[:_TRIED]:
        left = of_cameras(problem, [i for i in range(len(problem.cameras)) if i != camera])
        rigs = solve(left)
        if rigs:
            others = before.shared(without=camera)
            after = _Agreement.of(left, rigs[0])
            mended = int((before.rejected & others).sum() - (after.rejected & after.shared()).sum())
            agree = not fits and len(rigs[0].cameras) > 1 and not misses(rigs[0])
            trials.append((agree, mended, camera in wrong, float(share[camera]), -camera))
    agree, mended, is_wrong, _, camera = max(trials, default=(False, 0, False, 0.0, 0))
    return problem.cameras[-camera].name if agree or mended > 0 or is_wrong else None


def why_it_contradicts(problem: Problem, name: str, alone: Rig | None, solve: Solve) -> str:
    """What is wrong with a camera that the others contradict, in words; empty where no more is known than that."""
    if alone is not None and misses(alone):
        return (
            f"{name}: its corners are no pictures of the rectangles that they name, whatever its lens (by itself it "
            f"misses them by {alone.rms:.0f} px): check the markings' names and sizes, and how its corners were found"
        )
    size = in_a_quarter(problem, name)
    if size:
        return size
    for read_so in (False, True):
        flipped = _flipped(problem, name, read_so)
        rigs = solve(flipped)
        if rigs and name in {camera.name for camera in rigs[0].cameras} and len(rigs[0].cameras) > 2:
            share, _ = _Agreement.of(flipped, rigs[0]).shares()
            if share[[camera.name for camera in flipped.cameras].index(name)] < _STRAY:
                return (
                    f"{name}: its pictures are mirrored; turned over, left to right, they agree with the other "
                    "cameras': switch its mirroring off and record again"
                )
    return ""


def _flipped(problem: Problem, name: str, read_so: bool) -> Problem:
    """With the pictures of a camera turned over; read_so: their corners were named as if the pictures were right."""
    width = next(camera.width for camera in problem.cameras if camera.name == name)
    side = np.array([-1.0, 1.0, 1.0]) if read_so else np.ones(3)

    def turned(view: View) -> View:
        return replace(
            view,
            pixels=view.pixels * [-1, 1] + [width - 1, 0],
            points=view.points * side,
            alternatives=tuple(points * side for points in view.alternatives),
        )

    views = [turned(view) if view.camera == name else view for view in problem.views]
    return rebuilt(problem, views=views)
