"""Recordings: what reading, decoding, searching and choosing frames cost, and what the choice costs in accuracy.

python benchmarks/recordings.py render room.mcap [--framesets N]
                                                     the demo's room: 4 cameras, 1280x720, blurred, the first N of a
                                                     take of 300 framesets; and room.toml for `rig calibrate`
python benchmarks/recordings.py search room.mcap     stages of the pipeline, with and without choice of frames
python benchmarks/recordings.py large room.mcap      memory and speed on 4 GiB, made by repeating

Times are the processors' own, of this process and its workers, so that what else the machine does hardly counts.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from detect import Found, PlainLoop, corners
from processor_time import Spent, spent

from quadrig.io.config.rig_toml import write_config
from quadrig.io.demo.rendered_recording import demo_config
from quadrig.io.demo.scene import ROOM, Scene, SceneCamera, demo_scene
from quadrig.io.progress import progress_bar
from quadrig.io.recording.convert import image_writer
from quadrig.io.recording.image_source import ImageSource
from quadrig.io.whole_file import written_beside
from quadrig.io.workers import run_tasks
from quadrig.single.pose import Pose
from quadrig.single.render.capture import SRGB, Capture
from quadrig.single.render.picture import Sheet, backdrop, ray_grid, render_image
from quadrig.single.view import View

# Of the whole take, and of what is rendered of it where nothing else is asked for: a few minutes of work.
FRAMESETS, USUAL = 300, 120
WORKERS = 2
PERIOD = 1 / 30
EXPOSURE = 0.008
START = 1_700_000_000_000_000_000
# A person moves a board, holds it, moves on: this many holds, in which the board is nearly still.
HOLDS = 16
CAPTURE = Capture(blur=0.6, noise=2.0, vignetting=0.15, curve=SRGB)
# px within which a corner is the same.
CLOSE = 0.05


@dataclass(frozen=True, eq=False)
class Shots:
    """Framesets that one worker renders for one camera."""

    camera: int
    framesets: tuple[int, ...]


def moving_scene() -> Scene:
    """The demo's room with the board carried and held in turn over FRAMESETS framesets."""
    path = _path()
    return replace(demo_scene(FRAMESETS), board_poses=tuple(path[_phase(k * PERIOD)] for k in range(FRAMESETS)))


@cache
def _path() -> tuple[Pose, ...]:
    """The board's way, in steps a twentieth of a frameset's."""
    return tuple(demo_scene(FRAMESETS * 20).board_poses)


def _phase(seconds: float) -> int:
    """Where on the path of 20 poses a frameset the board is."""
    share = seconds / (FRAMESETS * PERIOD)
    held = share - np.sin(2 * np.pi * HOLDS * share) / (2 * np.pi * HOLDS)
    return round(float(np.clip(held, 0, 1 - 1e-9)) * FRAMESETS * 20) % (FRAMESETS * 20)


def _motion(frameset: int) -> np.ndarray:
    """Step of the board's pose during the exposure."""
    before, after = (_path()[_phase(max(frameset * PERIOD + side * EXPOSURE, 0.0))] for side in (-0.5, 0.5))
    turn = Pose(after.rotation @ before.rotation.T, np.zeros(3)).rotation_vector()
    return np.concatenate([turn, after.translation - before.translation])


def shoot(shots: Shots) -> list[tuple[int, bytes]]:
    """Frameset and JPEG of each picture."""
    scene = moving_scene()
    camera = scene.cameras[shots.camera]
    grid = ray_grid(camera.intrinsics)
    camera_from_world = camera.world_from_camera.inverse()
    room = backdrop(grid, camera_from_world, ROOM)
    pictures = []
    for frameset in shots.framesets:
        board = Sheet(scene.board, scene.board_poses[frameset], motion=_motion(frameset))
        sheets = [*scene.furniture, *scene.static, board]
        rng = np.random.default_rng([shots.camera, frameset])
        image = render_image(grid, camera_from_world, sheets, background=room, capture=CAPTURE, samples=2, rng=rng)
        pictures.append((frameset, cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()))
    return pictures


def render_recording(output: Path, framesets: int) -> None:
    """Write the first framesets of the room's recording, and its rig.toml beside it."""
    write_config(demo_config(demo_scene(FRAMESETS)), output.with_suffix(".toml"))
    blocks = np.array_split(np.arange(framesets), 6)
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


def decode(block: tuple[str, str, int, int]) -> int:
    """Decode the images of a camera from one index to another, and nothing else; how many there are."""
    return sum(image is not None for image in _part(block).images())


def _part(block: tuple[str, str, int, int]) -> ImageSource:
    from quadrig.io.recording.recorded_cameras import open_recording

    name, camera, begin, end = block
    source = open_recording([Path(name)]).camera(camera).source
    return source.part(np.arange(begin, min(end, len(source))))


def plain_search(block: tuple[str, str, int, int]) -> list[Found]:
    """The straight loop: decode and search whole images for tags and for the board, from one index to another."""
    plain = PlainLoop(demo_scene(FRAMESETS).rectangles)
    return [{} if image is None else plain(image) for image in _part(block).images()]


def compare_corners(plain: dict[tuple[str, int], Found], views: Sequence[View]) -> None:
    """Print what share of the plain loop's corners was found, and how far both are from the truth."""
    scene = moving_scene()
    cameras = {camera.name: camera for camera in scene.cameras}
    kinds = {r.name: r.marking.kind for r in scene.rectangles}
    ours: dict[tuple[str, int], Found] = {}
    for view in views:
        ours.setdefault((view.camera, view.frameset), {})[view.rectangle] = (view.points, view.pixels)
    images = sorted(plain)
    seen = [corners([found.get(image, {}) for image in images]) for found in (plain, ours)]
    for kind in sorted(set(kinds.values())):
        theirs, own = ({key: at for key, at in one.items() if kinds[key[1]] == kind} for one in seen)
        common = [key for key in theirs if key in own]
        if not common:
            print(f"{kind}: none in common; the plain loop found {len(theirs)} corners, ours {len(own)}")
            continue
        truth = {key: _truth(scene, cameras[images[key[0]][0]], images[key[0]][1], key) for key in {**theirs, **own}}
        gap = np.array([np.linalg.norm(theirs[key] - own[key]) for key in common])
        off = [np.array([np.linalg.norm(at - truth[key]) for key, at in one.items()]) for one in (own, theirs)]
        right = np.array([np.linalg.norm(theirs[key] - truth[key]) for key in common]) < CLOSE
        print(
            f"{kind}: {100 * len(common) / len(theirs):.2f} % of the plain loop's {len(theirs)} corners found, "
            f"{len(own)} in all; {100 * np.mean(gap < CLOSE):.1f} % within {CLOSE} px of the plain loop's"
            + _of_those(gap[right] < CLOSE)
        )
        for name, errors in zip(("ours", "plain"), off, strict=True):
            print(
                f"    {name}, from the truth: median {np.median(errors):.3f}, 99 % {np.quantile(errors, 0.99):.3f}, "
                f"{100 * np.mean(errors < CLOSE):.1f} % within {CLOSE} px"
            )


def _of_those(close: np.ndarray) -> str:
    return (
        f", {100 * np.mean(close):.1f} % of those where the plain loop is as near to the truth" if close.size else ""
    )


def _truth(scene: Scene, camera: SceneCamera, frameset: int, key: tuple) -> np.ndarray:
    """Where in the picture the point of a key of `corners` is."""
    poses = {sheet.rectangle.name: sheet.world_from_rect for sheet in (*scene.furniture, *scene.static)}
    pose = poses.get(key[1], scene.board_poses[frameset])
    point = pose.transform(np.array([key[2:]]) * 1e-5)
    return camera.intrinsics.project(camera.world_from_camera.inverse().transform(point))[0]


def search(path: Path) -> None:
    """Time the stages, and compare the rigs of all images, of the chosen tenth and of every tenth with the truth."""
    from quadrig.io.recording.framesets import build_framesets
    from quadrig.io.recording.recorded_cameras import open_recording
    from quadrig.io.search.choose_frames import choose_frames
    from quadrig.io.search.detections import find_detections
    from quadrig.io.search.effort import Effort

    scene = demo_scene(FRAMESETS)
    opened, cost = spent(lambda: open_recording([path]))
    framesets, more = spent(lambda: build_framesets(opened))
    count = len(framesets)
    images = sum(len(camera.source) for camera in opened.cameras)
    print(f"{images} images, {count} framesets; open and framesets: {cost.processor + more.processor:.2f} s")
    blocks = [(str(path), camera.name, k, k + 25) for k in range(0, count, 25) for camera in opened.cameras]
    # Starting workers is part of every run below, and of none of what decoding is taken to be.
    _, decoding = spent(lambda: [decode(block) for block in blocks])
    print(f"decode all to grey: {decoding.processor:.1f} s, {1000 * decoding.processor / images:.1f} ms an image")
    found, plain = spent(lambda: dict(run_tasks(plain_search, blocks, workers=WORKERS)))
    theirs = {(blocks[k][1], blocks[k][2] + n): one for k, part in found.items() for n, one in enumerate(part)}
    paced = Pace(plain, decoding, images)
    paced.tell("plain loop", plain, images)
    with tempfile.TemporaryDirectory() as folder:
        keeping = Effort(workers=WORKERS, cache=Path(folder) / "detections.mcap")
        every, cost = spent(lambda: find_detections(opened, framesets, scene.rectangles, keeping))
        paced.tell("every image", cost, images)
        _, cost = spent(lambda: find_detections(opened, framesets, scene.rectangles, keeping))
        paced.tell("again, kept", cost, 0)
    compare_corners(theirs, every.views)
    tenth = Effort(share=0.1, workers=WORKERS)
    chosen, choosing = spent(lambda: choose_frames(opened, framesets, tenth))
    paced.tell("choice", choosing, 0)
    some, cost = spent(lambda: find_detections(opened, chosen, scene.rectangles, tenth))
    paced.tell("choice and search", choosing + cost, some.searched)
    whole = None
    kept = set(np.flatnonzero(chosen.sizes() > 0).tolist())
    for name, numbers in {
        "all": set(range(count)),
        f"{len(kept)} chosen": kept,
        **{f"every tenth from {k}": set(range(k, count, 10)) for k in (0, 3, 6)},
    }.items():
        rig = _judge(name, scene, opened, [view for view in every.views if view.frameset in numbers])
        whole = whole or rig
        moved = [
            np.linalg.norm(one.rig_from_camera.translation - other.rig_from_camera.translation) * 1e3
            for one, other in zip(rig.cameras[1:], whole.cameras[1:], strict=True)
        ]
        print(f"    from where all images put the cameras: {np.mean(moved):.2f} mm")


@dataclass(frozen=True)
class Pace:
    """What the plain loop spends on all images, decoding included, and what decoding alone takes."""

    plain: Spent
    decoding: Spent
    images: int

    def tell(self, name: str, cost: Spent, decoded: int) -> None:
        """Print what a stage spent beside the plain loop, and how much of it is decoding of so many images."""
        decoding = self.decoding.processor * decoded / self.images
        line = f"{name}: {cost.processor:.1f} s ({cost.seconds:.1f} s passed)"
        line += f", {self.plain.processor / cost.processor:.1f} times the plain loop's speed"
        if decoded:
            line += f"; decoding is {100 * decoding / cost.processor:.0f} % of it"
        if decoded == self.images and cost.processor > decoding:
            apart = (self.plain.processor - self.decoding.processor) / (cost.processor - decoding)
            line += f", {apart:.1f} times without"
        print(line, flush=True)


def _judge(name, scene, opened, views):
    from quadrig.rig.calibration import calibrate
    from quadrig.rig.problem.camera_input import CameraInput

    inputs = [CameraInput(camera.name, camera.width, camera.height) for camera in opened.cameras]
    rig = calibrate(inputs, scene.rectangles, views, "cam0")
    first = scene.cameras[0].world_from_camera.inverse()
    focal, place = [], []
    for camera in scene.cameras:
        solved = rig.camera(camera.name)
        focal.append(abs(solved.intrinsics.focal / camera.intrinsics.focal - 1) * 100)
        truth = first @ camera.world_from_camera
        place.append(np.linalg.norm(solved.rig_from_camera.translation - truth.translation) * 1e3)
    print(
        f"{name}: {len(views)} Views, focal {np.mean(focal):.3f} %, position {np.mean(place[1:]):.2f} mm, "
        f"working accuracy {rig.working_accuracy * 1e3:.2f} mm, RMS {rig.rms:.3f} px"
    )
    return rig


def large(path: Path) -> None:
    """Memory of a search of 4 GiB, made by repeating the recording, of which the first minute is timed."""
    import threading

    import psutil

    from quadrig.io.recording.framesets import NO_FRAME, build_framesets
    from quadrig.io.recording.image_source import McapImages
    from quadrig.io.recording.recorded_cameras import open_recording
    from quadrig.io.search.choose_frames import choose_frames
    from quadrig.io.search.detections import find_detections
    from quadrig.io.search.effort import Effort

    times = -(-4 * 2**30 // path.stat().st_size)
    opened = open_recording([path])
    count = len(build_framesets(opened))
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "large.mcap"
        with output.open("wb") as stream, ExitStack() as stack:
            write, finish = image_writer(stream, "foxglove")
            sources = {camera.name: camera.source for camera in opened.cameras}
            topics = {
                name: stack.enter_context(source.messages.opened())
                for name, source in sources.items()
                if isinstance(source, McapImages)
            }
            for k in range(times):
                for n in range(count):
                    for name, messages in topics.items():
                        stamp = START + round((k * count + n) * PERIOD * 1e9)
                        write(name, stamp, "jpeg", messages.image(n).data)
            finish()
        print(f"{output.stat().st_size / 2**30:.2f} GiB")
        most = [0.0]
        done = threading.Event()

        def watch() -> None:
            own = psutil.Process()
            while not done.wait(0.2):
                sizes = [p.memory_info().rss for p in (own, *own.children(recursive=True)) if p.is_running()]
                most[0] = max(most[0], sum(sizes) / 2**30)

        threading.Thread(target=watch, daemon=True).start()
        began = time.perf_counter()
        big = open_recording([output])
        framesets = build_framesets(big)
        print(f"open and framesets: {time.perf_counter() - began:.2f} s, {len(framesets)} framesets")
        began = time.perf_counter()
        chosen = choose_frames(big, framesets, Effort(share=0.1, workers=WORKERS))
        print(f"choice: {time.perf_counter() - began:.1f} s; most memory so far, all processes: {most[0]:.2f} GiB")
        began = time.perf_counter()
        frames = chosen.frames.copy()
        frames[int(0.2 * len(frames)) :] = NO_FRAME
        found = find_detections(
            big, replace(chosen, frames=frames), demo_scene(FRAMESETS).rectangles, Effort(workers=WORKERS)
        )
        done.set()
        print(
            f"search of {found.searched} images: {time.perf_counter() - began:.1f} s; most memory, all processes: "
            f"{most[0]:.2f} GiB"
        )


def main() -> None:
    """Run the stage that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stage", choices=["render", "search", "large"])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--framesets", type=int, default=USUAL, help=f"to render, at most {FRAMESETS}")
    asked = parser.parse_args()
    if asked.stage == "render":
        render_recording(asked.recording, min(asked.framesets, FRAMESETS))
    else:
        {"search": search, "large": large}[asked.stage](asked.recording)


if __name__ == "__main__":
    main()
