"""Views, cameras and rectangles by number: sorted by name, so that no result depends on the order they came in."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isinf

import numpy as np

from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.observations import Observations, pack
from quadrig.single.arrays import Floats, Ints
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LensModel
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Corner noise that a detector is known for, px.
USUAL_NOISE = 0.3
# The random part of a corner's error is about as large as the systematic one: more repeats than this win nothing.
_MOST_REPEATS = 2
# Four points carry a homography; fewer determine no pose of a plane.
_FEWEST_POINTS = 4
# Pixels, or metres: a hundred times what the largest picture has, and what no sheet is apart.
_FARTHEST = 1e7


@dataclass(frozen=True, eq=False)
class Node:
    """One pose to be found of a rectangle: a static one, a moving one at a frameset, or the surveyed world.

    rectangle: its name, or "" for the world that all surveyed rectangles share. frameset: -1 where static.
    """

    rectangle: str
    frameset: int = -1


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved. camera, node (V,): of each View; points: each View's readings in its node's frame."""

    cameras: tuple[CameraInput, ...]
    rectangles: dict[str, Rectangle]
    views: tuple[View, ...]
    nodes: tuple[Node, ...]
    camera: Ints
    node: Ints

    def points(self, view: int, reading: int = 0) -> Floats:
        """Points (P, 3) of a View's reading in the frame of its node: the rectangle's own, or the world's."""
        rectangle = self.rectangles[self.views[view].rectangle]
        points = self.views[view].readings[reading]
        return points if rectangle.world_from_rect is None else rectangle.world_from_rect.transform(points)

    @cached_property
    def sigmas(self) -> Floats:
        """Sigma (V,) of each View as a multiple of the median one: how sure corners are is learned from the data."""
        given = np.array([view.sigma for view in self.views])
        return np.where(np.isnan(given), 1.0, given / self.expected_noise)

    @cached_property
    def expected_noise(self) -> float:
        """Sigma (px) of a coordinate of a View of median sigma, before any fit."""
        given = np.array([view.sigma for view in self.views])
        known = given[np.isfinite(given)]
        return float(np.median(known)) if len(known) else USUAL_NOISE

    @cached_property
    def shares(self) -> Floats:
        """What each View (V,) counts for: less than one where a still camera sees a still rectangle again and again.

        Repeats average out what is random in a corner, not what is systematic (blur, print, the grid of pixels).
        """
        number = {name: index for index, name in enumerate(self.rectangles)}
        rectangle = np.array([number[view.rectangle] for view in self.views], int)
        key = (self.node * len(number) + rectangle) * len(self.cameras) + self.camera
        _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
        repeats = count[inverse]
        return np.minimum(repeats, _MOST_REPEATS) / repeats

    @property
    def models(self) -> list[LensModel]:
        """The lens model of each camera (C,): what is given, else a pinhole."""
        return [camera.first_lens.model for camera in self.cameras]

    def frame_node(self, rectangle: str) -> int | None:
        """The node whose frame is that of a static rectangle, the world's where it is surveyed; None if not seen."""
        key = _node_key(self.rectangles[rectangle], -1)
        return next((i for i, node in enumerate(self.nodes) if (node.rectangle, node.frameset) == key), None)

    def observations(self, readings: Ints | None = None) -> Observations:
        """The Views as arrays, each in the reading (V,) that is chosen."""
        chosen = np.zeros(len(self.views), int) if readings is None else readings
        return pack(
            [self.points(index, reading) for index, reading in enumerate(chosen)],
            [view.pixels for view in self.views],
            self.sigmas,
            self.shares,
            self.camera,
            self.node,
            self.models,
            len(self.nodes),
        )


def build_problem(cameras: Sequence[CameraInput], rectangles: Sequence[Rectangle], views: Sequence[View]) -> Problem:
    """Number everything. Views of too few points are ignored, and those of absurd_views.

    Raises QuadrigError where names repeat, or a View names what is not there or holds broken numbers.
    """
    for what, names in (("camera", [c.name for c in cameras]), ("rectangle", [r.name for r in rectangles])):
        repeated = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
        if repeated:
            raise QuadrigError(f"{what} {repeated[0]!r} is given twice; every {what} needs a name of its own")
    by_name = {r.name: r for r in sorted(rectangles, key=lambda r: r.name)}
    known = {c.name for c in cameras}
    _check(views, known, by_name)
    absurd = {id(view) for view in absurd_views(views)}
    usable = [v for v in views if len(v.pixels) >= _FEWEST_POINTS and id(v) not in absurd]
    return _problem(tuple(sorted(cameras, key=lambda c: c.name)), by_name, usable)


def of_cameras(problem: Problem, kept: Sequence[int]) -> Problem:
    """The part of a problem that some cameras (indices) make."""
    if len(kept) == len(problem.cameras):
        return problem
    names = {problem.cameras[i].name for i in kept}
    return build_problem(
        [problem.cameras[i] for i in kept],
        list(problem.rectangles.values()),
        [view for view in problem.views if view.camera in names],
    )


def _problem(cameras: tuple[CameraInput, ...], rectangles: dict[str, Rectangle], views: Sequence[View]) -> Problem:
    ordered = tuple(
        sorted(views, key=lambda v: (v.rectangle, v.frameset, v.camera, v.pixels.tobytes(), v.points.tobytes()))
    )
    keys = [_node_key(rectangles[v.rectangle], v.frameset) for v in ordered]
    distinct = sorted(set(keys))
    node_index = {key: index for index, key in enumerate(distinct)}
    camera_index = {c.name: index for index, c in enumerate(cameras)}
    return Problem(
        cameras,
        rectangles,
        ordered,
        tuple(Node(*key) for key in distinct),
        np.array([camera_index[v.camera] for v in ordered], int),
        np.array([node_index[key] for key in keys], int),
    )


def absurd_views(views: Sequence[View]) -> list[View]:
    """Views with a point or pixel that is in no picture and on no sheet: their squares would drown all others."""
    parts = [view.pixels.ravel() for view in views] + [r.ravel() for view in views for r in view.readings]
    if not parts or np.abs(np.concatenate(parts)).max(initial=0.0) <= _FARTHEST:
        return []
    return [v for v in views if any(np.abs(part).max(initial=0.0) > _FARTHEST for part in (v.pixels, *v.readings))]


def absurd_sentence(view: View) -> str:
    """Why a View of absurd_views is left out."""
    farthest = max((np.abs(part).max(initial=0.0) for part in (view.pixels, *view.readings)), default=0.0)
    return f"{_where(view)} is left out: a coordinate is {farthest:g}, which is in no picture and on no sheet"


def _node_key(rectangle: Rectangle, frameset: int) -> tuple[str, int]:
    if rectangle.world_from_rect is not None:
        return ("", -1)
    return (rectangle.name, frameset if rectangle.moving else -1)


def _check(views: Sequence[View], cameras: set[str], rectangles: dict[str, Rectangle]) -> None:
    """Raises QuadrigError for the first View that names what is not there or holds broken numbers."""
    for view in views:
        if view.camera not in cameras or view.rectangle not in rectangles:
            what = "camera" if view.camera not in cameras else "rectangle"
            raise QuadrigError(f"{_where(view)}: there is no {what} of that name; give it, or leave the View out")
        shape = (len(view.pixels), 3)
        if view.pixels.ndim != 2 or any(reading.shape != shape for reading in view.readings):
            raise QuadrigError(
                f"{_where(view)}: points and pixels do not match; give P points (P, 3) with P pixels (P, 2)"
            )
        if view.sigma <= 0 or isinf(view.sigma):
            raise QuadrigError(
                f"{_where(view)}: sigma is {view.sigma} px; give a positive number, or nan where it is not known"
            )
    # All at once, since there may be hundreds of thousands; one by one only where something is wrong.
    parts = [view.pixels.ravel() for view in views] + [r.ravel() for view in views for r in view.readings]
    if parts and not np.isfinite(np.concatenate(parts)).all():
        broken = next(v for v in views if not all(np.isfinite(part).all() for part in (v.pixels, *v.readings)))
        raise QuadrigError(f"{_where(broken)}: a coordinate is not a number; leave out points that were not seen")


def _where(view: View) -> str:
    return f"View of {view.rectangle!r} by {view.camera!r} in frameset {view.frameset}"
