"""Recordings: what reading, decoding, searching and choosing frames cost, and what the choice costs in accuracy.

python benchmarks/recordings.py render room.mcap     the demo's room: 4 cameras, 1280x720, 300 framesets, blurred
python benchmarks/recordings.py search room.mcap     stages of the pipeline, with and without choice of frames
python benchmarks/recordings.py large room.mcap      memory and speed on 4 GiB, made by repeating
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from quadrig.io.beside import written_beside
from quadrig.io.demo_scene import Scene, demo_scene
from quadrig.io.progress import progress_bar
from quadrig.io.record import image_writer
from quadrig.io.workers import run_tasks
from quadrig.single.pose import Pose
from quadrig.single.render import Sheet, backdrop, ray_grid, render

FRAMESETS = 300
PERIOD = 1 / 30
EXPOSURE = 0.008
START = 1_700_000_000_000_000_000
# A person moves a board, holds it, moves on: this many holds, in which the board is nearly still.
HOLDS = 16


@dataclass(frozen=True, eq=False)
class Shots:
    """Framesets that one worker renders for one camera."""

    camera: int
    framesets: tuple[int, ...]


def moving_scene() -> Scene:
    """The demo's room with the board carried and held in turn over FRAMESETS framesets."""
    path = demo_scene(FRAMESETS * 20).board_poses
    return replace(demo_scene(FRAMESETS), board_poses=tuple(path[_phase(k * PERIOD)] for k in range(FRAMESETS)))


def _phase(seconds: float) -> int:
    """Where on the path of 20 poses a frameset the board is."""
    share = seconds / (FRAMESETS * PERIOD)
    held = share - np.sin(2 * np.pi * HOLDS * share) / (2 * np.pi * HOLDS)
    return int(round(np.clip(held, 0, 1 - 1e-9) * FRAMESETS * 20)) % (FRAMESETS * 20)


def _motion(scene: Scene, frameset: int) -> np.ndarray:
    """Step of the board's pose during the exposure."""
    path = demo_scene(FRAMESETS * 20).board_poses
    before, after = (path[_phase(max(frameset * PERIOD + side * EXPOSURE, 0.0))] for side in (-0.5, 0.5))
    turn = Pose(after.rotation @ before.rotation.T, np.zeros(3)).rotation_vector()
    return np.concatenate([turn, after.translation - before.translation])


def shoot(shots: Shots) -> list[tuple[int, bytes]]:
    """Frameset and JPEG of each picture."""
    scene = moving_scene()
    camera = scene.cameras[shots.camera]
    grid = ray_grid(camera.intrinsics)
    camera_from_world = camera.world_from_camera.inverse()
    room = backdrop(grid, camera_from_world, _room())
    pictures = []
    for frameset in shots.framesets:
        board = Sheet(scene.board, scene.board_poses[frameset], motion=_motion(scene, frameset))
        sheets = [*scene.furniture, *scene.static, board]
        rng = np.random.default_rng([shots.camera, frameset])
        image = render(
            grid, camera_from_world, sheets, background=room, samples=2, blur=0.6, noise=2.0, vignetting=0.15, rng=rng
        )
        pictures.append((frameset, cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()))
    return pictures


def _room():
    from quadrig.io.demo_scene import ROOM

    return ROOM


def render_recording(output: Path) -> None:
    """Write the room's recording."""
    blocks = np.array_split(np.arange(FRAMESETS), 6)
    tasks = [Shots(camera, tuple(block.tolist())) for block in blocks for camera in range(4)]
    found: dict[tuple[int, int], bytes] = {}
    with progress_bar("render", len(tasks), "blocks") as advance:
        for index, pictures in run_tasks(shoot, tasks):
            advance(1)
            found.update({(frameset, tasks[index].camera): data for frameset, data in pictures})
    with written_beside(output) as beside, beside.open("wb") as stream:
        write, finish = image_writer(stream, "foxglove")
        for frameset, camera in sorted(found):
            stamp = START + round(frameset * PERIOD * 1e9)
            write(f"cam{camera}", stamp, "jpeg", found[frameset, camera])
        finish()


def main() -> None:
    """Run the stage that is asked for."""
    stages = {"render": render_recording}
    if len(sys.argv) != 3 or sys.argv[1] not in stages:
        sys.exit(__doc__)
    stages[sys.argv[1]](Path(sys.argv[2]))


if __name__ == "__main__":
    main()
