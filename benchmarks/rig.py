"""quadrig, pycolmap and OpenCV's calibrateMultiview on identical Views, in the same run, each on one thread.

    python benchmarks/rig.py            (pip install quadrig[bench] for pycolmap)

The data of ../shared/data/bench where it is beside the checkout; else rigs like it are simulated. Peers are given the
lens that suits each file, and run with another where that is what a user would try; quadrig is given nothing.
"""

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from peers import Peer, multiview, pycolmap_rig
from rich.console import Console
from rich.table import Table
from simulated import HEIGHT, WIDTH, Scene, simulate

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import vector_from_rotation
from quadrig.single.view import View

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "bench"
FILES = ("synth", "synth_dist", "synth_quad", "synth_quad1")
# The files' principal points lie in the middle of the picture at half its size: their pixels count from the corner of
# the first pixel, ours from its centre.
PIXEL_CENTRE = -0.5
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# Runs of each solver, taken in turn; the quickest counts, since what else runs can only slow one down;
# processor time, so that waiting for others does not count at all.
_RUNS = 7


@dataclass(frozen=True, eq=False)
class Task:
    """One file: what every solver gets, and the truth in the frame of the first camera."""

    name: str
    cameras: tuple[CameraInput, ...]
    rectangle: Rectangle
    views: tuple[View, ...]
    focal: np.ndarray
    rig_from_camera: Pose
    noise: float


def load(name: str) -> Task:
    """A file of bench, or a rig simulated like it."""
    file = DATA / f"{name}.npz"
    return _simulated(name) if not file.exists() else _stored(name, file)


def _stored(name: str, file: Path) -> Task:
    with np.load(file) as stored:
        data = dict(stored)
    low, high = data["board"].min(axis=0), data["board"].max(axis=0)
    points, size = data["board"] - (low + high) / 2, high - low
    width, height = (int(n) for n in data["image_size"])
    views = [
        View("sheet", points, data["obs"][c, f] + PIXEL_CENTRE, f"cam{c}", int(f))
        for c, f in zip(*np.nonzero(data["vis"]), strict=True)
    ]
    return Task(
        name,
        tuple(CameraInput(f"cam{c}", width, height) for c in range(len(data["K"]))),
        Rectangle("sheet", float(size[0]), float(size[1]), moving=True),
        tuple(views),
        data["K"][:, 0, 0],
        Pose(data["R"], data["t"]).inverse(),
        float(data["noise"]),
    )


def _simulated(name: str) -> Task:
    quad = "quad" in name
    scene = Scene(
        4, 40, 0.3, board=not quad, tags=0, distortion=name == "synth_dist", principal=0.004 * (name == "synth_dist")
    )
    made = simulate(FILES.index(name), scene)
    views = made.views
    if name == "synth_quad1":
        shared = [[v for v in views if v.frameset == f] for f in range(40)]
        views = tuple(max(shared, key=len))
    names = [f"cam{c}" for c in range(4) if any(v.camera == f"cam{c}" for v in views)]
    poses = [made.rig_from_camera(names[0], n) for n in names]
    return Task(
        name + " (simulated)",
        tuple(CameraInput(n, WIDTH, HEIGHT) for n in names),
        made.rectangles[0],
        views,
        made.lenses[[int(n[3:]) for n in names], 0],
        Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses])),
        made.noise,
    )


def quadrig(task: Task) -> Peer:
    """This project: Views to Rig with covariance, every lens parameter free, working accuracy, held-out figures."""
    rig = calibrate(task.cameras, [task.rectangle], task.views)
    poses = [c.rig_from_camera for c in rig.cameras]
    return Peer(
        np.array([c.intrinsics.focal for c in rig.cameras]),
        Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses])),
    )


def solvers(name: str) -> dict[str, Callable[[Task], Peer]]:
    """quadrig first, then the peers with the lens that the file needs, then with the other."""
    bent = "dist" in name
    found: dict[str, Callable[[Task], Peer]] = {"quadrig": quadrig}
    for given in (bent, not bent):
        if "quad" in name and given:
            continue
        lens = "bent lens" if given else "focal only"
        if find_spec("pycolmap"):
            found[f"pycolmap, {lens}"] = lambda task, given=given: pycolmap_rig(task.cameras, task.views, given)
            if given == bent:
                usual = f"pycolmap after calibrateCamera, {lens}"
                found[usual] = lambda task, given=given: pycolmap_rig(task.cameras, task.views, given, usual=True)
        found[f"calibrateMultiview, {lens}"] = lambda task, given=given: multiview(task.cameras, task.views, given)
    return found


def errors(task: Task, found: Peer) -> tuple[float, float, float]:
    """Means: focal (per cent), rotation (degrees) and centre (mm) of all cameras but the first."""
    turn = np.swapaxes(task.rig_from_camera.rotation, -1, -2) @ found.rig_from_camera.rotation
    angle = np.degrees(np.linalg.norm(vector_from_rotation(turn), axis=-1))[1:]
    gap = np.linalg.norm(found.rig_from_camera.translation - task.rig_from_camera.translation, axis=-1)[1:]
    return float(100 * np.abs(found.focal / task.focal - 1).mean()), float(angle.mean()), float(1000 * gap.mean())


def measured(task: Task) -> dict[str, tuple[float, tuple[float, float, float]] | str]:
    """Quickest time (s) and errors of every solver; a sentence where one fails."""
    found: dict[str, tuple[float, tuple[float, float, float]] | str] = {}
    chosen = solvers(task.name)
    for _ in range(_RUNS):
        for name, solve in chosen.items():
            if isinstance(found.get(name), str):
                continue
            began = time.process_time()
            try:
                answer = solve(task)
            except Exception as error:
                found[name] = f"failed: {str(error).strip().splitlines()[0][:60]}"
                continue
            seconds = time.process_time() - began
            before = found.get(name)
            least = seconds if before is None or isinstance(before, str) else min(seconds, before[0])
            found[name] = (least, errors(task, answer))
    return found


def main() -> None:
    """Print one table."""
    if not _ONE_THREAD.items() <= os.environ.items():
        # Numpy reads them once, when it is first imported.
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **_ONE_THREAD})
    cv2.setNumThreads(1)
    table = Table(title=f"Views to rig, one thread, processor time, least of {_RUNS} runs in turn")
    for column in ("file", "solver"):
        table.add_column(column)
    for column in ("ms", "times quadrig's", "focal %", "rotation deg", "centre mm"):
        table.add_column(column, justify="right")
    for file in FILES:
        task = load(file)
        found = measured(task)
        ours = found["quadrig"]
        for name, answer in found.items():
            if isinstance(answer, str) or isinstance(ours, str):
                table.add_row(task.name, name, "", answer if isinstance(answer, str) else "", "", "", "")
                continue
            seconds, (focal, rotation, centre) = answer
            ratio = f"{seconds / ours[0]:.1f}"
            figures = (f"{focal:.3f}", f"{rotation:.3f}", f"{centre:.2f}")
            table.add_row(task.name, name, f"{1000 * seconds:.0f}", ratio, *figures)
        table.add_section()
    console = Console(width=120)
    console.print(table)
    if not find_spec("pycolmap"):
        console.print("pycolmap is not installed: pip install quadrig[bench]")


if __name__ == "__main__":
    main()
