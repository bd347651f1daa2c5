"""How quick `rig setup` is: framesets a second, and milliseconds from a frame's arrival to the screen.

    python benchmarks/live.py [--seconds 15] [--sheet board|tag] [--folder KEPT]

Four cameras of 1280x720 at 30 frames a second look at the demo's room: rendered videos, played in real time. Runs
one session after the other: terminal only; a connected rerun viewer's server that draws nothing (what a viewer costs
where a graphics card draws); a whole viewer that draws in software (--headless) on the same processor. The latency is
that to the terminal, or until the viewer has accepted the moment; the processor's time is that of one frameset in the
session's own process, without the solver's and the viewer's. The pictures are rendered once, in a few minutes; a
folder that is named keeps them.
"""

import argparse
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.demo.rendered_recording import pictures
from quadrig.io.demo.scene import HEIGHT, WIDTH, Scene, demo_scene
from quadrig.io.live.capture.source_spec import parse_source
from quadrig.io.live.display import Screen
from quadrig.io.live.plan import SetupPlan
from quadrig.io.live.session import run_setup
from quadrig.io.live.state import SetupState
from quadrig.io.live.terminal import PlainScreen
from quadrig.io.viewer.process import Viewer
from quadrig.io.viewer.setup.screen import RerunScreen
from quadrig.io.workers import run_tasks
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle

RATE, FRAMES = 30, 300
# The demo's path, walked through in half a minute: the speed of a hand that shows a board.
WHOLE_PATH = 900
# Processes that start and lenses that are first computed are not what is measured.
WARM_UP = 3.0


@dataclass
class Meter:
    """When, s, a moment was shown, and how long, s, after its frames had arrived."""

    times: list[float] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    rigs: int = 0

    def show(self, state: SetupState) -> None:
        """Note that a moment is shown now."""
        if state.frames:
            self.times.append(time.monotonic())
            self.processor.append(time.process_time())
            self.latencies.append(self.times[-1] - min(frame.arrived for frame in state.frames.values()))
        self.rigs = max(self.rigs, len(state.rig.cameras) if state.rig else 0)

    def close(self) -> None:
        """Nothing is open."""


class MeteredRerun(RerunScreen):
    """The viewer, metered where it has accepted a moment."""

    def __init__(self, meter: Meter, scene: Scene, viewer: Viewer) -> None:
        super().__init__([camera.name for camera in scene.cameras], scene.rectangles, viewer)
        self._meter = meter

    def log(self, state: SetupState) -> None:
        """Log, wait, note."""
        super().log(state)
        self._recording.flush()
        self._meter.show(state)


def main() -> None:
    """Print rate and latency with each kind of screen."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=15.0, help="how long each session runs")
    parser.add_argument("--sheet", choices=("board", "tag"), default="board", help="what the hand holds")
    parser.add_argument("--folder", type=Path, help="where the rendered videos stay")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        scene = scene_with(options.sheet)
        videos = rendered(folder / options.sheet, scene)
        table = Table(title=f"4 cameras of {WIDTH}x{HEIGHT} at {RATE} a second; {options.sheet} in the hand")
        for name in ("screen", "rate", "latency", "95 %", "processor", "cameras"):
            table.add_column(name, justify="left" if name == "screen" else "right", no_wrap=True)
        for name in ("terminal", "viewer's server", "viewer, software"):
            table.add_row(name, *measured(name, scene, videos, options.seconds))
        Console().print(table)


def scene_with(sheet: str) -> Scene:
    """The demo's room with its ChArUco board, or with a tag of its size, in the hand."""
    scene = demo_scene(WHOLE_PATH)
    tag = Rectangle("tag", 0.24, 0.24, TagMarking("apriltag_36h11", 40), moving=True)
    return scene if sheet == "board" else replace(scene, board=tag)


def rendered(folder: Path, scene: Scene) -> list[Path]:
    """A video for each camera, there and back along the path."""
    paths = [folder / f"{camera.name}.avi" for camera in scene.cameras]
    if not all(path.exists() for path in paths):
        folder.mkdir(parents=True, exist_ok=True)
        for _ in run_tasks(write_video, [(path, k, scene) for k, path in enumerate(paths)]):
            pass
    return paths


def write_video(task: tuple[Path, int, Scene]) -> None:
    """Render one camera's video."""
    path, index, scene = task
    cv2.setNumThreads(1)
    shown = list(pictures(scene.cameras[index], scene, range(FRAMES)))
    part = path.with_suffix(".part.avi")
    writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*"MJPG"), RATE, (WIDTH, HEIGHT))
    for image in [*shown, *reversed(shown)]:
        writer.write(np.asarray(image))
    writer.release()
    part.rename(path)


def measured(name: str, scene: Scene, videos: Sequence[Path], seconds: float) -> list[str]:
    """One row: a session of so many seconds with one kind of screen."""
    config = RigConfig(scene.rectangles, reference=scene.cameras[0].name)
    meter, viewer = Meter(), None
    screens: list[Screen] = [PlainScreen(), meter]
    if name != "terminal":
        viewer = Viewer(options=("--serve-grpc",) if "server" in name else ("--headless",))
        screens = [PlainScreen(), MeteredRerun(meter, scene, viewer)]
    ending = threading.Event()
    threading.Timer(seconds + WARM_UP, ending.set).start()
    with tempfile.TemporaryDirectory() as folder:
        plan = SetupPlan(config, {path.stem: parse_source(str(path)) for path in videos}, Path(folder) / "r.mcap")
        run_setup(plan, screens, lambda: "the time is up" if ending.is_set() else "")
    for screen in screens:
        screen.close()
    if viewer is not None:
        viewer.close(force=True)
    times = np.array(meter.times)
    counted = times > times[0] + WARM_UP
    latency = 1000 * np.array(meter.latencies)[counted]
    rate = np.count_nonzero(counted) / (times[-1] - times[0] - WARM_UP)
    middle, most = np.percentile(latency, [50, 95])
    used = 1000 * np.diff(np.array(meter.processor)[counted][[0, -1]])[0] / (np.count_nonzero(counted) - 1)
    return [f"{rate:.1f} /s", f"{middle:.0f} ms", f"{most:.0f} ms", f"{used:.0f} ms", str(meter.rigs)]


if __name__ == "__main__":
    main()
