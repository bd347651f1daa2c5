"""Lenses of OpenCV's eight coefficients: what our models, which have five or a fisheye's four, leave of them.

    python -m benchmarks rational [RIGS] [--noise PX] [--lenses ../shared/data/lenses/lenses.csv]

Every lens that was published with k4 to k6 in the table, and two depth cameras' that their makers calibrated. Rigs of
three cameras side by side, a board carried to all parts of their pictures, flat and true, so that the lens alone is
tried. Beside ours OpenCV's five coefficients, and its eight, which is the very model that drew the pixels.
Lens: root mean square distance (px) of boards in other places, drawn without noise, from where the lens has them once
the pose is fitted; turn and place: of cameras beside the truth, median over rigs; held: 95 % regions of their poses.
"""

import argparse
import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from coverage import quantile
from rich.console import Console
from rich.table import Table
from simulated import HEIGHT, WIDTH, facing
from worlds import stack

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single import Rectangle, View
from quadrig.single.arrays import Floats
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_vector

_POINTS = board_points(9, 7, 0.04)
_BOARD = Rectangle("board", 0.36, 0.28, moving=True)
_FRAMESETS, _TESTS, _FEWEST = 40, 20, 12
# Where the last pixels of a picture show rays further off than this (degrees), the published numbers are no
# measurement: nobody held a board there.
_WIDEST = 75.0


@dataclass(frozen=True, eq=False)
class Rational:
    """A lens as published, of a picture WIDTH wide: matrix (3, 3), distortion (8,)."""

    name: str
    matrix: Floats
    distortion: Floats

    @property
    def widest(self) -> float:
        """Tangent of the last ray from the axis before the quotient turns back."""
        k1, k2, _, _, k3, k4, k5, k6 = self.distortion
        r = np.linspace(0, np.tan(np.radians(_WIDEST)), 4000)
        s = r * r
        seen = r * (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
        back = np.diff(seen) <= 0
        return float(r[np.argmax(back)]) if back.any() else float(r[-1])

    @property
    def reach(self) -> float:
        """Tangent of the ray of the pixel farthest from the axis."""
        corners = np.array([[x, y] for x in (0.0, WIDTH - 1) for y in (0.0, HEIGHT - 1)])
        rays = cv2.undistortPoints(corners[:, None], self.matrix, self.distortion)[:, 0]
        return float(min(np.linalg.norm(rays, axis=1).max(), self.widest))

    def project(self, points: Floats) -> Floats:
        """Pixels (P, 2) of points (P, 3) of the camera frame, nan where they are not seen."""
        pixels = _by_opencv(points, self.matrix, self.distortion)
        with np.errstate(divide="ignore", invalid="ignore"):
            ray = np.where(points[:, 2] > 0, np.hypot(points[:, 0], points[:, 1]) / points[:, 2], np.inf)
            sees = (ray < self.widest) & ((pixels > 0) & (pixels < [WIDTH - 1, HEIGHT - 1])).all(axis=1)
        return np.where(sees[:, None], pixels, np.nan)


def published(path: Path) -> list[Rational]:
    """The rational lenses of a table, and two depth cameras' colour and infrared lenses as their makers have them."""
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["model"] == "pinhole_rational"]
    found = [
        _lens(
            row["source_repo"],
            [float(row[key]) for key in ("width", "height", "fx", "fy", "cx", "cy")],
            [float(row[key] or 0) for key in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")],
        )
        for row in rows
    ]
    return [
        *found,
        _lens(
            "Azure Kinect, colour",
            [1920, 1080, 904.14, 903.52, 953.28, 555.14],
            [0.722746, -2.88559, 0.000783, -0.000143, 1.632723, 0.602199, -2.719626, 1.565053],
        ),
        _lens(
            "Azure Kinect, infrared",
            [640, 576, 503.93, 503.98, 332.06, 325.88],
            [3.130577, 2.324939, 8.1e-05, -5.1e-05, 0.130416, 3.458652, 3.350115, 0.662942],
        ),
    ]


def _lens(name: str, numbers: Sequence[float], distortion: Sequence[float]) -> Rational:
    width, height, fx, fy, cx, cy = numbers
    # As wide as our pictures, and as many rows as they have from the middle.
    scale = WIDTH / max(width, height)
    middle = scale * cy - (scale * height - HEIGHT) / 2
    matrix = np.array([[scale * fx, 0, scale * cx], [0, scale * fy, middle], [0, 0, 1.0]])
    return Rational(name, matrix, np.array(distortion))


@dataclass(frozen=True, eq=False)
class Take:
    """A rig's true poses rig_from_camera (C,), its Views, and boards in other places: of each points (P, 3), exact
    pixels (P, 2) and the true pose."""

    rig_from_camera: Pose
    views: list[View]
    tests: list[tuple[Floats, Floats, Pose]]


def take(lens: Rational, seed: int, noise: float) -> Take:
    """Three cameras side by side; boards wherever one of them has a pixel, near enough to be seen well."""
    rng = np.random.default_rng(seed)
    poses = stack(
        [
            facing(np.array([0.15 * i, 0.0, 0.0]), np.array([0.1 * i, 0.0, 1.5]) + 0.1 * rng.normal(size=3))
            for i in range(3)
        ]
    )
    views, tests = [], []
    for frameset in range(_FRAMESETS + _TESTS):
        camera = frameset % 3
        pixel = rng.uniform([0, 0], [WIDTH, HEIGHT])
        ray = cv2.undistortPoints(pixel[None, None], lens.matrix, lens.distortion)[0, 0]
        ray = ray * min(1.0, 0.9 * lens.widest / np.linalg.norm(ray))
        sight = np.array([*ray, 1.0]) / np.linalg.norm([*ray, 1.0])
        place = poses[camera].transform(sight * rng.uniform(0.35, 0.9))
        turn = rotation_from_vector(0.4 * rng.normal(size=3))
        world_from_board = Pose(turn @ facing(poses[camera].translation, place).rotation, place)
        for index in range(3):
            camera_from_board = poses[index].inverse() @ world_from_board
            pixels = lens.project(camera_from_board.transform(_POINTS))
            seen = np.isfinite(pixels[:, 0])
            if seen.sum() < _FEWEST:
                continue
            if frameset >= _FRAMESETS:
                tests.append((_POINTS[seen], pixels[seen], camera_from_board))
                continue
            noisy = pixels[seen] + noise * rng.normal(size=(int(seen.sum()), 2))
            views.append(View("board", _POINTS[seen], noisy, f"cam{index}", frameset))
    first = poses[0].inverse()
    return Take(stack([first @ poses[i] for i in range(3)]), views, tests)


@dataclass(frozen=True, eq=False)
class Answer:
    """lens, px; turn (degrees) and place (mm) of the cameras beside the first; held: of their 95 % regions."""

    lens: float
    turn: list[float]
    place: list[float]
    held: list[bool]
    model: str = ""


def ours(made: Take) -> Answer:
    """quadrig, of which nothing is told."""
    rig = calibrate([CameraInput(f"cam{i}", WIDTH, HEIGHT) for i in range(3)], [_BOARD], made.views)
    steps = [rig.camera(f"cam{i}").rig_from_camera.step_to(made.rig_from_camera[i]) for i in (1, 2)]
    held = [quantile(step, rig.pose_covariance(f"cam{i}")) <= 0.95 for i, step in enumerate(steps, 1)]
    lens = rig.cameras[0].intrinsics
    off = [_left(lens.project, *test) for test in made.tests]
    return _answer(off, steps, held, lens.model)


def opencv(made: Take, flags: int) -> Answer:
    """calibrateCamera of each camera, then stereoCalibrate of each beside the first, with these flags."""
    lenses, poses = [], []
    of = {(view.camera, view.frameset): view for view in made.views}
    for index in range(3):
        own = [view for view in made.views if view.camera == f"cam{index}"]
        points = [view.points.astype(np.float32) for view in own]
        pixels = [view.pixels.astype(np.float32) for view in own]
        _, matrix, distortion, *_ = cv2.calibrateCamera(
            points, pixels, (WIDTH, HEIGHT), np.eye(3), np.zeros(8), flags=flags
        )
        lenses.append((np.asarray(matrix, float), np.asarray(distortion, float)))
    for index in (1, 2):
        points, left, right = [], [], []
        for frameset in range(_FRAMESETS):
            one, another = (of.get((f"cam{camera}", frameset)) for camera in (0, index))
            if one is None or another is None:
                continue
            pair = (one, another)
            rows = [{tuple(point): pixel for point, pixel in zip(v.points, v.pixels, strict=True)} for v in pair]
            both = [point for point in rows[0] if point in rows[1]]
            if len(both) >= _FEWEST:
                points.append(np.array(both, np.float32))
                left.append(np.array([rows[0][point] for point in both], np.float32))
                right.append(np.array([rows[1][point] for point in both], np.float32))
        (matrix, distortion), (other, bends) = lenses[0], lenses[index]
        answer = cv2.stereoCalibrate(
            points,
            left,
            right,
            matrix,
            distortion,
            other,
            bends,
            (WIDTH, HEIGHT),
            flags=cv2.CALIB_FIX_INTRINSIC | flags,
        )
        poses.append(Pose(np.asarray(answer[5], float), np.asarray(answer[6], float)[:, 0]).inverse())
    steps = [pose.step_to(made.rig_from_camera[i]) for i, pose in enumerate(poses, 1)]
    matrix, distortion = lenses[0]

    def project(points: Floats) -> Floats:
        return _by_opencv(points, matrix, distortion)

    return _answer([_left(project, *test) for test in made.tests], steps, [])


def _by_opencv(points: Floats, matrix: Floats, distortion: Floats) -> Floats:
    return np.asarray(cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)[0], float)[:, 0]


def _left(project: Callable[[Floats], Floats], points: Floats, pixels: Floats, start: Pose) -> Floats:
    """What the best pose of a board leaves over (P, 2) px."""
    from scipy.optimize import least_squares

    def left(step: Floats) -> Floats:
        return np.nan_to_num((project(start.retract(step).transform(points)) - pixels).ravel(), nan=1e3)

    return least_squares(left, np.zeros(6), x_scale=0.01).fun.reshape(-1, 2)


def _answer(off: list[Floats], steps: list[Floats], held: list[bool], model: str = "") -> Answer:
    rms = float(np.sqrt((np.concatenate(off) ** 2).sum(axis=1).mean()))
    turns = [float(np.degrees(np.linalg.norm(step[:3]))) for step in steps]
    return Answer(rms, turns, [1000 * float(np.linalg.norm(step[3:])) for step in steps], held, model)


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("rigs", type=int, nargs="?", default=5)
    parser.add_argument("--noise", type=float, default=0.1)
    parser.add_argument("--lenses", type=Path, default=Path("../shared/data/lenses/lenses.csv"))
    given = parser.parse_args()
    table = Table("lens", "solved as", "lens, px", "turn, deg", "place, mm", "held, %")
    for lens in published(given.lenses):
        takes = [take(lens, seed, given.noise) for seed in range(given.rigs)]
        rows = {"quadrig": [ours(made) for made in takes]}
        for name, flags in (("OpenCV, 5", 0), ("OpenCV, 8", cv2.CALIB_RATIONAL_MODEL)):
            rows[name] = [opencv(made, flags) for made in takes]
        edge = f"{np.degrees(np.arctan(lens.reach)):.0f} deg"
        for name, answers in rows.items():
            held = [one for answer in answers for one in answer.held]
            table.add_row(
                f"{lens.name}, {edge}" if name == "quadrig" else "",
                ", ".join([name, *sorted({answer.model for answer in answers if answer.model})]),
                f"{np.median([answer.lens for answer in answers]):.3f}",
                f"{np.median([one for answer in answers for one in answer.turn]):.4f}",
                f"{np.median([one for answer in answers for one in answer.place]):.3f}",
                f"{100 * np.mean(held):.0f}" if held else "",
            )
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
