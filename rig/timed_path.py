"""Paths of a moving rectangle's points through a camera's images: where they were between two images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from quadrig.single.rotation import Array
from quadrig.single.view import View

# A path with a hole of more than this many of its usual intervals is not bridged: nobody knows what went on there.
_LONGEST_GAP = 2.5
# Images within this many usual intervals tell the velocity: few enough that hands do not turn back within.
_WINDOW = 3.5


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A rectangle's points through one camera's images: times (F,) s by its own clock, pixels (F, P, 2) with nan,
    points (P, 3) m; interval: the usual one between images, s."""

    times: Array
    pixels: Array
    points: Array
    sigma: float
    interval: float

    def at(self, time: float) -> tuple[Array, Array]:
        """Pixels (P, 2) at a time, and how much of the images' noise they have (P,), a factor of sigma.

        Through four images where there are, else two; nan where there are not two.
        """
        after = int(np.searchsorted(self.times, time))
        if after < len(self.times) and self.times[after] == time:
            return self.pixels[after], np.ones(len(self.points))
        if after == 0 or after == len(self.times) or not self._joined(after - 1):
            return np.full_like(self.pixels[0], np.nan), np.full(len(self.points), np.nan)
        place, share = self._through(after - 1, after + 1, time)
        if after < 2 or after + 1 >= len(self.times) or not (self._joined(after - 2) and self._joined(after)):
            return place, np.full(len(place), share)
        cubic, less = self._through(after - 2, after + 2, time)
        four = np.isfinite(cubic[:, 0])
        return np.where(four[:, None], cubic, place), np.where(four, less, share)

    def velocity(self, time: float) -> Array:
        """px/s (P, 2) about a time: a line through the images near it, weighted by nearness.

        Its noise has nothing to do with that of the place then, being odd about the time where that is even: else
        clocks would be drawn to where interpolation smooths most.
        """
        apart = (self.times - time) / (_WINDOW * self.interval)
        near = np.abs(apart) < 1
        weight = (1 - apart[near] ** 2)[:, None, None] * np.isfinite(self.pixels[near][:, :, :1])
        pixels, times = np.nan_to_num(self.pixels[near]), (self.times[near] - time)[:, None, None]
        with np.errstate(all="ignore"):
            total = weight.sum(axis=0)
            middle = (weight * times).sum(axis=0) / total
            spread = (weight * (times - middle) ** 2).sum(axis=0)
            return np.where(spread > 0, (weight * (times - middle) * pixels).sum(axis=0) / spread, np.nan)

    def _joined(self, index: int) -> bool:
        return self.times[index + 1] - self.times[index] <= _LONGEST_GAP * self.interval

    def _through(self, begin: int, end: int, time: float) -> tuple[Array, float]:
        """Lagrange's polynomial through the images from begin to end, and its share of their noise."""
        weights = _lagrange(self.times[begin:end].tolist(), time)
        place = np.tensordot(np.array(weights), self.pixels[begin:end], axes=1)
        return place, float(np.sqrt(sum(weight * weight for weight in weights)))


Paths = Mapping[tuple[str, str], TimedPath]
"""By camera and rectangle."""


def paths_of(views: Sequence[View], stamps: Array, names: Sequence[str]) -> dict[tuple[str, str], TimedPath]:
    """Paths of the rectangles of these Views, each point by its place on the rectangle.

    stamps (S, C) s: of the image of each frameset and camera (in the order of names).
    """
    groups: dict[tuple[str, str], list[View]] = {}
    for view in views:
        groups.setdefault((view.camera, view.rectangle), []).append(view)
    paths = {}
    for key, members in groups.items():
        if len(members) < 2:
            continue
        column = names.index(key[0])
        times = np.array([stamps[view.frameset, column] for view in members])
        order = np.argsort(times)
        # A micrometre tells points apart and forgives rounding.
        micrometres = np.unique(np.concatenate([_micrometres(view.points) for view in members]), axis=0)
        places = {tuple(point): k for k, point in enumerate(micrometres.tolist())}
        pixels = np.full((len(members), len(places), 2), np.nan)
        for row, index in enumerate(order):
            view = members[index]
            pixels[row, [places[tuple(p)] for p in _micrometres(view.points).tolist()]] = view.pixels
        interval = float(np.median(np.diff(times[order])))
        sigma = float(np.median([view.sigma for view in members]))
        paths[key] = TimedPath(times[order], pixels, micrometres * 1e-6, sigma, interval)
    return paths


def _micrometres(points: Array) -> Array:
    return np.round(np.asarray(points) * 1e6).astype(np.int64)


def views_at(paths: Paths, times: Array, offsets: Mapping[str, float]) -> list[View]:
    """The Views that the cameras would have had at these instants (S,) s; a camera's clock lags by its offset."""
    views = []
    for (camera, rectangle), path in paths.items():
        for frameset, time in enumerate((times - offsets[camera]).tolist()):
            if path.times[0] <= time <= path.times[-1]:
                pixels, share = path.at(time)
                seen = np.isfinite(pixels[:, 0])
                if np.count_nonzero(seen) >= 4:
                    sigma = path.sigma * float(np.median(share[seen]))
                    views.append(View(rectangle, path.points[seen], pixels[seen], camera, frameset, sigma=sigma))
    return views


def _lagrange(nodes: Sequence[float], time: float) -> list[float]:
    """Weights of the values at the nodes."""
    return [prod((time - other) / (own - other) for other in nodes if other != own) for own in nodes]
