"""A lens of 180 degrees: its model from fifteen pictures of a body with five boards, held against seven others.

    python -m benchmarks wide [../shared/data/cube]

Nothing is given of the lens but what each line says; auto finds the model. Test: root mean square distance (px) of
every corner of the test pictures, outliers too, from where the lens model has it once the pose is fitted, of each
board by itself, or of the body with its boards where another tool's file has them; with flat boards, or bent as the
training pictures show them. The bound: the same fisheye fitted to the test pictures themselves leaves 0.262 px with
flat boards.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.camera_input import CameraInput, LensChoice
from quadrig.rig.result import PlacedRectangle, Rig
from quadrig.single.arrays import Floats
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.pose import Pose
from quadrig.single.posterior.sheet_shape import shape_basis
from quadrig.single.rectangle import Rectangle
from quadrig.single.solve.planar_pose import planar_poses
from quadrig.single.view import View

SIZE = (1280, 800)
# As the published corners' residuals under any good model are, px.
_SIGMA = 0.2


def boards(folder: Path) -> dict[int, tuple[Floats, Floats]]:
    """Of each board its points (P, 3), m, about their middle, and that middle (3,)."""
    points: dict[int, list[list[float]]] = {}
    number = -1
    for line in (folder / "boards.dsc").read_text().splitlines():
        fields = line.split(",")
        if len(fields) == 4:
            number = int(fields[0])
            points[number] = []
        elif len(fields) == 6:
            points[number].append([float(fields[3]) / 100, float(fields[4]) / 100, 0.0])
    middles = {board: (np.min(rows, axis=0) + np.max(rows, axis=0)) / 2 for board, rows in points.items()}
    return {board: (np.array(rows) - middles[board], middles[board]) for board, rows in points.items()}


def body_from_boards(folder: Path) -> dict[int, Pose]:
    """Where another tool has the boards, in the frames of their files."""
    rows = [line.split() for line in (folder / "boards.tp").read_text().splitlines() if line[:1] != "#"]
    numbers = [at for at, row in enumerate(rows) if len(row) == 1 and len(rows[at + 1 : at + 2][0]) == 4]
    found = {int(rows[at][0]): np.array(rows[at + 1 : at + 4], float) for at in numbers}
    return {board: Pose(matrix[:, :3], matrix[:, 3] / 1000) for board, matrix in found.items()}


def views(folder: Path, part: str) -> list[View]:
    """Every board of every picture of a part, a frameset for each."""
    found = []
    points = boards(folder)
    for frameset, file in enumerate(sorted((folder / part).glob("*.orpc"))):
        lines = [line.split(",") for line in file.read_text().splitlines() if line.count(",") == 4]
        rows = np.array(lines, float)
        for board in np.unique(rows[:, 0]).astype(int):
            own = rows[rows[:, 0] == board]
            located = points[board][0][own[:, 1].astype(int)]
            found.append(View(f"board{board}", located, own[:, 3:5], "wide", frameset, sigma=_SIGMA))
    return found


def solved(folder: Path, lens: LensChoice) -> Rig:
    """The lens from the training pictures."""
    sheets = [
        Rectangle(f"board{board}", 0.6, 0.6, ChessboardMarking(15, 15, 0.04), moving=True) for board in boards(folder)
    ]
    return calibrate([CameraInput("wide", *SIZE, lens=lens)], sheets, views(folder, "train"))


def residuals(lens: Intrinsics, points: Floats, pixels: Floats, start: Pose) -> Floats:
    """What the best pose leaves over, px (P, 2)."""
    from scipy.optimize import least_squares

    def left(step: Floats) -> Floats:
        return np.nan_to_num((lens.project(start.retract(step).transform(points)) - pixels).ravel(), nan=1e3)

    return least_squares(left, np.zeros(6), x_scale=0.01).fun.reshape(-1, 2)


def left_over(folder: Path, lens: Intrinsics, sheets: Sequence[PlacedRectangle] = ()) -> tuple[float, float]:
    """Of boards by themselves, and of the body, px. sheets: with the shapes that boards have, instead of flat."""
    middles, placed = boards(folder), body_from_boards(folder)
    own, pictures = [], {}
    for view in views(folder, "test"):
        for sheet in sheets:
            if sheet.name == view.rectangle and sheet.shape is not None:
                moved = (sheet.shape.values[:, None] * shape_basis(sheet.rectangle, view.points)).sum(axis=1)
                view = replace(view, points=view.points + moved)
        start = planar_poses(view.points, lens.unproject(view.pixels)).camera_from_rect[0]
        own.append(residuals(lens, view.points, view.pixels, start))
        pictures.setdefault(view.frameset, []).append((view, start))
    whole = []
    for seen in pictures.values():
        located, starts = [], []
        for view, start in seen:
            board = int(view.rectangle.removeprefix("board"))
            body_from_rect = placed[board] @ Pose(np.eye(3), middles[board][1])
            located.append(body_from_rect.transform(view.points))
            starts.append(start @ body_from_rect.inverse())
        largest = int(np.argmax([len(points) for points in located]))
        pixels = np.concatenate([view.pixels for view, _ in seen])
        whole.append(residuals(lens, np.concatenate(located), pixels, starts[largest]))
    by_board, by_body = (np.sqrt((np.concatenate(rows) ** 2).sum(axis=1).mean()) for rows in (own, whole))
    return float(by_board), float(by_body)


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("../shared/data/cube")
    table = Table(
        "lens", "focal, px", "seen to, deg", "fit, px", "test, px", "body", "boards bent", "body of them", "s"
    )
    choices: tuple[LensChoice, ...] = ("fisheye", "auto")
    for choice in choices:
        start = time.perf_counter()
        rig = solved(folder, choice)
        seconds = time.perf_counter() - start
        camera = rig.cameras[0]
        rays = camera.intrinsics.unproject(np.concatenate([view.pixels for view in views(folder, "train")]))
        widest = np.degrees(np.nanmax(np.arccos(rays[:, 2])))
        found = *left_over(folder, camera.intrinsics), *left_over(folder, camera.intrinsics, rig.rectangles)
        table.add_row(
            choice if choice == camera.intrinsics.model else f"{choice}: {camera.intrinsics.model}",
            f"{camera.intrinsics.focal:.1f} +- {rig.focal_sigma('wide'):.1f}", f"{widest:.0f}", f"{camera.rms:.3f}",
            *(f"{rms:.3f}" for rms in found), f"{seconds:.1f}",
        )  # fmt: skip
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
