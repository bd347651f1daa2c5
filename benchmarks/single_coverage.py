"""Do the 95 % intervals of single images hold the truth? Lenses are drawn from single/lens_table.py, sheets bend.

Focals, and poses of the first View (six numbers): how often the interval or region of 95 % holds the truth; beyond 3
sigmas; and the median sigma of a focal. Views are of four corners or of boards, flat on (up to 3 degrees), a little
tilted (up to 20), or up to 60 degrees.

    python benchmarks/single_coverage.py [IMAGES] [--flat-sheets]
"""

import argparse
from collections import defaultdict

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import chi2
from simulated import HEIGHT, WIDTH
from worlds import fold, radii, table_lens

from quadrig.single.arrays import Floats
from quadrig.single.calibration import Calibration, calibrate_views
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import project
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.view import View

_NOISE = 0.2
_SHEETS = {"4 corners": rectangle_corners(0.297, 0.21), "board": board_points(9, 7, 0.03)}
_TILTS = {"0-3": 3.0, "0-20": 20.0, "0-60": 60.0}
_VIEWS = (1, 2, 5)


def bent(points: Floats, rng: np.random.Generator) -> Floats:
    """A sheet whose corners lie half a millimetre over A4 off its plane, one sigma, in each of three ways."""
    half = np.linalg.norm(points, axis=-1).max()
    x, y = points[:, 0] / half, points[:, 1] / half
    lift = np.stack([x * x - y * y, 2 * x * y, x * x + y * y], axis=-1) @ rng.normal(0, 0.0028 * half, 3)
    return points + np.column_stack([np.zeros((len(points), 2)), lift])


def pose_in_view(rng: np.random.Generator, lens: Floats, points: Floats, tilt: float) -> tuple[Pose, Floats]:
    """A pose camera_from_rect at which all points are in the picture, a third to nine tenths of it large, and their
    pixels."""
    extent = np.ptp(points[:, :2], axis=0).max()
    while True:
        way, spin, angle = *rng.uniform(0, 2 * np.pi, 2), np.radians(rng.uniform(0, tilt))
        lean = rotation_from_vector(angle * np.array([np.cos(way), np.sin(way), 0.0]))
        rotation = lean @ rotation_from_vector(np.array([0.0, 0.0, spin]))
        depth = lens[0] * extent / (WIDTH * rng.uniform(0.3, 0.9))
        middle = rng.uniform(-0.4, 0.4, 2) * [WIDTH, HEIGHT] / lens[0] * depth
        pose = Pose(rotation, np.array([*middle, depth]))
        located = pose.transform(points)
        pixels = project(lens, located)
        inside = np.isfinite(pixels).all() and ((pixels > 0) & (pixels < [WIDTH - 1, HEIGHT - 1])).all()
        if inside and radii(located).max() < 0.95 * fold(lens):
            return pose, pixels


def image(
    rng: np.random.Generator, sheet: str, count: int, tilt: float, flat: bool
) -> tuple[Floats, Pose, Calibration]:
    """The true lens and first pose, and what is found."""
    lens, points = table_lens(rng), _SHEETS[sheet]
    true = points if flat else bent(points, rng)
    made = [pose_in_view(rng, lens, true, tilt) for _ in range(count)]
    views = [View("sheet", points, pixels + rng.normal(0, _NOISE, pixels.shape), sigma=_NOISE) for _, pixels in made]
    return lens, made[0][0], calibrate_views(views, (WIDTH, HEIGHT))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("images", type=int, nargs="?", default=100)
    parser.add_argument("--flat-sheets", action="store_true", help="Sheets do not bend.")
    asked = parser.parse_args()
    heads = ("focal holds", "beyond 3", "pose holds", "median sigma, %", "error / sigma", "cannot tell")
    table = Table("sheet", "Views", "tilt", *heads)
    total: dict[str, list[float]] = defaultdict(list)
    for sheet in _SHEETS:
        for count in _VIEWS:
            for name, tilt in _TILTS.items():
                rng = np.random.default_rng([7, len(sheet), count, int(tilt)])
                seen: dict[str, list[float]] = defaultdict(list)
                for _ in range(asked.images):
                    try:
                        lens, pose, found = image(rng, sheet, count, tilt, asked.flat_sheets)
                    except QuadrigError:
                        seen["lost"].append(1)
                        continue
                    low, high = found.focal_interval
                    seen["focal"].append(low <= lens[0] <= high)
                    seen["z"].append((lens[0] - found.intrinsics.focal) / found.focal_sigma)
                    seen["sigma"].append(100 * found.focal_sigma / found.intrinsics.focal)
                    step = found.camera_from_rects[0].step_to(pose)
                    distance = step @ np.linalg.solve(found.pose_covariance[0], step)
                    seen["pose"].append(distance <= chi2.ppf(0.95, 6))
                    seen["blind"].append(found.reason.name != "OK")
                for key, values in seen.items():
                    total[key] += values
                table.add_row(sheet, str(count), name, *figures(seen))
    table.add_section()
    table.add_row("all", "", "", *figures(total))
    Console(width=130).print(table)


def figures(seen: dict[str, list[float]]) -> list[str]:
    z = np.array(seen["z"])
    lost = f" ({len(seen['lost'])} lost)" if seen["lost"] else ""
    return [
        f"{100 * np.mean(seen['focal']):.1f} %{lost}",
        f"{100 * np.mean(np.abs(z) > 3):.1f} %",
        f"{100 * np.mean(seen['pose']):.1f} %",
        f"{np.median(seen['sigma']):.2f}",
        f"{np.sqrt(np.mean(z**2)):.2f}",
        f"{100 * np.mean(seen['blind']):.0f} %",
    ]


if __name__ == "__main__":
    main()
