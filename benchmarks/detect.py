"""Detection against the plain loop over OpenCV's own detectors: time, what is found, and how far from the truth.

python benchmarks/detect.py [framesets] [jpeg quality]

Renders the demo's room (4 cameras, 1280x720, tags and a ChArUco board in a hand) and runs over the same pictures, in
one thread: OpenCV's detectors with cornerSubPix; ours on every whole picture; ours near the picture before.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import singledispatchmethod

import cv2
import numpy as np

from quadrig.io.demo.scene import demo_scene
from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.dictionaries import tag_dictionary
from quadrig.single.detect.image_search import detect_views
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Marking, Rectangle
from quadrig.single.render.capture import SRGB, Capture
from quadrig.single.render.picture import backdrop, ray_grid, render_image
from quadrig.single.render.room import Room

# Corners of one rectangle by name: its points (P, 3) m and pixels (P, 2).
Found = dict[str, tuple[Floats, Floats]]
CAPTURE = Capture(blur=0.6, noise=1.5, curve=SRGB)


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture and where every rectangle's points truly are in it."""

    camera: int
    image: Picture
    project: dict[str, Callable[[Floats], Floats]]


def shoot(framesets: int, quality: int) -> tuple[list[Shot], tuple[Rectangle, ...]]:
    """The demo's room in slow motion, compressed as cameras do."""
    scene = demo_scene(10 * framesets)
    shots = []
    for number, camera in enumerate(scene.cameras):
        grid, camera_from_world = ray_grid(camera.intrinsics), camera.world_from_camera.inverse()
        empty = backdrop(grid, camera_from_world, Room())
        rng = np.random.default_rng(number)
        for frameset in range(framesets):
            sheets = scene.sheets(frameset)
            image = render_image(grid, camera_from_world, sheets, background=empty, capture=CAPTURE, rng=rng)
            code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            grey = np.asarray(cv2.imdecode(code, cv2.IMREAD_GRAYSCALE))
            truth = {
                sheet.rectangle.name: (
                    lambda points, pose=camera_from_world @ sheet.world_from_rect, lens=camera.intrinsics: (
                        lens.project(pose.transform(points))
                    )
                )
                for sheet in sheets
            }
            shots.append(Shot(number, grey, truth))
    return shots, scene.rectangles


class PlainLoop:
    """What OpenCV's documentation does: each detector over each whole picture, corners by cornerSubPix."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._tags: dict[str, dict[int, Rectangle]] = {}
        self._boards: list[tuple[str, Floats, cv2.aruco.CharucoDetector]] = []
        self._grids: list[tuple[str, Floats, cv2.aruco.ArucoDetector]] = []
        for rectangle in rectangles:
            self._add(rectangle.marking, rectangle)
        self._detectors = {name: cv2.aruco.ArucoDetector(tag_dictionary(name), parameters) for name in self._tags}

    @singledispatchmethod
    def _add(self, marking: Marking, rectangle: Rectangle) -> None:
        """What OpenCV has no detector for is not looked for."""

    @_add.register
    def _(self, marking: TagMarking, rectangle: Rectangle) -> None:
        self._tags.setdefault(marking.dictionary, {})[marking.id] = rectangle

    @_add.register
    def _(self, marking: CharucoMarking, rectangle: Rectangle) -> None:
        board = cv2.aruco.CharucoBoard(
            (marking.columns, marking.rows),
            marking.square,
            marking.marker,
            tag_dictionary(marking.dictionary),
            np.array(sorted(marking.tags.ids)),
        )
        self._boards.append((rectangle.name, marking.points(rectangle), cv2.aruco.CharucoDetector(board)))

    @_add.register
    def _(self, marking: AprilGridMarking, rectangle: Rectangle) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        parameters.markerBorderBits = marking.border
        detector = cv2.aruco.ArucoDetector(tag_dictionary(marking.dictionary), parameters)
        # Tag by tag, in the order of ids; its corners from the top left as Eq. 4's from the bottom right.
        self._grids.append((rectangle.name, marking.points(rectangle).reshape(-1, 4, 3), detector))

    def __call__(self, grey: Picture) -> Found:
        """All that is found in one picture."""
        found: Found = {}
        for name, detector in self._detectors.items():
            quads, ids, _ = detector.detectMarkers(grey)
            for tag_id, quad in zip(np.ravel(ids) if ids is not None else [], quads, strict=True):
                if int(tag_id) in self._tags[name]:
                    rectangle = self._tags[name][int(tag_id)]
                    found[rectangle.name] = (rectangle.corners, np.asarray(quad.reshape(4, 2)[[2, 3, 0, 1]], float))
        for name, points, detector in self._boards:
            corners, ids, _, _ = detector.detectBoard(grey)
            if ids is not None and len(ids) >= 4:
                found[name] = (points[np.ravel(ids).astype(int)], np.asarray(corners.reshape(-1, 2), float))
        for name, points, detector in self._grids:
            quads, ids, _ = detector.detectMarkers(grey)
            seen = [
                (int(tag), quad) for tag, quad in zip(np.ravel(ids) if ids is not None else [], quads, strict=True)
            ]
            seen = [(tag, quad) for tag, quad in seen if tag < len(points)]
            if seen:
                pixels = np.concatenate([np.asarray(quad, float).reshape(4, 2) for _, quad in seen])
                found[name] = (np.concatenate([points[tag] for tag, _ in seen]), pixels)
        return found


def ours(rectangles: Sequence[Rectangle], follow: bool) -> Callable[[Shot], Found]:
    """Our detection: of each whole picture, or near what the picture before showed (a whole search every 25th)."""
    before: dict[int, list] = {}
    count: dict[int, int] = {}

    def run(shot: Shot) -> Found:
        number = count[shot.camera] = count.get(shot.camera, -1) + 1
        near = before.get(shot.camera) if follow and number % 25 else None
        views = detect_views(shot.image, rectangles, near=near)
        before[shot.camera] = views
        return {view.rectangle: (view.points, view.pixels) for view in views}

    return run


def run(search: Callable[[Shot], Found], shots: Sequence[Shot]) -> tuple[list[Found], float]:
    """What was found in each picture, and CPU milliseconds a picture."""
    start = time.process_time()
    found = [search(shot) for shot in shots]
    return found, (time.process_time() - start) / len(shots) * 1e3


def corners(found: Sequence[Found]) -> dict[tuple, Floats]:
    """Pixel (2,) of each corner by picture, rectangle and place on it."""
    return {
        (number, name, *np.round(point * 1e5).astype(int)): pixel
        for number, one in enumerate(found)
        for name, (points, pixels) in one.items()
        for point, pixel in zip(points, pixels, strict=True)
    }


def errors(found: Sequence[Found], shots: Sequence[Shot], kind: str, rectangles: Sequence[Rectangle]) -> Floats:
    """Distances (N,) px from the truth of all corners of one kind of marking."""
    names = {r.name for r in rectangles if r.marking.kind == kind}
    gaps = [
        np.linalg.norm(pixels - shot.project[name](points), axis=1)
        for shot, one in zip(shots, found, strict=True)
        for name, (points, pixels) in one.items()
        if name in names
    ]
    return np.concatenate(gaps) if gaps else np.zeros(0)


def main() -> None:
    """Render, run the three, print a table."""
    framesets = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    quality = int(sys.argv[2]) if len(sys.argv) > 2 else 95
    cv2.setNumThreads(1)
    shots, rectangles = shoot(framesets, quality)
    plain = PlainLoop(rectangles)
    runs = {
        "plain OpenCV": run(lambda shot: plain(shot.image), shots),
        "whole pictures": run(ours(rectangles, follow=False), shots),
        "near the last": run(ours(rectangles, follow=True), shots),
    }
    print(f"{len(shots)} pictures of 1280x720, JPEG quality {quality}")
    for name, (found, cost) in runs.items():
        print(
            f"{name:16s} {cost:7.1f} ms a picture, {runs['plain OpenCV'][1] / cost:4.1f} times the plain loop's speed"
        )
        for kind in ("tag", "charuco"):
            gap = errors(found, shots, kind, rectangles)
            over = np.count_nonzero(gap > 1)
            print(
                f"    {kind:8s} {len(gap):6d} corners, from the truth: median {np.median(gap):.3f}, "
                f"rms {np.sqrt(np.mean(gap[gap <= 1] ** 2)):.3f}, 99 % {np.quantile(gap, 0.99):.3f} px, "
                f"{over} beyond a pixel"
            )
    whole, followed, opencv = (corners(runs[k][0]) for k in ("whole pictures", "near the last", "plain OpenCV"))
    for name, reference in (("plain OpenCV's", opencv), ("the whole search's", whole)):
        common = [key for key in reference if key in followed]
        close = sum(np.linalg.norm(reference[k] - followed[k]) < 0.05 for k in common)
        print(
            f"near the last finds {100 * len(common) / len(reference):.2f} % of {name} corners, "
            f"{100 * close / max(len(common), 1):.2f} % of these within 0.05 px of them"
        )


if __name__ == "__main__":
    main()
