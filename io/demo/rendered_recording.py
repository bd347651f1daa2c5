"""The demo's recording: pictures of a scene, rendered."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.demo.scene import ROOM, Scene, SceneCamera
from quadrig.io.progress import progress_bar
from quadrig.io.recording.convert import image_writer
from quadrig.io.whole_file import written_beside
from quadrig.io.workers import run_tasks
from quadrig.single.arrays import Picture
from quadrig.single.render.capture import SRGB, Capture
from quadrig.single.render.picture import backdrop, ray_grid, render_image

# What a usual camera does to light.
_CAPTURE = Capture(blur=0.6, noise=1.5, vignetting=0.15, curve=SRGB)
_JPEG_QUALITY = 95
# 2026-01-01T00:00:00 UTC; a picture every fifth of a second, stamped up to 2 ms apart by the cameras.
_START, _PERIOD, _JITTER = 1_767_225_600_000_000_000, 200_000_000, 2_000_000
# A camera's rays take as long as a dozen of its pictures: they are computed once for so many.
_BATCH = 48


@dataclass(frozen=True)
class _Task:
    camera: SceneCamera
    scene: Scene
    framesets: tuple[int, ...]


def demo_config(scene: Scene) -> RigConfig:
    """The rig.toml of a scene: its rectangles, nothing of its cameras but whose frame is the rig frame."""
    return RigConfig(scene.rectangles, reference=scene.cameras[0].name)


def write_demo_recording(path: Path, scene: Scene, workers: int | None = None, progress: bool = True) -> None:
    """Render a scene into an MCAP recording, on /NAME/image_raw/compressed.

    workers: processes; None as many as there are processors. Raises QuadrigError where it cannot be written.
    """
    framesets = range(len(scene.board_poses))
    batches = [tuple(framesets[i : i + _BATCH]) for i in range(0, len(framesets), _BATCH)]
    tasks = [_Task(camera, scene, batch) for camera in scene.cameras for batch in batches]
    taken: dict[tuple[int, str], bytes] = {}
    with progress_bar("render", len(framesets) * len(scene.cameras), "images", quiet=not progress) as advance:
        for index, jpegs in run_tasks(_render_batch, tasks, workers):
            task = tasks[index]
            for frameset, jpeg in zip(task.framesets, jpegs, strict=True):
                taken[_stamp(scene, task.camera, frameset), task.camera.name] = jpeg
            advance(len(jpegs))
    with written_beside(path) as beside, beside.open("wb") as stream:
        write, finish = image_writer(stream, "ros2")
        for (stamp, name), jpeg in sorted(taken.items()):
            write(name, stamp, "jpeg", jpeg)
        finish()


def pictures(camera: SceneCamera, scene: Scene, framesets: Iterable[int]) -> Iterator[Picture]:
    """What a camera of the scene takes in these framesets, each (h, w, 3) blue green red."""
    grid, camera_from_world = ray_grid(camera.intrinsics), camera.world_from_camera.inverse()
    empty_room = backdrop(grid, camera_from_world, ROOM)
    for frameset in framesets:
        rng = np.random.default_rng([frameset, *camera.name.encode()])
        sheets = scene.sheets(frameset)
        yield render_image(grid, camera_from_world, sheets, background=empty_room, capture=_CAPTURE, rng=rng)


def _render_batch(task: _Task) -> list[bytes]:
    cv2.setNumThreads(1)
    return [
        cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
        for image in pictures(task.camera, task.scene, task.framesets)
    ]


def _stamp(scene: Scene, camera: SceneCamera, frameset: int) -> int:
    index = [one.name for one in scene.cameras].index(camera.name)
    jitter = np.random.default_rng([frameset, index]).uniform(-_JITTER, _JITTER)
    return _START + frameset * _PERIOD + int(jitter)
