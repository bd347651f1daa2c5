"""`rig record`: videos and folders of images into one MCAP recording."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.convert import ImageFormat, MessageFormat
from quadrig.io.recording.convert import record as write_recording
from quadrig.io.recording.picture_times import with_times, without_times
from quadrig.io.recording.recorded_cameras import camera_of_pattern, open_recording
from quadrig.io.recording.time_table import with_timestamps
from quadrig.single.errors import QuadrigError


def record(
    inputs: Annotated[
        list[Path] | None, typer.Argument(help="Videos and folders of images, one camera each.", metavar="INPUT...")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="The recording to write.")] = Path("recording.mcap"),
    camera: Annotated[
        list[str] | None,
        typer.Option(
            help="A camera by name: NAME=VIDEO, NAME=FOLDER, NAME=PICTURE or NAME='PATTERN*.jpg'; repeatable."
        ),
    ] = None,
    timestamps: Annotated[
        Path | None, typer.Option(help="CSV whose header names camera, frame_index and time (or timestamp_ns).")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Pictures a second, where image files carry no time of their own.")
    ] = None,
    messages: Annotated[MessageFormat, typer.Option("--format", help="Messages: foxglove or ros2.")] = "foxglove",
    images: Annotated[
        ImageFormat, typer.Option(help="How decoded videos are stored: jpeg, or png to the bit.")
    ] = "jpeg",
    quality: Annotated[int, typer.Option(min=50, max=100, help="Quality of JPEG.")] = 95,
) -> None:
    """Turn videos and folders of images into one MCAP recording.

    Images of JPEG and PNG files are copied as they are. Image k of every camera is the same instant, k being the
    number in its file's name.

    Examples: rig record cam0.mp4 cam1.mp4 -o room.mcap;
    rig record --camera left='left*.jpg' --camera right='right*.jpg' -o stereo.mcap
    """
    notes: list[str] = []
    cameras: list[RecordedCamera] = []
    if inputs:
        # A table replaces whatever times there are.
        opened = open_recording(inputs, rate=rate if timestamps is None else 1.0)
        cameras, notes = list(opened.cameras), list(opened.notes)
    if camera:
        cameras = [without_times(one) for one in cameras] + [_named_camera(given, notes) for given in camera]
    if not cameras:
        raise QuadrigError("nothing to record; name videos or folders of images, or give --camera NAME=PATTERN")
    names = [one.name for one in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise QuadrigError(f"two cameras are called {twice!r}; name them with --camera NAME=VIDEO")
    if timestamps is not None:
        cameras = with_timestamps(cameras, timestamps)
    elif camera:
        cameras = with_times(cameras, rate, notes)
    untimed = [one.name for one in cameras if not one.source.timed and one.frames > 1]
    if untimed:
        notes.append(f"{', '.join(untimed)}: written as one picture a second, for want of a time; give --rate")
    for note in dict.fromkeys(notes):
        print(f"note: {note}", file=sys.stderr)
    done = write_recording(cameras, output, messages, images, quality)
    for one in cameras:
        print(
            f"{one.name}: {done.images[one.name]} images {one.width}x{one.height}, {done.encoded.get(one.name, '')}"
        )
    if done.unreadable:
        print(f"{done.unreadable} images could not be read and were skipped")
    print(f"{output}: {done.bytes / 1e6:.1f} MB")


def _named_camera(given: str, notes: list[str]) -> RecordedCamera:
    name, equals, where = given.partition("=")
    if not (name and equals and where):
        raise QuadrigError(f"--camera {given}: give NAME=VIDEO, NAME=FOLDER, NAME=PICTURE or NAME='PATTERN*.jpg'")
    if not Path(where).exists():
        return camera_of_pattern(name, Path(where).parent, Path(where).name, notes)
    opened = open_recording([Path(where)])
    if len(opened.cameras) != 1:
        raise QuadrigError(f"--camera {given}: there are {len(opened.cameras)} cameras in {where}; give one")
    notes += opened.notes
    return replace(without_times(opened.cameras[0]), name=name)
