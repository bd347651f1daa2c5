"""Do the 95 % regions hold the truth, in the worlds of benchmarks/worlds.py? The noise is not told.

Focals; the pose of each camera in the rig frame (six numbers); triangulated points: exact pixels of the true cameras,
triangulated by the calibrated rig, one rigid motion of all points taken out, since the frame may stand anywhere.
accuracy: the true error of those points over the working accuracy that the rig claims, median. beyond 5 sigmas: as
improbable as a Gaussian beyond five. lenses: a table of calibrations to draw from, else from single/lens_table.py.

    python benchmarks/coverage.py [RIGS [WORLD]] [--lenses ../shared/data/lenses/lenses.csv] [--write PAGE.md]
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Column, Table
from scipy.stats import chi2
from simulated import HEIGHT, WIDTH, Simulated
from worlds import WORLDS, draw, lenses_of, table_lens

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.working_accuracy import covered_points, similarity_part, triangulation_shape
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import project, project_with_derivatives
from quadrig.single.pose import Pose
from quadrig.single.rotation import nearest_rotation

# Every point of a rig shares its cameras: a few of them say what all would.
_POINTS = 12
# Added to the information of a point, as a share of it: one that ran out of sight stays where it is.
_LEAST_SHARE = 1e-10
# A sigma of a point beyond this share of its distance says that the rig cannot tell, and a Gaussian says no more.
_KNOWN = 0.1
# Fewer points than this have no shape left when they are brought into one frame.
_FEWEST = 4
# The quantile of a Gaussian five sigmas off, on both sides.
_FIVE_SIGMAS = 1 - 5.7e-7


def rig_placed(made: Simulated, rig: Rig) -> Pose:
    """world_from_rig that brings all rectangles nearest to where they are, the better known ones first: the frame of
    a reference whose distance nobody knows would look at places where nothing ever was."""
    found, true, weight = [], [], []
    for placed in rig.rectangles:
        world_from_rect, corners = made.world_from_rect[placed.name], placed.rectangle.corners
        found.append(_each(placed.rig_from_rect).transform(corners).reshape(-1, 3))
        true.append(
            _each(world_from_rect[placed.framesets] if len(placed.framesets) else world_from_rect)
            .transform(corners)
            .reshape(-1, 3)
        )
        weight.append(np.repeat(1 / np.trace(placed.covariance[..., 3:, 3:], axis1=-2, axis2=-1), len(corners)))
    of_rig, of_world, weights = np.concatenate(found), np.concatenate(true), np.concatenate(weight)
    middles = [np.average(each, axis=0, weights=weights) for each in (of_rig, of_world)]
    rotation = nearest_rotation((of_world - middles[1]).T @ (weights[:, None] * (of_rig - middles[0])))
    return Pose(rotation, middles[1] - rotation @ middles[0])


def _each(poses: Pose) -> Pose:
    """One pose or a batch, as a batch before points."""
    return Pose(poses.rotation.reshape(-1, 1, 3, 3), poses.translation.reshape(-1, 1, 3))


def seen_by(made: Simulated, rig: Rig, points: Floats) -> tuple[Floats, Mask]:
    """True pixels (C, N, 2) of points (N, 3) of the rig frame, and which camera sees which (C, N)."""
    world_from_rig = rig_placed(made, rig)
    pixels, sees = [], []
    for camera in rig.cameras:
        index = made.index(camera.name)
        true = made.world_from_camera[index].inverse() @ world_from_rig
        pixels.append(project(made.lenses[index], true.transform(points)))
        located = camera.rig_from_camera.inverse().transform(points)
        sees.append(_inside(project(camera.intrinsics.parameters, located)) & np.isfinite(pixels[-1]).all(axis=1))
    return np.array(pixels), np.array(sees)


def triangulated(made: Simulated, rig: Rig, points: Floats) -> Floats:
    """Points (N, 3) of the rig frame, as the rig sees the pixels that the true cameras would give of them. A point
    that runs away is nan or far off: it is no point the less."""
    found, (pixels, sees) = points.copy(), seen_by(made, rig, points)
    for _ in range(6):
        normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        for camera, pixel, own in zip(rig.cameras, pixels, sees, strict=True):
            camera_from_rig = camera.rig_from_camera.inverse()
            seen, _, by_point = project_with_derivatives(
                camera.intrinsics.parameters, camera_from_rig.transform(found)
            )
            slope = np.where(own[:, None, None], by_point @ camera_from_rig.rotation, 0)
            error = np.where(own[:, None], pixel - seen, 0)
            normal += np.swapaxes(slope, 1, 2) @ slope
            right += (np.swapaxes(slope, 1, 2) @ error[..., None])[..., 0]
        held = _LEAST_SHARE * (1 + np.trace(normal, axis1=1, axis2=2))
        found = found + np.linalg.solve(normal + held[:, None, None] * np.eye(3), right[..., None])[..., 0]
    return found


def _inside(pixels: Floats) -> Mask:
    with np.errstate(invalid="ignore"):
        return np.all((pixels >= 0) & (pixels <= [WIDTH - 1, HEIGHT - 1]), axis=1)


def quantile(error: Floats, covariance: Floats) -> float:
    """Chi-square's own quantile of an error: at most 0.95 where the 95 % region holds it; 1 for one that is nan."""
    if not np.isfinite(error).all():
        return 1.0
    return float(chi2.cdf(error @ np.linalg.solve(covariance, error), len(error)))


def distances(rig: Rig, points: Floats) -> Floats:
    """Of points (N, 3) from the nearest camera, m."""
    places = np.array([camera.rig_from_camera.translation for camera in rig.cameras])
    return np.linalg.norm(points - places[:, None], axis=-1).min(axis=0)


def known_points(rig: Rig, points: Floats) -> Floats:
    """Those of the points (N, 3) that the rig says it knows: to a share of their distance."""
    seen, moves = triangulation_shape(rig.cameras, points)
    if len(seen) < _FEWEST:
        return points[:0]
    sigma = np.sqrt(np.linalg.eigvalsh(moves @ rig.covariance @ np.swapaxes(moves, -1, -2))[:, -1])
    return seen[sigma < _KNOWN * distances(rig, seen)]


def quantiles(made: Simulated, rig: Rig) -> dict[str, list[float]]:
    """For each kind of figure the quantiles at which the truth lies."""
    found: dict[str, list[float]] = defaultdict(list)
    for camera in rig.cameras:
        off = camera.intrinsics.parameters - made.lenses[made.index(camera.name)]
        covariance = rig.lens_covariance(camera.name)
        found["focal"].append(quantile(off[:1], covariance[:1, :1]))
        if camera.name != rig.reference:
            step = camera.rig_from_camera.step_to(made.rig_from_camera(rig.reference, camera.name))
            found["pose"].append(quantile(step, rig.pose_covariance(camera.name)))
    points = known_points(rig, covered_points(rig.rectangles))
    points = points[seen_by(made, rig, points)[1].sum(axis=0) >= 2]
    off = triangulated(made, rig, points) - points
    # What ran away is missed, and is no part of the frame that the others are brought into.
    stayed = np.linalg.norm(off, axis=1) < distances(rig, points)
    found["point"] += [1.0] * min(_POINTS, int((~stayed).sum()))
    if stayed.sum() < _FEWEST:
        return found
    points, off = points[stayed], off[stayed]
    points, moves = triangulation_shape(rig.cameras, points)
    doubt = moves @ rig.covariance @ np.swapaxes(moves, -1, -2)
    shape = (off.ravel() - similarity_part(points, off.reshape(-1, 1))[:, 0]).reshape(-1, 3)
    for i in np.linspace(0, len(points) - 1, min(_POINTS, len(points))).round().astype(int):
        found["point"].append(quantile(shape[i], doubt[i]))
    claimed = np.linalg.eigvalsh(doubt)[:, -1].mean()
    found["accuracy"].append(float(np.sqrt((shape**2).sum(axis=1).mean() / claimed)))
    found["noise"].append(rig.noise / made.noise)
    return found


def one(task: tuple[int, str, Path | None]) -> tuple[str, dict[str, list[float]]]:
    """One rig of a world; empty where it was not calibrated with all its cameras."""
    seed, world, lenses = task
    made = draw(world, seed, lenses_of(lenses) if lenses else table_lens)
    try:
        rig = calibrate(made.inputs, made.rectangles, made.views)
    except QuadrigError:
        return world, {}
    return world, quantiles(made, rig) if len(rig.cameras) == len(made.inputs) else {}


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description="coverage of 95 %% regions in simulated worlds")
    parser.add_argument("rigs", nargs="?", type=int, default=300)
    parser.add_argument("world", nargs="?", choices=list(WORLDS))
    parser.add_argument("--lenses", type=Path)
    parser.add_argument("--write", type=Path, help="the table as Markdown, for the pages: docs/figures/coverage.md")
    asked = parser.parse_args()
    tasks = [
        (seed, world, asked.lenses) for world in WORLDS if asked.world in (None, world) for seed in range(asked.rigs)
    ]
    began = time.perf_counter()
    gathered: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    failed: dict[str, int] = defaultdict(int)
    with Pool(2) as pool:
        for world, found in pool.imap_unordered(one, tasks):
            failed[world] += not found
            for name, values in found.items():
                gathered[world][name] += values
    heads = ["world", "focals", "poses", "points", "accuracy, true / claimed", "beyond 5 sigmas", "not placed"]
    rows = [_row(world, found, failed[world]) for world, found in gathered.items()]
    title = f"share of 95 % regions that hold the truth, {asked.rigs} rigs of each world"
    table = Table(heads[0], *(Column(head, justify="right") for head in heads[1:]), title=title)
    for row in rows:
        table.add_row(*row)
    console = Console(width=120)
    console.print(table)
    aims = "aims: 92 to 98 %, accuracy 0.7 to 1.4, at most 3 of 1000 beyond 5 sigmas"
    console.print(f"{time.perf_counter() - began:.0f} s; {aims}")
    if asked.write:
        asked.write.write_text(_markdown(title, heads, rows))


def _row(world: str, found: Mapping[str, list[float]], failed: int) -> list[str]:
    shares = [_share(found[name]) for name in ("focal", "pose", "point")]
    every = np.array([q for name in ("focal", "pose", "point") for q in found[name]])
    far = f"{int((every > _FIVE_SIGMAS).sum())} of {len(every)}"
    return [world, *shares, f"{np.nanmedian(found['accuracy']):.2f}", far, str(failed)]


def _markdown(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in (heads, ["---", *["--:"] * (len(heads) - 1)], *rows)]
    return "\n".join([f"{title[0].upper()}{title[1:]}:", "", *lines, ""])


def _share(quantile: list[float]) -> str:
    return f"{100 * np.mean(np.array(quantile) < 0.95):.1f} % of {len(quantile)}"


if __name__ == "__main__":
    main()
