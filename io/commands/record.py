"""`rig record`: videos and folders of images into one MCAP recording."""

from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.recording.convert import ImageFormat, MessageFormat, with_timestamps
from quadrig.io.recording.convert import record as write_recording
from quadrig.io.recording.recorded_cameras import RecordedCamera, camera_of_pattern, camera_of_source, open_recording
from quadrig.single.errors import QuadrigError


def record(
    inputs: Annotated[
        list[Path] | None, typer.Argument(help="Videos and folders of images, one camera each.", metavar="INPUT...")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="The recording to write.")] = Path("recording.mcap"),
    camera: Annotated[
        list[str] | None,
        typer.Option(help="A camera by name: NAME=VIDEO, NAME=FOLDER or NAME='PATTERN*.jpg'; may be repeated."),
    ] = None,
    timestamps: Annotated[
        Path | None, typer.Option(help="CSV with cam_id, frame_index and frame_time in seconds.")
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
    cameras = list(open_recording(inputs).cameras) if inputs else []
    cameras += [_named_camera(given) for given in camera or []]
    if not cameras:
        raise QuadrigError("nothing to record; name videos or folders of images, or give --camera NAME=PATTERN")
    names = [one.name for one in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise QuadrigError(f"two cameras are called {twice!r}; name them with --camera NAME=VIDEO")
    if timestamps is not None:
        cameras = with_timestamps(cameras, timestamps)
    done = write_recording(cameras, output, messages, images, quality)
    for one in cameras:
        print(
            f"{one.name}: {done.images[one.name]} images {one.width}x{one.height}, {done.encoded.get(one.name, '')}"
        )
    if done.unreadable:
        print(f"{done.unreadable} images could not be read and were skipped")
    print(f"{output}: {done.bytes / 1e6:.1f} MB")


def _named_camera(given: str) -> RecordedCamera:
    name, equals, where = given.partition("=")
    if not (name and equals and where):
        raise QuadrigError(f"--camera {given}: give NAME=VIDEO, NAME=FOLDER or NAME='PATTERN*.jpg'")
    if Path(where).exists():
        found = open_recording([Path(where)]).cameras
        if len(found) != 1:
            raise QuadrigError(f"--camera {given}: there are {len(found)} cameras in {where}; give one")
        return camera_of_source(name, found[0].topic, found[0].source)
    folder, pattern = Path(where).parent, Path(where).name
    return camera_of_pattern(name, folder, pattern)
