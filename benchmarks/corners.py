"""Corners in the real world: how far from the truth and from their own sigma, under blur, noise and tone curves.

python -m benchmarks corners [tag|charuco|chessboard|sheet|all] [grid|mixed] [Views]

grid: one line for each blur and tone curve at noise 2 and JPEG 90. mixed: blur 0.5 to 2.5 px, noise 1 to 8 grey
levels, gamma 1 to 2.6, JPEG 75 to 95, uneven light, drawn for each View. Shift: mean by which corners lie outside
of where they are (px, as their edges do). Within: corners inside their 95 % region, common error included.
"""

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.image_search import detect_views
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import FILM, LINEAR, SRGB, Capture, ToneCurve
from quadrig.single.render.picture import Sheet, ray_grid, render_image
from quadrig.single.view import View

LENS = Intrinsics(640, 480, 700.0, np.array([321.0, 238.0]), np.array([-0.15, 0.04, 5e-4, -3e-4, 0.0]))
GRID = ray_grid(LENS)
MARKED = {
    "tag": Rectangle("tag", 0.16, 0.16, TagMarking("apriltag_36h11", 5)),
    "charuco": Rectangle("board", 0.25, 0.2, CharucoMarking(5, 4, 0.05, 0.038, "aruco_4x4_50")),
    "chessboard": Rectangle("chess", 0.28, 0.24, ChessboardMarking(7, 6, 0.04)),
    "sheet": Rectangle("sheet", 0.297, 0.21, PlainMarking()),
}
CURVES = {
    "linear": LINEAR,
    "gamma 1.5": ToneCurve(1.5),
    "gamma 2.2": ToneCurve(2.2),
    "gamma 2.6": ToneCurve(2.6),
    "sRGB": SRGB,
    "film": FILM,
}
BLURS = (0.5, 1.0, 2.0)
# Half the 95 % region of a corner: chi2 of two degrees of freedom.
REGION_95 = 5.991
FAR = 8.0


@dataclass(frozen=True, eq=False)
class Error:
    """Of one View's corners: gap (P, 2) px, outward (P,) px, distance (P,) in sigmas; sigma px a coordinate."""

    gap: Floats
    outward: Floats
    distance: Floats
    sigma: float


def taken(rectangle: Rectangle, capture: Capture, rng: np.random.Generator) -> tuple[Picture, Pose]:
    """A picture of the rectangle, somewhere in view, on ground of some tone, and its pose."""
    size = np.hypot(rectangle.width, rectangle.height)
    pose = Pose.from_vectors(
        rng.uniform(-0.6, 0.6, 3) * [1, 1, 4],
        np.array([*rng.uniform(-0.12, 0.12, 2), 1]) * rng.uniform(2.2, 3.5) * size,
    )
    image = render_image(
        GRID,
        Pose.identity(),
        [Sheet(rectangle, pose)],
        background=float(rng.uniform(0.08, 0.4)),
        capture=capture,
        samples=4,
        colour=False,
        rng=rng,
    )
    return image, pose


def error(view: View, pose: Pose) -> Error:
    """Of the reading that fits best."""
    seen = [LENS.project(pose.transform(points)) for points in view.readings]
    truth = min(seen, key=lambda one: float(np.abs(view.pixels - one).max()))
    gap = view.pixels - truth
    middle = truth - truth.mean(axis=0)
    covariance = np.broadcast_to(view.sigma**2 * np.eye(2), (len(gap), 2, 2))
    common = getattr(view, "common", None)
    if common is not None:
        covariance = covariance + common[:, :, None] * common[:, None]
    distance = np.sqrt(np.einsum("pi,pij,pj->p", gap, np.linalg.inv(covariance), gap))
    # Edges moved by a pixel move the corner of a square by the root of two along the diagonal.
    outward = np.sum(gap * middle, axis=1) / np.linalg.norm(middle, axis=1) / np.sqrt(2)
    return Error(gap, outward, distance, float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / 2)))


def grid(views: int) -> Iterator[tuple[str, list[Capture]]]:
    """Each blur and tone curve with as many captures."""
    for name, curve in CURVES.items():
        for blur in BLURS:
            yield f"blur {blur} {name}", [Capture(blur=blur, noise=2.0, curve=curve, jpeg=90)] * views


def mixed(views: int) -> Iterator[tuple[str, list[Capture]]]:
    """All at once."""
    rng = np.random.default_rng(5)
    captures = [
        Capture(
            blur=rng.uniform(0.5, 2.5),
            noise=float(np.exp(rng.uniform(0, np.log(8)))),
            slope=tuple(rng.uniform(-0.3, 0.3, 2)),
            curve=ToneCurve(rng.uniform(1.0, 2.6)),
            jpeg=int(rng.integers(75, 96)),
        )
        for _ in range(views)
    ]
    yield "mixed", captures


def measure(rectangle: Rectangle, captures: Sequence[Capture]) -> tuple[list[Error], float]:
    """Errors of what is found, and CPU ms a search."""
    found, spent = [], 0.0
    for number, capture in enumerate(captures):
        image, pose = taken(rectangle, capture, np.random.default_rng(number))
        start = time.process_time()
        views = detect_views(image, [rectangle])
        spent += time.process_time() - start
        found += [error(view, pose) for view in views]
    return found, 1e3 * spent / len(captures)


def main() -> None:
    """Render, search, print a line for each kind of picture."""
    wanted = sys.argv[1] if len(sys.argv) > 1 else "all"
    mode = {"grid": grid, "mixed": mixed}[sys.argv[2] if len(sys.argv) > 2 else "grid"]
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 20
    for name, rectangle in MARKED.items():
        if wanted not in (name, "all"):
            continue
        print(f"{name:24s} found   shift     rms   sigma  within   far  worst      ms")
        for label, captures in mode(count):
            errors, cost = measure(rectangle, captures)
            if not errors:
                print(f"{label:24s}    0 %")
                continue
            gap, outward, distance = (
                np.concatenate([getattr(one, name) for one in errors]) for name in ("gap", "outward", "distance")
            )
            print(
                f"{label:24s} {100 * len(errors) / count:3.0f} % {np.mean(outward):7.3f}"
                f" {np.sqrt(np.mean(gap**2)):7.3f} {np.sqrt(np.mean([e.sigma**2 for e in errors])):7.3f}"
                f" {100 * np.mean(distance**2 < REGION_95):5.1f} % {np.count_nonzero(distance > FAR):5d}"
                f" {np.abs(gap).max():6.2f} {cost:7.1f}"
            )


if __name__ == "__main__":
    main()
