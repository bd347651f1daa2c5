"""Corners in the real world: how far from the truth and from their own sigma, under blur, noise and tone curves.

python -m benchmarks corners [tag|charuco|aprilgrid|chessboard|sheet|all] [grid|mixed|tables] [Views]

grid: one line for each blur and tone curve at noise 2 and JPEG 90. mixed: blur 0.5 to 2.5 px, noise 1 to 8 grey
levels, gamma 1 to 2.6, JPEG 75 to 95, uneven light, drawn for each View. Shift: mean by which corners lie outside
of where they are (px, as their edges do). Within: corners inside their 95 % region, common error included. OpenCV:
its CharucoDetector and ArucoDetector, of an AprilGrid any tag.
tables: blank sheets alone, on what they lie on: wood, cloth, light tables, in shadows, rounded, under a hand, beside
glare and lit patches of the table; of all kinds, or of those named last.
"""

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.image_search import detect_views
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.circle_grid import CircleGridMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import FILM, LINEAR, SRGB, Capture, Glare, Hand, Shadow, ToneCurve
from quadrig.single.render.ground import fabric, wood
from quadrig.single.render.picture import Sheet, ray_grid, render_image
from quadrig.single.view import View

LENS = Intrinsics(640, 480, 700.0, np.array([321.0, 238.0]), np.array([-0.15, 0.04, 5e-4, -3e-4, 0.0]))
GRID = ray_grid(LENS)
MARKED = {
    "tag": Rectangle("tag", 0.16, 0.16, TagMarking("apriltag_36h11", 5)),
    "charuco": Rectangle("board", 0.25, 0.2, CharucoMarking(5, 4, 0.05, 0.038, "aruco_4x4_50")),
    "aprilgrid": Rectangle("april", 0.2835, 0.216, AprilGridMarking(4, 3, 0.054, 0.25)),
    "circles": Rectangle("dots", 0.28, 0.24, CircleGridMarking(7, 6, 0.04)),
    "asymmetric": Rectangle("dots", 0.24, 0.27, CircleGridMarking(4, 9, 0.03, asymmetric=True)),
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
# px by which a corner of a sheet is no corner of it.
WRONG = 3.0


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


def table(kind: str, rng: np.random.Generator, pose: Pose) -> Sheet:
    """What the sheet lies on, 1.5 m wide, of its own pose."""
    large = Rectangle("table", 1.5, 1.2, PlainMarking())
    textures = {"wood": wood, "cloth": fabric}
    texture = textures[kind]((2000, 1600), rng) if kind in textures else None
    tone = float(rng.uniform(0.3, 0.8)) if texture is not None else float(rng.uniform(0.08, 0.4))
    return Sheet(large, pose, texture=texture, margin=0.0, tone=tone)


def on_a_table(kind: str, number: int) -> tuple[Picture, Pose]:
    """A picture of the sheet on a table, by the kind of table, light or cover."""
    rng = np.random.default_rng(number)
    rectangle = MARKED["sheet"]
    turn, place = rng.uniform(-0.6, 0.6, 3) * [1, 1, 4], np.array([*rng.uniform(-0.08, 0.08, 2), 1])
    pose = Pose.from_vectors(turn, place * rng.uniform(0.75, 1.1))
    corners = LENS.project(pose.transform(rectangle.corners))
    ground, light = table(kind, rng, pose), {}
    if kind == "light table":
        # So much light less than the sheet's as makes 12 to 20 grey levels at sRGB.
        ground = Sheet(ground.rectangle, pose, margin=0.0, tone=float(0.82 - rng.uniform(0.095, 0.15)))
    if kind in ("sharp shadow", "soft shadow"):
        across = rng.uniform(0, np.pi)
        along, out = np.array([np.cos(across), np.sin(across)]), np.array([-np.sin(across), np.cos(across)])
        middle = corners.mean(axis=0) + rng.uniform(-40, 40, 2)
        ends = [
            middle - 900 * along,
            middle + 900 * along,
            middle + 900 * (along + out),
            middle + 900 * (out - along),
        ]
        softness = 0.5 if kind == "sharp shadow" else float(rng.uniform(8, 25))
        light["shadows"] = (Shadow(tuple((float(x), float(y)) for x, y in ends), rng.uniform(0.25, 0.6), softness),)
    if kind.startswith("hand"):
        side = int(rng.integers(4))
        share = rng.uniform(0.3, 0.7) if kind == "hand on edge" else 0.0
        spot = corners[side] + share * (corners[(side + 1) % 4] - corners[side])
        inward = corners.mean(axis=0) - spot
        angle = float(np.arctan2(inward[1], inward[0]) + rng.uniform(-0.4, 0.4))
        tip = spot + rng.uniform(10, 35) * np.array([np.cos(angle), np.sin(angle)])
        light["hands"] = (Hand((float(tip[0]), float(tip[1])), angle, float(rng.uniform(14, 22))),)
    below = []
    if kind == "glare":
        spot, size = around(corners, rng), rng.uniform(15, 60, 2)
        turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        outline = spot + size * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ends = tuple((float(x), float(y)) for x, y in outline)
        light["glares"] = (Glare(ends, float(rng.uniform(0.2, 1.2)), float(rng.uniform(1, 10))),)
    if kind == "lit table":
        # A lamp or window shines back from the table, not from the paper on it.
        width, height = rng.uniform(0.04, 0.15, 2)
        side = int(rng.integers(4))
        ends = rectangle.corners[[side, (side + 1) % 4]]
        middle = Pose.from_vectors(np.zeros(3), ends[0] + rng.uniform(-0.15, 0.5) * (ends[1] - ends[0]))
        lit = Rectangle("lit", float(width), float(height), PlainMarking())
        tone, round_by = float(rng.uniform(0.6, 1.3)), float(rng.choice([0.0, 0.02]))
        below = [Sheet(lit, pose @ middle, tone=tone, margin=0.0, rounding=round_by)]
    capture = Capture(blur=rng.uniform(0.5, 1.2), noise=rng.uniform(1, 3), curve=SRGB, jpeg=90, **light)
    rounding = {"rounded 3 mm": 0.003, "rounded 8 mm": 0.008}.get(kind, 0.0)
    sheets = [ground, *below, Sheet(rectangle, pose, rounding=rounding)]
    image = render_image(GRID, Pose.identity(), sheets, capture=capture, samples=4, colour=False, rng=rng)
    return image, pose


def around(corners: Floats, rng: np.random.Generator) -> Floats:
    """A place (2,) px near the outline of corners (4, 2)."""
    side = int(rng.integers(4))
    spot = corners[side] + rng.uniform(-0.1, 0.5) * (corners[(side + 1) % 4] - corners[side])
    return spot + rng.uniform(-5, 40) * (spot - corners.mean(axis=0)) / np.linalg.norm(spot - corners.mean(axis=0))


TABLES = (
    *("plain", "wood", "cloth", "light table", "sharp shadow", "soft shadow"),
    *("rounded 3 mm", "rounded 8 mm", "hand on edge", "hand on corner", "glare", "lit table"),
)


def measure_tables(views: int, kinds: Sequence[str]) -> None:
    """One line for each kind of table. Wrong: a corner more than 3 px off."""
    print(f"{'sheet on a table':24s} found   wrong   shift     rms   sigma  within   far  worst")
    for kind in kinds:
        errors = []
        for number in range(views):
            image, pose = on_a_table(kind, number)
            errors += [error(view, pose) for view in detect_views(image, [MARKED["sheet"]])]
        right = [one for one in errors if np.abs(one.gap).max() < WRONG]
        print(
            f"{kind:24s} {100 * len(errors) / views:3.0f} % {len(errors) - len(right):7d}  {summary(right or errors)}"
        )


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


def measure(rectangle: Rectangle, captures: Sequence[Capture]) -> tuple[list[Error], float, int]:
    """Errors of what is found, CPU ms a search, and in how many of the pictures OpenCV's detector finds it."""
    # Here, since tests take the pictures from this file by its path.
    from detect import PlainLoop

    found, spent, theirs, plain = [], 0.0, 0, PlainLoop([rectangle])
    for number, capture in enumerate(captures):
        image, pose = taken(rectangle, capture, np.random.default_rng(number))
        start = time.process_time()
        views = detect_views(image, [rectangle])
        spent += time.process_time() - start
        theirs += bool(plain(image))
        found += [error(view, pose) for view in views]
    return found, 1e3 * spent / len(captures), theirs


def summary(errors: Sequence[Error]) -> str:
    """Shift, rms, sigma, share within, how many far and the worst, of Views' errors."""
    if not errors:
        return ""
    gap, outward, distance = (
        np.concatenate([getattr(one, name) for one in errors]) for name in ("gap", "outward", "distance")
    )
    return (
        f"{np.mean(outward):6.3f} {np.sqrt(np.mean(gap**2)):7.3f}"
        f" {np.sqrt(np.mean([one.sigma**2 for one in errors])):7.3f}"
        f" {100 * np.mean(distance**2 < REGION_95):5.1f} % {np.count_nonzero(distance > FAR):5d}"
        f" {np.abs(gap).max():6.2f}"
    )


def main() -> None:
    """Render, search, print a line for each kind of picture."""
    if sys.argv[2:3] == ["tables"]:
        measure_tables(int(sys.argv[3]) if len(sys.argv) > 3 else 20, sys.argv[4:] or TABLES)
        return
    wanted = sys.argv[1] if len(sys.argv) > 1 else "all"
    mode = {"grid": grid, "mixed": mixed}[sys.argv[2] if len(sys.argv) > 2 else "grid"]
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 20
    for name, rectangle in MARKED.items():
        if wanted not in (name, "all"):
            continue
        print(f"{name:24s} found   shift     rms   sigma  within   far  worst      ms  OpenCV finds")
        for label, captures in mode(count):
            errors, cost, theirs = measure(rectangle, captures)
            line = f"{label:24s} {100 * len(errors) / count:3.0f} % {summary(errors)} {cost:7.1f}"
            print(line if rectangle.marking.tags is None else f"{line} {100 * theirs / count:3.0f} %")


if __name__ == "__main__":
    main()
