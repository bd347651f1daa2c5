"""Do the 95 % intervals of `rig single` hold on real pictures? Each is calibrated alone, against a known focal.

floor: fifteen GoPros, one tag each. stereo: OpenCV's chessboards, each by itself. zhang: four corners of Zhang's five
boards, and all 256, with the principal point given and not.

    python benchmarks/single_real.py ../shared/data [WHICH ...] [--each]
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from quadrig.single.arrays import Picture
from quadrig.single.calibration import Calibration, calibrate_view
from quadrig.single.detect.image_search import detect_views
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Published focals, px: of floor the lens by itself and the authors' rig, of stereo left the file that comes with the
# pictures. Of stereo right, which has none, what calibrateCamera gives of all its pictures together.
_FLOOR, _LEFT, _RIGHT, _ZHANG = (2433.1, 2439.8), (535.9, 535.9), (542.4, 542.4), (832.5, 832.5)
_ZHANG_CENTRE = np.array([303.959, 206.585])
_ZHANG_CORNERS = [30, 3, 224, 253]
# Corners of the published text files, px: as the published answer leaves them over.
_ZHANG_SIGMA = 0.2
_INCH = 0.0254

Case = tuple[str, tuple[float, float], Calibration]


def pictures(folder: Path, pattern: str, rectangle: Rectangle) -> Iterator[tuple[str, Picture, View]]:
    """Name, picture and View of every picture in which the rectangle is found."""
    for path in sorted(folder.glob(pattern)):
        picture = np.asarray(cv2.imread(str(path)), np.uint8)
        for view in detect_views(picture, [rectangle]):
            yield path.stem, picture, view


def of_pictures(folder: Path, pattern: str, rectangle: Rectangle, truth: tuple[float, float]) -> Iterator[Case]:
    for name, picture, view in pictures(folder, pattern, rectangle):
        yield name, truth, calibrate_view(view, (picture.shape[1], picture.shape[0]))


def zhang(folder: Path, chosen: list[int] | slice, centre: np.ndarray | None) -> Iterator[Case]:
    model = np.loadtxt(folder / "Model.txt").reshape(-1, 2) * _INCH
    flat = model - (model.min(axis=0) + model.max(axis=0)) / 2
    points = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)[chosen]
    for number in range(1, 6):
        pixels = np.loadtxt(folder / f"data{number}.txt").reshape(-1, 2)[chosen]
        view = View("board", points, pixels, sigma=_ZHANG_SIGMA)
        yield f"view {number}", _ZHANG, calibrate_view(view, (640, 480), principal_point=centre)


def cases(data: Path) -> dict[str, Iterator[Case]]:
    """Each kind of picture, calibrated as it is asked for."""
    tag = Rectangle("tag", 0.15, 0.15, TagMarking("aruco_4x4_250", 0))
    board = Rectangle("board", 0.25, 0.175, ChessboardMarking(10, 7, 0.025))
    every = slice(None)
    return {
        "floor": of_pictures(data / "floor/images", "camera_*.jpg", tag, _FLOOR),
        "stereo left": of_pictures(data / "stereo", "left*.jpg", board, _LEFT),
        "stereo right": of_pictures(data / "stereo", "right*.jpg", board, _RIGHT),
        "zhang 4": zhang(data / "zhang", _ZHANG_CORNERS, None),
        "zhang 4, centre given": zhang(data / "zhang", _ZHANG_CORNERS, _ZHANG_CENTRE),
        "zhang 256": zhang(data / "zhang", every, None),
        "zhang 256, centre given": zhang(data / "zhang", every, _ZHANG_CENTRE),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("which", nargs="*")
    parser.add_argument("--each", action="store_true", help="A line for every picture.")
    asked = parser.parse_args()
    summary = Table("pictures", "truth, px", "hold", "rms of z", "largest z", "median sigma, %", "cannot tell")
    single = Table("picture", "focal, px", "95 % interval", "z", "residual, px", "reason")
    for name, found in cases(asked.data).items():
        if asked.which and not any(name.startswith(word) for word in asked.which):
            continue
        scores, sigmas, held, blind = [], [], 0, 0
        least = most = np.nan
        for picture, (least, most), one in found:
            focal, sigma = one.intrinsics.focal, one.focal_sigma
            # A truth known to a range is as far off as the nearest end of it.
            z = (focal - np.clip(focal, least, most)) / sigma
            low, high = one.focal_interval
            scores.append(z)
            sigmas.append(100 * sigma / focal)
            held += low <= most and high >= least
            blind += one.reason.name != "OK"
            single.add_row(
                f"{name}: {picture}", f"{focal:.1f} +- {sigma:.1f}", f"{low:.1f} to {high:.1f}", f"{z:.2f}",
                f"{one.rms:.3f}", one.reason.name.lower(),
            )  # fmt: skip
        truth = "-".join(f"{value:g}" for value in sorted({least, most}))
        rms, most_off = np.sqrt(np.mean(np.square(scores))), np.abs(scores).max()
        summary.add_row(
            name, truth, f"{held} of {len(scores)}", f"{rms:.2f}", f"{most_off:.2f}", f"{np.median(sigmas):.2f}",
            str(blind),
        )  # fmt: skip
    console = Console(width=120)
    if asked.each:
        console.print(single)
    console.print(summary)


if __name__ == "__main__":
    main()
