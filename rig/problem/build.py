"""Views, cameras and rectangles by number: sorted by name, so that no result depends on the order they came in."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isinf
from typing import Any

import numpy as np

from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.layouts import Layouts, body_of, check_bodies, layouts_of, sheets_of
from quadrig.rig.problem.observations import Joins, Observations, pack
from quadrig.single.arrays import Floats, Ints, Mask
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
# px: far below what any detector tells apart; a View all at one point drags its whole camera away.
_LEAST_EXTENT = 1e-3


@dataclass(frozen=True, eq=False)
class Node:
    """One pose to be found of a body: the only one where it stands still, one for each frameset where it moves.

    body: its name, which is the rectangle's where that is a body by itself. frameset: -1 where it stands still.
    """

    body: str
    frameset: int = -1


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved. camera, node, rectangle (V,): of each View, by number; of rectangles that are one sheet,
    that sheet's. layouts: where rectangles stand on their bodies; frame: a rectangle that is to be the frame of its
    body, if one is."""

    cameras: tuple[CameraInput, ...]
    rectangles: dict[str, Rectangle]
    views: tuple[View, ...]
    nodes: tuple[Node, ...]
    camera: Ints
    node: Ints
    rectangle: Ints
    layouts: Layouts
    frame: str | None = None

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
        key = (self.node * len(self.rectangles) + self.rectangle) * len(self.cameras) + self.camera
        _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
        repeats = count[inverse]
        return np.minimum(repeats, _MOST_REPEATS) / repeats

    @property
    def models(self) -> list[LensModel]:
        """The lens model of each camera (C,): what is given, else a pinhole."""
        return [camera.first_lens.model for camera in self.cameras]

    @property
    def first_clocks(self) -> Floats:
        """Offset, s, and line time, s a row, of each camera (C, 2): as given, else zero."""
        return np.array([(0.0, camera.line_time or 0.0) for camera in self.cameras])

    def frame_node(self, rectangle: str) -> int | None:
        """The node of the body of a rectangle that stands still: its frame is the rectangle's, or the body's where
        poses on that are given; None if not seen."""
        key = _node_key(self.rectangles[rectangle], -1)
        return next((i for i, node in enumerate(self.nodes) if (node.body, node.frameset) == key), None)

    @cached_property
    def moving(self) -> Mask:
        """Which Views (V,) are of rectangles that move."""
        return np.array([rectangle.moving for rectangle in self.rectangles.values()], bool)[self.rectangle]

    @cached_property
    def times(self) -> Floats:
        """Stamp (V,) s of each View."""
        return np.array([view.time for view in self.views])

    @cached_property
    def mean_rows(self) -> Floats:
        """The mean (V,) of the rows of the picture that each View's corners lie in."""
        return np.array([view.pixels[:, 1].mean() for view in self.views])

    @cached_property
    def joins(self) -> Joins:
        """What each View joins."""
        layout = self.layouts.number[self.rectangle]
        return Joins(self.camera, self.node, len(self.cameras), len(self.nodes), layout, self.layouts.found)

    def observations(self, readings: Ints | None = None) -> Observations:
        """The Views as arrays, each in the reading (V,) that is chosen."""
        chosen = np.zeros(len(self.views), int) if readings is None else readings
        return pack(
            [view.readings[reading] for view, reading in zip(self.views, chosen, strict=True)],
            [view.pixels for view in self.views],
            self.sigmas,
            self.shares,
            self.joins,
            self.models,
        )


def build_problem(
    cameras: Sequence[CameraInput],
    rectangles: Sequence[Rectangle],
    views: Sequence[View],
    frame: str | None = None,
) -> Problem:
    """Number everything. Views of too few points are ignored, and those of absurd_views. frame: a rectangle that is
    to be the frame of its body.

    Raises QuadrigError where names repeat, a body's rectangles do not fit each other, or a View names what is not
    there or holds broken numbers.
    """
    for what, names in (("camera", [c.name for c in cameras]), ("rectangle", [r.name for r in rectangles])):
        repeated = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
        if repeated:
            raise QuadrigError(f"{what} {repeated[0]!r} is given twice; every {what} needs a name of its own")
    by_name = {r.name: r for r in sorted(rectangles, key=lambda r: r.name)}
    check_bodies(rectangles)
    known = {c.name for c in cameras}
    _check(views, known, by_name)
    absurd = {id(view) for view in absurd_views(views)}
    usable = [v for v in views if len(v.pixels) >= _FEWEST_POINTS and id(v) not in absurd]
    return _problem(tuple(sorted(cameras, key=lambda c: c.name)), by_name, usable, frame)


def rebuilt(
    problem: Problem,
    *,
    views: Sequence[View],
    cameras: Sequence[CameraInput] | None = None,
    rectangles: Sequence[Rectangle] | None = None,
) -> Problem:
    """The problem of other Views, and of other cameras or rectangles where these are given."""
    return build_problem(
        problem.cameras if cameras is None else cameras,
        list(problem.rectangles.values()) if rectangles is None else rectangles,
        views,
        problem.frame,
    )


def with_sheet(problem: Problem, sheet: str, **changes: Any) -> Problem:
    """The problem with some fields of a sheet's rectangle changed, under all the names that it has."""
    sheet_of = sheets_of(problem.rectangles)
    rectangles = [
        replace(one, **changes) if sheet_of[name] == sheet else one for name, one in problem.rectangles.items()
    ]
    return rebuilt(problem, views=problem.views, rectangles=rectangles)


def of_cameras(problem: Problem, kept: Sequence[int]) -> Problem:
    """The part of a problem that some cameras (indices) make."""
    if len(kept) == len(problem.cameras):
        return problem
    cameras = [problem.cameras[i] for i in kept]
    names = {camera.name for camera in cameras}
    return rebuilt(problem, cameras=cameras, views=[view for view in problem.views if view.camera in names])


def _problem(
    cameras: tuple[CameraInput, ...], rectangles: dict[str, Rectangle], views: Sequence[View], frame: str | None
) -> Problem:
    ordered = tuple(
        sorted(views, key=lambda v: (v.rectangle, v.frameset, v.camera, v.pixels.tobytes(), v.points.tobytes()))
    )
    keys = [_node_key(rectangles[v.rectangle], v.frameset) for v in ordered]
    distinct = sorted(set(keys))
    node_index = {key: index for index, key in enumerate(distinct)}
    camera_index = {c.name: index for index, c in enumerate(cameras)}
    index_of, sheet_of = {name: index for index, name in enumerate(rectangles)}, sheets_of(rectangles)
    rectangle_index = {name: index_of[sheet] for name, sheet in sheet_of.items()}
    return Problem(
        cameras,
        rectangles,
        ordered,
        tuple(Node(*key) for key in distinct),
        np.array([camera_index[v.camera] for v in ordered], int),
        np.array([node_index[key] for key in keys], int),
        np.array([rectangle_index[v.rectangle] for v in ordered], int),
        layouts_of(rectangles, Counter(sheet_of[v.rectangle] for v in ordered), frame),
        frame,
    )


def absurd_views(views: Sequence[View]) -> list[View]:
    """Views with a point or pixel that is in no picture and on no sheet: their squares would drown all others; and
    those all at one point, which drag their camera away."""
    whole = [view for view in views if len(view.pixels) >= _FEWEST_POINTS]
    if not whole:
        return []
    pixels, counts = np.concatenate([view.pixels for view in whole]), [len(view.pixels) for view in whole]
    starts = np.cumsum([0, *counts[:-1]])
    extent = (np.maximum.reduceat(pixels, starts) - np.minimum.reduceat(pixels, starts)).max(axis=1)
    parts = [pixels.ravel(), *(reading.ravel() for view in whole for reading in view.readings)]
    far = np.abs(np.concatenate(parts)).max() > _FARTHEST
    return [
        view
        for view, own in zip(whole, extent, strict=True)
        if own < _LEAST_EXTENT or (far and _farthest(view) > _FARTHEST)
    ]


def _farthest(view: View) -> float:
    return max(float(np.abs(part).max()) for part in (view.pixels, *view.readings))


def absurd_sentence(view: View) -> str:
    """Why a View of absurd_views is left out."""
    farthest = _farthest(view)
    if farthest <= _FARTHEST:
        within = float(np.ptp(view.pixels, axis=0).max())
        return f"{_where(view)} is left out: its {len(view.pixels)} corners lie within {within:.1f} px"
    return f"{_where(view)} is left out: a coordinate is {farthest:g}, which is in no picture and on no sheet"


def _node_key(rectangle: Rectangle, frameset: int) -> tuple[str, int]:
    return (body_of(rectangle), frameset if rectangle.moving else -1)


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
