"""Clocks that do not agree, found before anything is solved together, so that framesets can be grouped by them.

A rectangle's path, as each camera by itself sees it, has the same shape for all: the offset between two clocks is the
one at which the paths are one rigid motion apart. Views then go to the frameset that is nearest to when they were
really taken. What is left, up to half a frame, is the motion between framesets, and the joint adjustment refines the
offsets with it (adjustment/motion.py).
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.motion import LONGEST_GAP
from quadrig.rig.problem.build import Problem
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.view import View

# Clocks further apart than this (s) are not two clocks of one recording.
_FARTHEST = 0.2
# Steps (s) of the search: a hand's path differs from itself by less than its noise within the last.
_STEPS = (0.02, 0.004)
# Instants that two paths must share: fewer fix no rigid motion and offset worth having.
_FEWEST = 20
# Share of the instants, those that agree least, that do not count: poses of single Views have wild ones among them.
_WILD = 0.1
# Common shifts of all clocks that are tried, as far apart as two framesets are.
_PHASES = 16
# Fall of chi-square that shows an offset to be more than chance.
_EVIDENCE = 30.0


@dataclass(frozen=True, eq=False)
class RegroupedViews:
    """views: those of moving rectangles in the framesets nearest to them. clocks (C, 2): by how much true times are
    later than stamps, s, and line times, s a row."""

    views: tuple[View, ...]
    clocks: Floats


def regroup(problem: Problem, clocks: Floats, noise: float) -> RegroupedViews | None:
    """The Views grouped by the offsets of these clocks (C, 2); None where framesets show one instant, to the noise
    (px)."""
    times = problem.times
    tracks = _tracks(problem)
    if not tracks:
        return None
    true = times + clocks[problem.camera, 0]
    late = true - _instants(problem, true)
    if not np.nanmedian(np.abs(late) * _speeds(problem, tracks, times)) > noise:
        return None
    return RegroupedViews(_regrouped(problem, np.concatenate(list(tracks.values())), true, times), clocks)


def path_clocks(problem: Problem, positions: Floats) -> Floats:
    """Clocks (C, 2) with the offsets that the paths show: to some ms, worse where lenses are not known yet.

    positions (V, 3): of each View's rectangle in its camera, m.
    """
    times, clocks = problem.times, problem.first_clocks
    clocks[:, 0] = _offsets(_tracks(problem), times, positions, len(problem.cameras))
    return clocks


def _instants(problem: Problem, times: Floats) -> Floats:
    """Mean stamp (V,) of the frameset of each View."""
    _, frameset = np.unique([view.frameset for view in problem.views], return_inverse=True)
    stamped = np.isfinite(times)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (np.bincount(frameset, np.where(stamped, times, 0.0)) / np.bincount(frameset, stamped))[frameset]


def _regrouped(problem: Problem, moving: Ints, true: Floats, times: Floats) -> tuple[View, ...]:
    """All Views, those moving (indices) in the frameset that is nearest to when they were taken; of two Views of one
    camera and rectangle in one frameset the nearer."""
    framesets, first = np.unique([view.frameset for view in problem.views], return_index=True)
    stamped = _instants(problem, times)
    instants = stamped[first]
    order = np.argsort(instants)
    instants, framesets = instants[order], framesets[order]
    # Only differences of clocks count: the common part is free to bring Views as near to the instants as can be.
    common = np.median((true - stamped)[moving])
    phases = np.median(np.diff(instants)) * (np.arange(_PHASES) / _PHASES - 0.5)
    tried = true[moving] - common + phases[:, None]
    nearest = np.searchsorted((instants[1:] + instants[:-1]) / 2, tried)
    gaps = np.abs(tried - instants[nearest])
    best = int(np.argmin((gaps**2).sum(axis=1)))
    nearest, gap = nearest[best], gaps[best]
    views: dict[object, View] = dict(enumerate(problem.views))
    for v in moving:
        del views[v]
    for k in np.argsort(gap)[::-1]:
        view = replace(problem.views[moving[k]], frameset=int(framesets[nearest[k]]))
        views[view.camera, view.rectangle, view.frameset] = view
    return tuple(views.values())


def _speeds(problem: Problem, tracks: dict[tuple[int, str], Ints], times: Floats) -> Floats:
    """Speed (V,) of each View's middle in the image, px/s; 0 where it has no track."""
    speeds = np.zeros(len(times))
    for members in tracks.values():
        middles = np.array([problem.views[v].pixels.mean(axis=0) for v in members])
        if len(members) > 1:
            speeds[members] = np.linalg.norm(np.gradient(middles, times[members], axis=0), axis=1)
    return speeds


def _tracks(problem: Problem) -> dict[tuple[int, str], Ints]:
    """Views of each camera and moving rectangle whose stamps rise, in that order."""
    tracks: dict[tuple[int, str], list[int]] = {}
    for index, view in enumerate(problem.views):
        if problem.rectangles[view.rectangle].moving and np.isfinite(view.time):
            tracks.setdefault((int(problem.camera[index]), view.rectangle), []).append(index)
    ordered = {}
    for key, members in tracks.items():
        times = problem.times[members]
        order = np.argsort(times)
        if np.all(np.diff(times[order]) > 0):
            ordered[key] = np.array(members)[order]
    return ordered


def _offsets(tracks: dict[tuple[int, str], Ints], times: Floats, positions: Floats, cameras: int) -> Floats:
    """Offsets (C,) s, of mean zero over the cameras that share a path, from those of all pairs."""
    rows, right = [], []
    keys = list(tracks)
    for i, (a, name) in enumerate(keys):
        for b, other in keys[i + 1 :]:
            one, two = tracks[a, name], tracks.get((b, name))
            if name != other or two is None:
                continue
            found = _offset_between(times[one], positions[one], times[two], positions[two])
            if found is not None:
                offset, sigma = found
                row = np.zeros(cameras)
                row[a], row[b] = 1 / sigma, -1 / sigma
                rows.append(row)
                right.append(offset / sigma)
    return np.linalg.lstsq(np.array(rows), np.array(right), rcond=1e-9)[0] if rows else np.zeros(cameras)


def _offset_between(
    time: Floats, position: Floats, other_time: Floats, other_position: Floats
) -> tuple[float, float] | None:
    """What to add to the times of one path to have those of the other, s, with its sigma; None where unknown."""
    best = 0.0
    for step in _STEPS:
        reach = _FARTHEST if step == _STEPS[0] else _STEPS[0]
        tried = best + np.arange(-round(reach / step), round(reach / step) + 1) * step
        gaps = np.array([_apart(time + shift, position, other_time, other_position) for shift in tried])
        if not np.isfinite(gaps).any():
            return None
        best = float(tried[np.nanargmin(gaps)])
    near = best + np.array([-2, -1, 0, 1, 2]) * _STEPS[-1]
    bend, slope, least = np.polyfit(
        near - best, [_apart(time + t, position, other_time, other_position) for t in near], 2
    )
    if not (np.isfinite(bend) and bend > 0 and least > 0):
        return None
    offset = best - float(np.clip(slope / (2 * bend), -_STEPS[0], _STEPS[0]))
    agreed = _apart(time, position, other_time, other_position)
    count = len(time)
    sigma = float(np.sqrt(least / (count * bend)))
    certain = not np.isfinite(agreed) or count * (agreed - least) / least > _EVIDENCE
    return (offset if certain else 0.0), sigma


def _apart(time: Floats, position: Floats, other_time: Floats, other_position: Floats) -> float:
    """Mean squared distance (m^2) of two paths after the best affine map, which forgives lenses known roughly; nan
    where they share too little."""
    after = np.searchsorted(other_time, time)
    inside = (after > 0) & (after < len(other_time))
    inside[inside] = other_time[after[inside]] - other_time[after[inside] - 1] < LONGEST_GAP
    if np.count_nonzero(inside) < _FEWEST:
        return float("nan")
    one = position[inside]
    two = np.stack([np.interp(time[inside], other_time, axis) for axis in other_position.T], axis=1)
    two = np.concatenate([two, np.ones((len(two), 1))], axis=1)
    kept = _tame(_map_squares(one, two))
    squares = _map_squares(one[kept], two[kept])
    return float(squares[_tame(squares)].mean())


def _map_squares(one: Floats, two: Floats) -> Floats:
    """Squared distances (N,) of points (N, 3) from what the best linear map makes of others (N, 4)."""
    return np.sum((one - two @ np.linalg.lstsq(two, one, rcond=None)[0]) ** 2, axis=1)


def _tame(squares: Floats) -> Mask:
    """Which of them (N,) are not among the wild ones."""
    return squares <= np.quantile(squares, 1 - _WILD)
