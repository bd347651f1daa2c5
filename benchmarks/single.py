"""How fast the single-image solver is, beside cv2.calibrateCamera in the same run, on one core.

OMP_NUM_THREADS=1 python benchmarks/single.py [--batch 100000]
"""

import argparse
import time

import cv2
import numpy as np

from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.closed_form import closed_form
from quadrig.single.solve.maximum_likelihood import solve_rectangles

WIDTH, HEIGHT, IMAGE, NOISE = 0.297, 0.210, (1920, 1080), 0.3
CENTRE = np.array([959.5, 539.5])
REPEATS = 7


def views(count: int, rng: np.random.Generator) -> np.ndarray:
    """Corners (count, 4, 2) of an A4 sheet in view, tilted by 15 to 65 degrees, with noise."""
    found = np.empty((0, 4, 2))
    while len(found) < count:
        focal = rng.uniform(900, 2500, (count, 1, 1))
        tilt, way, spin = np.radians(rng.uniform(15, 65, count)), *rng.uniform(0, 2 * np.pi, (2, count))
        zero = np.zeros(count)
        rotation = rotation_from_angles(zero, zero, way) @ rotation_from_angles(tilt, zero, spin - way)
        depth = focal[:, 0, 0] * WIDTH / rng.uniform(250, 800, count)
        aside = rng.uniform(-0.5, 0.5, (2, count)) * np.array(IMAGE)[:, None] / focal[:, 0, 0] * depth
        located = Pose(rotation, np.stack([*aside, depth], axis=-1))[:, None].transform(
            rectangle_corners(WIDTH, HEIGHT)
        )
        corners = focal * located[..., :2] / located[..., 2:] + CENTRE
        inside = ((corners > 0) & (corners < IMAGE)).all(axis=(1, 2)) & (located[..., 2] > 0).all(axis=1)
        found = np.concatenate([found, corners[inside]])
    return found[:count] + rng.normal(0, NOISE, (count, 4, 2))


def best_time(function, repeats: int = REPEATS) -> float:
    """Seconds of the quickest of several calls: the machine's other work only ever adds."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return min(times)


def opencv(corners: np.ndarray) -> None:
    """Focal and pose of each view by cv2.calibrateCamera, which is started at the middle of the true focals."""
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    )  # fmt: skip
    points = [rectangle_corners(WIDTH, HEIGHT).astype(np.float32)]
    for view in corners.astype(np.float32):
        guess = np.array([[1700.0, 0, CENTRE[0]], [0, 1700.0, CENTRE[1]], [0, 0, 1]])
        cv2.calibrateCamera(points, [view], IMAGE, guess, None, flags=flags)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--batch", type=int, default=100_000)
    batch = parser.parse_args().batch
    cv2.setNumThreads(1)
    corners = views(batch, np.random.default_rng(0))
    some, few = corners[: min(20_000, batch)], corners[: min(150, batch)]
    closed = batch / best_time(lambda: closed_form(corners, WIDTH, HEIGHT, CENTRE))
    single = best_time(lambda: closed_form(corners[0], WIDTH, HEIGHT, CENTRE), 200)
    refined = len(some) / best_time(lambda: solve_rectangles(some, WIDTH, HEIGHT, CENTRE, sigma=NOISE), 3)
    peer = len(few) / best_time(lambda: opencv(few), 3)
    print(f"closed form          {closed / 1e6:8.2f} million rectangles/s in batches of {batch}")
    print(f"closed form, single  {1e3 * single:8.3f} ms a call")
    print(f"maximum likelihood   {refined:8.0f} rectangles/s, with covariance")
    print(f"cv2.calibrateCamera  {peer:8.0f} rectangles/s (f and pose, as above)")
    print(f"ratio                {refined / peer:8.1f}")


if __name__ == "__main__":
    main()
