"""Do the 95 % regions hold the truth? Random rigs such as users make, the noise not given.

Poses (six numbers of each camera in the rig frame), lenses (all estimated parameters of each camera, and the focal
alone), and triangulated points: exact pixels of the true cameras, triangulated by the calibrated rig, and one rigid
motion of all points taken out, since the frame may stand anywhere.

    python benchmarks/coverage.py [RIGS]
"""

import sys
import time
from collections import defaultdict
from multiprocessing import Pool

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import chi2
from simulated import HEIGHT, WIDTH, Simulated, simulate, usual_scene

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.working_accuracy import covered_points, rigid_part, triangulation_shape
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS, project, project_with_derivatives

KINDS = {
    "board, lenses bent": {"board": True, "distortion": True},
    "board, lenses straight": {"board": True, "distortion": False},
    "four corners only": {"board": False, "distortion": False},
}
# Every point of a rig shares its cameras: a few of them say what all would.
_POINTS = 12


def triangulated(made: Simulated, rig: Rig, points: Floats) -> Floats:
    """Points (N, 3) of the rig frame, as the rig sees the pixels that the true cameras would give of them."""
    world_from_rig = made.world_from_camera[made.index(rig.reference)]
    found = points.copy()
    for _ in range(6):
        normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        for camera in rig.cameras:
            index = made.index(camera.name)
            true = made.world_from_camera[index].inverse() @ world_from_rig
            pixels = project(made.lenses[index], true.transform(points))
            camera_from_rig = camera.rig_from_camera.inverse()
            sees = _inside(project(camera.intrinsics.parameters, camera_from_rig.transform(points)))
            sees &= np.isfinite(pixels).all(axis=1)
            seen, _, by_point = project_with_derivatives(
                camera.intrinsics.parameters, camera_from_rig.transform(found)
            )
            slope = np.where(sees[:, None, None], by_point @ camera_from_rig.rotation, 0)
            error = np.where(sees[:, None], pixels - seen, 0)
            normal += np.swapaxes(slope, 1, 2) @ slope
            right += (np.swapaxes(slope, 1, 2) @ error[..., None])[..., 0]
        found = found + np.linalg.solve(normal, right[..., None])[..., 0]
    return found


def _inside(pixels: Floats) -> Mask:
    with np.errstate(invalid="ignore"):
        return np.all((pixels >= 0) & (pixels <= [WIDTH - 1, HEIGHT - 1]), axis=1)


def _holds(error: Floats, covariance: Floats) -> float:
    """Chi-square's own quantile of an error: at most 0.95 where the 95 % region holds it."""
    return float(chi2.cdf(error @ np.linalg.solve(covariance, error), len(error)))


def quantiles(made: Simulated, rig: Rig) -> dict[str, list[float]]:
    """For each kind of figure the quantiles at which the truth lies."""
    found: dict[str, list[float]] = defaultdict(list)
    for camera in rig.cameras:
        off = camera.intrinsics.parameters - made.lenses[made.index(camera.name)]
        free = [LENS_PARAMETERS.index(name) for name in camera.free_lens]
        covariance = rig.lens_covariance(camera.name)
        found["lens"].append(_holds(off[free], covariance[np.ix_(free, free)]))
        found["focal"].append(_holds(off[:1], covariance[:1, :1]))
        if camera.name != rig.reference:
            step = camera.rig_from_camera.step_to(made.rig_from_camera(rig.reference, camera.name))
            found["pose"].append(_holds(step, rig.pose_covariance(camera.name)))
    points, moves = triangulation_shape(rig.cameras, covered_points(rig.rectangles))
    doubt = moves @ rig.covariance @ np.swapaxes(moves, -1, -2)
    off = triangulated(made, rig, points) - points
    shape = (off.ravel() - rigid_part(points, off.reshape(-1, 1))[:, 0]).reshape(-1, 3)
    for i in np.linspace(0, len(points) - 1, min(_POINTS, len(points))).round().astype(int):
        found["point"].append(_holds(shape[i], doubt[i]))
    found["accuracy"].append(float(np.sqrt((shape**2).sum(axis=1).mean()) / rig.working_accuracy))
    found["noise"].append(rig.noise / made.noise)
    return found


def one(task: tuple[int, str]) -> tuple[str, dict[str, list[float]]]:
    """One rig of a kind; empty where it was not calibrated with all its cameras."""
    seed, kind = task
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    made = simulate(rng, usual_scene(rng, **KINDS[kind]))
    try:
        rig = calibrate(made.inputs, made.rectangles, made.views)
    except QuadrigError:
        return kind, {}
    return kind, quantiles(made, rig) if len(rig.cameras) == len(made.inputs) else {}


def main() -> None:
    """Print one table."""
    rigs = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    tasks = [(seed, kind) for kind in KINDS for seed in range(rigs // len(KINDS))]
    began = time.perf_counter()
    gathered: dict[str, dict[str, list[float]]] = {kind: defaultdict(list) for kind in [*KINDS, "all"]}
    failed: dict[str, int] = defaultdict(int)
    with Pool(2) as pool:
        for kind, found in pool.imap_unordered(one, tasks):
            for into in (kind, "all"):
                failed[into] += not found
                for name, values in found.items():
                    gathered[into][name] += values
    table = Table(title=f"share of 95 % regions that hold the truth, {len(tasks)} rigs")
    for column in ("rigs", "poses", "lenses", "focals", "points", "point error / claimed", "noise / true", "failed"):
        table.add_column(column, justify="right")
    for kind, found in gathered.items():
        shares = [_share(found[name]) for name in ("pose", "lens", "focal", "point")]
        ratio, noise = np.median(found["accuracy"]), np.median(found["noise"])
        table.add_row(kind, *shares, f"{ratio:.2f}", f"{noise:.3f}", str(failed[kind]))
    console = Console(width=120)
    console.print(table)
    console.print(f"{time.perf_counter() - began:.0f} s; aims: 93 to 97 % of poses, lenses and points")


def _share(quantile: list[float]) -> str:
    return f"{100 * np.mean(np.array(quantile) < 0.95):.1f} % of {len(quantile)}"


if __name__ == "__main__":
    main()
