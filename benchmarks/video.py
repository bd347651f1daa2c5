"""Long videos: processor time and memory of a search of the chosen tenth, as the minutes grow.

python benchmarks/video.py room.mcap [--minutes M ...]     room.mcap: see `python benchmarks/recordings.py render`

Four H.264 videos of 30 Hz with a key frame a second are made of the recording's pictures: encoded once, and their
packets repeated. Decoding, the plain OpenCV loop and our search of every image are timed on what is there once; the
chosen tenth, in a process of its own that is watched, on each length. The last line says what 30 minutes would take
if time went on growing as it did between the two longest.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import psutil
from detect import PlainLoop
from processor_time import spent

from quadrig.io.demo.scene import demo_scene
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.search.choose_frames import choose_frames
from quadrig.io.search.detections import find_detections
from quadrig.io.search.effort import Effort
from quadrig.single.arrays import Picture

RATE, HOUR = 30, 30
WORKERS = 2
# The plain loop takes as long for every picture: so many of them say how long.
PLAIN = 40


def encoded(pictures: list[Picture], beside: Path) -> list[tuple[int, int, bool, bytes]]:
    """Presentation and decoding time, whether a key frame, and bytes of each packet of the pictures as H.264."""
    height, width = pictures[0].shape
    options = {"crf": "18", "preset": "veryfast", "g": str(RATE)}
    packets = []
    with av.open(str(beside), "w") as container:
        stream = container.add_stream("libx264", rate=RATE, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for picture in pictures:
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(picture, format="gray").reformat(format="yuv420p"))
            )
        container.mux(stream.encode(None))
    with av.open(str(beside)) as container:
        stream = container.streams.video[0]
        for packet in container.demux(stream):
            # The last one that is given is empty, and ends the video.
            if packet.pts is not None and packet.dts is not None:
                shown, decoded = (round(time * packet.time_base * RATE) for time in (packet.pts, packet.dts))
                packets.append((shown, decoded, packet.is_keyframe, bytes(packet)))
    return packets


def write_repeated(once: Path, packets: list[tuple[int, int, bool, bytes]], frames: int, output: Path) -> None:
    """The packets again and again, as a video of at least so many frames."""
    with av.open(str(once)) as template, av.open(str(output), "w") as container:
        stream = container.add_stream_from_template(template.streams.video[0])
        for start in range(0, frames, len(packets)):
            for pts, dts, key, data in packets:
                packet = av.Packet(data)
                packet.stream, packet.time_base = stream, Fraction(1, RATE)
                packet.pts, packet.dts, packet.is_keyframe = start + pts, start + dts, key
                container.mux(packet)


def searched_tenth(paths: list[Path]) -> dict[str, float]:
    """What the chosen tenth of the videos takes."""
    opened, opening = spent(lambda: open_recording(paths))
    framesets = build_framesets(opened)
    tenth = Effort(share=0.1, workers=WORKERS)
    chosen, choosing = spent(lambda: choose_frames(opened, framesets, tenth))
    found, searching = spent(lambda: find_detections(opened, chosen, demo_scene(1).rectangles, tenth))
    return {
        "images": sum(len(camera.source) for camera in opened.cameras),
        "searched": found.searched,
        "views": len(found.views),
        "open": opening.processor,
        "choose": choosing.processor,
        "search": searching.processor,
        "passed": opening.seconds + choosing.seconds + searching.seconds,
    }


def watched(paths: list[Path]) -> dict[str, float]:
    """The same in a process of its own, with the most memory (GiB) that it and its workers held."""
    command = [sys.executable, __file__, "--tenth", *map(str, paths)]
    running = psutil.Popen(command, stdout=subprocess.PIPE)
    done, most = threading.Event(), [0]

    def watch() -> None:
        while not done.wait(0.2):
            try:
                held = [p.memory_info().rss for p in (running, *running.children(recursive=True))]
            except psutil.NoSuchProcess:
                continue
            most[0] = max(most[0], sum(held))

    watcher = threading.Thread(target=watch)
    watcher.start()
    said, _ = running.communicate()
    done.set()
    watcher.join()
    return {**json.loads(said), "memory": most[0] / 2**30}


def compare_every_image(paths: list[Path]) -> None:
    """Print what decoding, the plain loop and our search of every image take, an image each."""
    opened = open_recording(paths)
    framesets = build_framesets(opened)
    images = sum(len(camera.source) for camera in opened.cameras)
    pictures, decoding = spent(lambda: sum(1 for camera in opened.cameras for _ in camera.source.images()))
    assert pictures == images
    some = [
        picture
        for camera in opened.cameras
        for k, picture in enumerate(camera.source.images())
        if picture is not None and k % (images // PLAIN) == 0
    ]
    plain = PlainLoop(demo_scene(1).rectangles)
    _, plainly = spent(lambda: [plain(picture) for picture in some])
    _, searching = spent(
        lambda: find_detections(opened, framesets, demo_scene(1).rectangles, Effort(workers=WORKERS))
    )
    a_plain = 1000 * plainly.processor / len(some)
    a_decoding, ours = (1000 * cost.processor / images for cost in (decoding, searching))
    print(
        f"an image: decoding {a_decoding:.1f} ms, plain loop {a_plain:.1f} ms without it, our search of every image "
        f"{ours:.1f} ms with it and {ours - a_decoding:.1f} ms without: {(a_plain + a_decoding) / ours:.1f} and "
        f"{a_plain / (ours - a_decoding):.1f} times the plain loop's speed",
        flush=True,
    )


def main() -> None:
    """Encode, repeat, search, print a line for each length."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("recording", type=Path, nargs="+")
    parser.add_argument("--minutes", type=float, nargs="+", default=[0.13, 0.5, 1.0])
    parser.add_argument("--tenth", action="store_true", help="only search the chosen tenth of videos")
    asked = parser.parse_args()
    if asked.tenth:
        print(json.dumps(searched_tenth(asked.recording)))
        return
    with tempfile.TemporaryDirectory() as folder:
        once, packets = {}, {}
        for camera in open_recording(asked.recording).cameras:
            pictures = [picture for picture in camera.source.images() if picture is not None]
            once[camera.name] = Path(folder) / f"{camera.name}.mp4"
            packets[camera.name] = encoded(pictures, once[camera.name])
        compare_every_image(list(once.values()))
        rows = []
        for minutes in sorted(asked.minutes):
            paths = []
            for name, path in once.items():
                paths.append(Path(folder) / f"{minutes:g}" / f"{name}.mp4")
                paths[-1].parent.mkdir(exist_ok=True)
                write_repeated(path, packets[name], round(60 * RATE * minutes), paths[-1])
            rows.append(watched(paths))
            show(minutes, rows[-1])
            for path in paths:
                path.unlink()
        extrapolate(rows)


def show(minutes: float, row: dict[str, float]) -> None:
    """One length in a line."""
    print(
        f"{minutes:g} minutes, {row['images']:.0f} images: opened {row['open']:.1f} s, chosen {row['choose']:.1f} s, "
        f"{row['searched']:.0f} searched {row['search']:.1f} s of processor time, {row['passed']:.1f} s passed, "
        f"{row['views']:.0f} Views, most memory of all processes {row['memory']:.2f} GiB",
        flush=True,
    )


def extrapolate(rows: list[dict[str, float]]) -> None:
    """What the whole recording would take, of the growth between the two longest."""
    if len(rows) < 2:
        return
    totals = np.array([[row["images"], row["open"] + row["choose"] + row["search"]] for row in rows[-2:]])
    (images, seconds), (more, longer) = totals
    whole = longer + (longer - seconds) / (more - images) * (4 * 60 * RATE * HOUR - more)
    print(
        f"{HOUR} minutes of four cameras would take {whole:.0f} s of processor time, {whole / 2:.0f} s of two cores"
    )


if __name__ == "__main__":
    main()
