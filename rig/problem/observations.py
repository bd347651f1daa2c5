"""Views laid out as arrays: which camera, which pose of a body, which points, padded so that no loop is needed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.lens import LensModel

_MODELS: tuple[LensModel, ...] = ("pinhole", "fisheye")


@dataclass(frozen=True, eq=False)
class ObservationGroup:
    """Views of one lens model, padded to one number of points.

    view, camera, node (V,): index of the View, of its camera, of the body's pose (node) it sees.
    points (V, P, 3) metres in the rectangle's frame, pixels (V, P, 2), weights (V, P): share/sigma^2 of a pixel
    coordinate, zero where padded or rejected. share (V,): what a View counts for, below one where it repeats others.
    """

    view: Ints
    camera: Ints
    node: Ints
    points: Floats
    pixels: Floats
    weights: Floats
    share: Floats
    model: LensModel

    def part(self, rows: slice | Ints) -> "ObservationGroup":
        """Some of the Views."""
        return replace(
            self,
            view=self.view[rows],
            camera=self.camera[rows],
            node=self.node[rows],
            points=self.points[rows],
            pixels=self.pixels[rows],
            weights=self.weights[rows],
            share=self.share[rows],
        )

    def parts(self, points: int) -> Iterator["ObservationGroup"]:
        """All Views in turn, so many at a time that they hold about that many points."""
        step = max(points // max(self.weights.shape[1], 1), 1)
        if step >= len(self.view):
            yield self
            return
        for begin in range(0, len(self.view), step):
            yield self.part(slice(begin, begin + step))

    @property
    def certainty(self) -> Floats:
        """1/sigma^2 (V, P) of a pixel coordinate by itself, zero where padded or rejected."""
        return self.weights / self.share[:, None]


@dataclass(frozen=True, eq=False)
class Joins:
    """What each View joins: camera, node (V,), of which there are `cameras` and `nodes`; layout (V,): the row of its
    rectangle's pose on its body, -1 where it is the body's frame; the first `found` of these rows are to be found."""

    camera: Ints
    node: Ints
    cameras: int
    nodes: int
    layout: Ints
    found: int = 0

    @staticmethod
    def alone(camera: Ints, cameras: int) -> "Joins":
        """Every View with a pose of its own."""
        views = len(camera)
        return Joins(camera, np.arange(views), cameras, views, np.full(views, -1))


@dataclass(frozen=True, eq=False)
class Observations:
    """All Views of a problem, and what each of them joins."""

    groups: tuple[ObservationGroup, ...]
    joins: Joins

    @property
    def camera(self) -> Ints:
        """The camera (V,) of each View."""
        return self.joins.camera

    @property
    def node(self) -> Ints:
        """The body's pose (V,) that each View sees."""
        return self.joins.node

    @property
    def cameras(self) -> int:
        """How many cameras there are."""
        return self.joins.cameras

    @property
    def nodes(self) -> int:
        """How many poses of bodies there are."""
        return self.joins.nodes

    def with_weights(self, weights: Sequence[Floats]) -> "Observations":
        """The same Views with other weights, one array a group."""
        groups = tuple(replace(g, weights=w) for g, w in zip(self.groups, weights, strict=True))
        return replace(self, groups=groups)

    def only(self, chosen: Mask) -> "Observations":
        """The chosen (V,) Views alone; all keep their numbers."""
        groups = []
        for g in self.groups:
            rows = np.flatnonzero(chosen[g.view])
            if len(rows):
                groups.append(g.part(rows))
        return replace(self, groups=tuple(groups))

    def thinned(self, most: int) -> "Observations":
        """The same Views with at most so many points each, spread evenly over the order of those they have."""
        groups = tuple(g if g.weights.shape[1] <= most else _thinned(g, most) for g in self.groups)
        return replace(self, groups=groups)

    @property
    def count(self) -> float:
        """How many points carry weight, each as much as its View counts for."""
        return float(sum(((g.weights > 0).sum(axis=1) * g.share).sum() for g in self.groups))


def _thinned(group: ObservationGroup, most: int) -> ObservationGroup:
    count = (group.weights > 0).sum(axis=1)[:, None]
    spread = (np.linspace(0, 1, most) * (count - 1)).astype(int)
    # A View of fewer points has them all in front, and padding of no weight after them.
    chosen = np.where(count > most, spread, np.arange(most))
    row = np.arange(len(chosen))[:, None]
    return replace(
        group,
        points=group.points[row, chosen],
        pixels=group.pixels[row, chosen],
        weights=group.weights[row, chosen],
    )


def pack(
    points: Sequence[Floats],
    pixels: Sequence[Floats],
    sigma: Floats,
    share: Floats,
    joins: Joins,
    models: Sequence[LensModel],
) -> Observations:
    """Lay Views out in groups of like size. One entry a View, but `models`: one a camera."""
    camera, node = joins.camera, joins.node
    sizes = np.array([len(p) for p in pixels], int)
    padded = 4 * np.ceil(sizes / 4).astype(int) if len(sizes) and sizes.max() <= 16 else _padded_sizes(sizes)
    every_point = np.concatenate([np.zeros((0, 3)), *points])
    every_pixel = np.concatenate([np.zeros((0, 2)), *pixels])
    starts = np.cumsum(sizes) - sizes
    is_fisheye = np.array([models[c] == "fisheye" for c in camera], bool)
    groups = []
    for model in _MODELS:
        of_model = is_fisheye == (model == "fisheye")
        for size in np.unique(padded[of_model]):
            view = np.flatnonzero(of_model & (padded == size))
            # In rows of one camera and one sheet, which share unknowns.
            view = view[np.lexsort((node[view], joins.layout[view], camera[view]))]
            real = np.arange(size) < sizes[view][:, None]
            # Padding repeats the first point: one that surely projects; its weight of zero takes it out.
            index = starts[view][:, None] + np.arange(size) * real
            weights = np.where(real, (share[view] / sigma[view] ** 2)[:, None], 0.0)
            located = every_point[index], every_pixel[index], weights
            groups.append(ObservationGroup(view, camera[view], node[view], *located, share[view], model))
    return Observations(tuple(groups), joins)


def _padded_sizes(sizes: Ints) -> Ints:
    """Each size up to the next of 4, 8, 16, 32, ... but never past the largest, so that full boards waste nothing."""
    powers = 4 * 2 ** np.ceil(np.log2(np.maximum(sizes, 4) / 4)).astype(int)
    return np.minimum(powers, sizes.max())
