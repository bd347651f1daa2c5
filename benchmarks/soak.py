"""Whether `rig setup` can go on for hours: its memory and its rate, minute by minute.

    python -m benchmarks soak [--minutes 15] [--folder KEPT]
    python -m benchmarks soak --fleet 200 [--kill-every 60]

Four cameras of 640x360 at ten frames a second look at a board that is carried about and never comes to the same place
twice: videos of that length, drawn beforehand, then played in real time, searched, recorded and solved as live
cameras are. Memory is what this process and its solver hold, the mean of each minute; that of the last is held
against that of the second. How many framesets there are in a minute depends on what else the machine does, so the
rate is judged by the processor's time for one: that of all threads but those that play the videos, which go on
whether or not a frameset is taken.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import psutil

from quadrig.io.config.rig_toml import RigConfig, write_config
from quadrig.io.live.capture.source_spec import parse_source
from quadrig.io.live.plan import SetupPlan
from quadrig.io.live.session import run_setup
from quadrig.io.live.state import SetupState
from quadrig.io.recording.convert import record
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.io.workers import run_tasks
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

WIDTH, HEIGHT, RATE = 640, 360, 10
BOARD = Rectangle("board", 0.40, 0.30, CharucoMarking(4, 3, 0.1, 0.075, "aruco_4x4_50"), moving=True)
FOCALS = (480.0, 520.0, 555.0, 500.0)
# On an arc of this radius (m) about the place where the board is carried.
RADIUS, ANGLES = 1.6, (-0.6, -0.2, 0.2, 0.6)
_LOOK_EVERY = 2.0


@dataclass
class Meter:
    """When (s) framesets were shown, and solutions came."""

    times: list[float] = field(default_factory=list)
    solutions: list[float] = field(default_factory=list)
    kept: int = 0
    _newest: object = None

    def show(self, state: SetupState) -> None:
        """Note that a moment is shown now."""
        now = time.monotonic()
        if state.frames:
            self.times.append(now)
        if state.rig is not None and state.rig is not self._newest:
            self._newest = state.rig
            self.solutions.append(now)
        self.kept = state.kept

    def close(self) -> None:
        """Nothing is open."""


@dataclass
class Memory:
    """What a session's processes hold, s and bytes, and the processor's time, s, of what works on framesets."""

    times: list[float] = field(default_factory=list)
    bytes: list[int] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    def watch(self, done: threading.Event) -> None:
        """Look until it is done."""
        own = psutil.Process()
        while not done.wait(_LOOK_EVERY):
            self.times.append(time.monotonic())
            self.bytes.append(sum(p.memory_info().rss for p in (own, *own.children(recursive=True))))
            self.processor.append(_spent_on_framesets(own))


def _spent_on_framesets(own: psutil.Process) -> float:
    named = {thread.native_id for thread in threading.enumerate() if not thread.name.startswith("source ")}
    return sum(one.user_time + one.system_time for one in own.threads() if one.id in named)


def main() -> None:
    """Draw, play, and print a line for each minute."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--minutes", type=float, default=15.0, help="how long the session lasts")
    parser.add_argument("--folder", type=Path, help="where the drawn videos stay")
    parser.add_argument("--fleet", type=int, default=0, help="calibrate so many recordings instead")
    parser.add_argument("--kill-every", type=float, default=60.0, help="s from one killed worker to the next")
    options = parser.parse_args()
    if options.fleet:
        fleet(options.fleet, options.kill_every)
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        videos = drawn(folder, round(60 * RATE * options.minutes))
        meter, memory = played(videos, Path(temporary) / "recording.mcap")
    show(meter, memory)


def drawn(folder: Path, frames: int) -> list[Path]:
    """A video for each camera, of a board carried on a path that does not close."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"cam{k}-{frames}.avi" for k in range(len(FOCALS))]
    missing = [(path, k, frames) for k, path in enumerate(paths) if not path.exists()]
    for index, _ in run_tasks(draw, missing):
        print(f"{missing[index][0].name} is drawn", flush=True)
    return paths


def draw(task: tuple[Path, int, int]) -> None:
    """Draw one camera's video."""
    path, camera, frames = task
    lens = Intrinsics.centred(WIDTH, HEIGHT, FOCALS[camera])
    angle, grid, rng = ANGLES[camera], ray_grid(lens), np.random.default_rng(camera)
    world_from_camera = Pose.from_vectors(
        np.array([0.0, -angle, 0.0]), RADIUS * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    )
    camera_from_world, capture = world_from_camera.inverse(), Capture(blur=0.6, noise=1.5)
    part = path.with_suffix(".part.avi")
    writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*"MJPG"), RATE, (WIDTH, HEIGHT))
    for frame in range(frames):
        sheets = [Sheet(BOARD, carried(frame / RATE))]
        image = render_image(grid, camera_from_world, sheets, samples=1, capture=capture, rng=rng, colour=False)
        writer.write(cv2.cvtColor(np.asarray(image), cv2.COLOR_GRAY2BGR))
    writer.release()
    part.rename(path)


def carried(time: float) -> Pose:
    """The board at a time (s), at some centimetres a second, in a frame whose origin is the middle of its path."""
    position = [0.25 * np.sin(0.43 * time), 0.14 * np.sin(0.61 * time + 1), 0.20 * np.sin(0.29 * time + 2)]
    rotation = [0.5 * np.sin(0.37 * time), 0.5 * np.sin(0.53 * time + 1), 0.4 * np.sin(0.23 * time)]
    return Pose.from_vectors(np.array(rotation), np.array(position))


def played(videos: Sequence[Path], recording: Path) -> tuple[Meter, Memory]:
    """A session over all of the videos."""
    sources = {f"cam{k}": parse_source(str(path)) for k, path in enumerate(videos)}
    meter, memory, done = Meter(), Memory(), threading.Event()
    watching = threading.Thread(target=memory.watch, args=(done,))
    watching.start()
    try:
        run_setup(SetupPlan(RigConfig((BOARD,), reference="cam0"), sources, recording), [meter], str)
    finally:
        done.set()
        watching.join()
    return meter, memory


def show(meter: Meter, memory: Memory) -> None:
    """A line for each whole minute, and how the last compares with the second."""
    times, solutions = np.array(meter.times), np.array(meter.solutions)
    looks, held, used = np.array(memory.times), np.array(memory.bytes) / 2**20, np.array(memory.processor)
    rows = []
    print("minute  framesets/s  ms of processor a frameset  solutions  MiB")
    for minute in range(int((times[-1] - times[0]) / 60)):
        start = times[0] + 60 * minute
        within = [(one >= start) & (one < start + 60) for one in (times, solutions, looks)]
        count = np.count_nonzero(within[0])
        cost = 1000 * float(np.ptp(used[within[2]])) / max(count, 1)
        rows.append((count / 60, cost, np.count_nonzero(within[1]), held[within[2]].mean()))
        print(f"{minute + 1:6}  {rows[-1][0]:11.2f}  {cost:27.1f}  {rows[-1][2]:9}  {rows[-1][3]:5.1f}")
    if len(rows) > 2:
        growth, cost = rows[-1][3] / rows[1][3] - 1, rows[-1][1] / rows[1][1]
        print(f"{meter.kept} framesets kept, {len(solutions)} solutions")
        print(
            f"memory of the last minute {growth:+.1%} of the second's, processor's time a frameset {cost:.3f} of it"
        )


def fleet(count: int, kill_every: float) -> None:
    """Calibrate copies of one recording with workers that are killed; print what became of them."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "takes").mkdir()
        for _ in run_tasks(draw, [(folder / f"cam{k}.avi", k, 20) for k in (1, 2)]):
            pass
        first = folder / "takes" / "take000.mcap"
        record(open_recording([folder / "cam1.avi", folder / "cam2.avi"]).cameras, first, progress=False)
        for k in range(1, count):
            shutil.copy(first, folder / "takes" / f"take{k:03}.mcap")
        write_config(RigConfig((BOARD,), reference="cam1"), folder / "rig.toml")
        began, killed, most = time.monotonic(), 0, 0
        command = [str(Path(sys.executable).with_name("rig")), "calibrate", "takes", "--each", "-o", "rigs"]
        with (folder / "said").open("wb") as said:
            running = psutil.Popen(command, cwd=folder, stdout=said, stderr=subprocess.STDOUT)
        due = began + kill_every
        while running.poll() is None:
            time.sleep(0.5)
            workers = [one for one in children(running) if "spawn_main" in " ".join(one.cmdline())]
            most = max(most, sum(one.memory_info().rss for one in (running, *workers) if one.is_running()))
            if time.monotonic() > due and workers:
                os.kill(workers[killed % len(workers)].pid, signal.SIGKILL)
                killed, due = killed + 1, time.monotonic() + kill_every
        made = sorted((folder / "rigs").glob("take*.rig.mcap"))
        rigs = {read_rig(path).covariance.tobytes() for path in made}
        left = [path.name for path in (folder / "rigs").iterdir() if path.name.startswith(".")]
        print((folder / "said").read_text().splitlines()[-1])
        print(
            f"exit code {running.returncode}: {len(made)} of {count} rigs, {len(rigs)} different, {killed} kills; "
            f"{time.monotonic() - began:.0f} s, at most {most / 2**20:.0f} MiB; left behind: {left}"
        )


def children(process: psutil.Process) -> list[psutil.Process]:
    """Those that live."""
    try:
        return [one for one in process.children(recursive=True) if one.status() != psutil.STATUS_ZOMBIE]
    except psutil.NoSuchProcess:
        return []


if __name__ == "__main__":
    main()
