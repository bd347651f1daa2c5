"""`rig record`: live cameras, or videos and folders of images, into one MCAP recording."""

import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.config.rig_toml import RigConfig, read_config
from quadrig.io.live.capture.chosen_sources import is_live, named_sources
from quadrig.io.live.capture.source import SourceState
from quadrig.io.live.capture.source_spec import SourceSpec
from quadrig.io.live.record.record_sources import record_sources
from quadrig.io.live.terminal import enter_pressed
from quadrig.io.recording.camera import RecordedCamera, camera_of_source
from quadrig.io.recording.convert import ImageFormat, MessageFormat
from quadrig.io.recording.convert import record as write_recording
from quadrig.io.recording.image_folder import folder_images, image_files
from quadrig.io.recording.picture_times import with_times, without_times
from quadrig.io.recording.recorded_cameras import camera_of_pattern, open_recording
from quadrig.io.recording.time_table import with_timestamps
from quadrig.io.verbosity import is_quiet, note
from quadrig.io.whole_file import refuse_no_place
from quadrig.single.errors import QuadrigError

_NAMED = re.compile(r"[A-Za-z0-9_.-]+=")


def record(
    inputs: Annotated[
        list[str] | None,
        typer.Argument(
            help="Live cameras: a number, /dev/video0, rtsp://..., http://... or watch:FOLDER. Or what was recorded: "
            "videos, folders, bags, or a pattern such as 'camera_{camera}_*.jpg'. Else the sources of rig.toml.",
            metavar="[NAME=]SOURCE",
        ),
    ] = None,
    config: Annotated[Path, typer.Option(help="The rig.toml with the sources, where none is named.")] = Path(
        "rig.toml"
    ),
    output: Annotated[Path, typer.Option("--output", "-o", help="The recording to write.")] = Path("recording.mcap"),
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Record live cameras so long; else until Enter or Ctrl-C.")
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Record again over a recording that is there.")] = False,
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
    """Record live cameras, or turn videos, folders of images and bags into one MCAP recording.

    Live cameras are recorded as they come, until Enter, Ctrl-C or --seconds. Images of JPEG and PNG files are copied
    as they are; which of them are of one instant is known by the numbers in their names, their EXIF, --rate or
    --timestamps, and said.

    Examples: rig record --config rig.toml -o room.mcap; rig record left=0 right=1 --seconds 60 -o room.mcap;
    rig record cam0.mp4 cam1.mp4 -o room.mcap;
    rig record --camera left='left*.jpg' --camera right='right*.jpg' -o stereo.mcap
    """
    refuse_no_place(output)
    if output.exists() and not again:
        raise QuadrigError(f"{output} is there already; name another with -o, or record over it with --again")
    texts = [*(inputs or []), *(camera or [])]
    if any(map(is_live, texts)):
        if messages != "foxglove":
            raise QuadrigError("live cameras are recorded with --format foxglove; turn the recording into ros2 later")
        _record_live(named_sources(texts, RigConfig(()), Path()), output, seconds)
        return
    if not texts:
        described = read_config(config)
        sources = named_sources([], described, config.parent)
        if any(spec.live for spec in sources.values()):
            _record_live(sources, output, seconds, {"rig.toml": described.text.encode()})
            return
        camera = [f"{name}={spec.address}" for name, spec in sources.items()]
    named = [text for text in inputs or [] if _NAMED.match(text) and not Path(text).exists()]
    unnamed = [text for text in inputs or [] if text not in named]
    _convert(unnamed, [*named, *(camera or [])], output, timestamps, rate, messages, images, quality)


def _record_live(
    sources: dict[str, SourceSpec],
    output: Path,
    seconds: float | None,
    attachments: dict[str, bytes] | None = None,
) -> None:
    files = [name for name, spec in sources.items() if not spec.live]
    if files:
        raise QuadrigError(f"{files[0]!r} is a file and others are live cameras; record them one after the other")
    done = record_sources(sources, output, _stop(seconds), _Lines().show, attachments)
    for one in done.sources:
        size = f"{one.width}x{one.height}, {one.frames / max(done.seconds, 1e-9):.1f} a second"
        print(
            f"{one.name}: {one.frames} images {size}" if one.frames else f"{one.name} gave no picture: {one.detail}"
        )
        if one.left_out:
            print(f"{one.name}: {one.left_out} images left out, of another size or scene than those before")
    if done.dropped:
        print(f"{done.dropped} images were not recorded: the disk could not keep up")
    print(f"{output}: {output.stat().st_size / 1e6:.1f} MB, {done.ending}")


def _stop(seconds: float | None) -> Callable[[], str]:
    pressed, until = enter_pressed(), None if seconds is None else time.monotonic() + seconds

    def stop() -> str:
        return f"{seconds:g} s are over" if until is not None and time.monotonic() > until else pressed()

    return stop


class _Lines:
    """How the sources do, on stderr: in one line that is written over, or where it is no terminal, what changes."""

    _EVERY = 0.5

    def __init__(self) -> None:
        self._shown, self._conditions = 0.0, {}
        self._terminal = sys.stderr.isatty()

    def show(self, states: Sequence[SourceState]) -> None:
        if is_quiet():
            return
        if self._terminal and time.monotonic() - self._shown > self._EVERY:
            self._shown = time.monotonic()
            line = "   ".join(f"{one.name} {one.frames} ({one.rate:.0f}/s, {one.condition})" for one in states)
            print(f"\r{line}   Enter or Ctrl-C stops", end="\033[K", file=sys.stderr, flush=True)
        for one in states:
            if self._conditions.get(one.name) == one.condition:
                continue
            self._conditions[one.name] = one.condition
            if not self._terminal or one.condition == "changed":
                clean = "\r\033[K" if self._terminal else ""
                print(f"{clean}{one.sentence}", file=sys.stderr, flush=True)


def _convert(
    inputs: list[str],
    camera: list[str],
    output: Path,
    timestamps: Path | None,
    rate: float | None,
    messages: MessageFormat,
    images: ImageFormat,
    quality: int,
) -> None:
    notes: list[str] = []
    cameras: list[RecordedCamera] = []
    if inputs:
        # A table replaces whatever times there are.
        opened = open_recording(inputs, rate=rate if timestamps is None else 1.0)
        cameras, notes = list(opened.cameras), list(opened.notes)
    if camera:
        cameras = [without_times(one) for one in cameras] + [_named_camera(given, notes) for given in camera]
    names = [one.name for one in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise QuadrigError(f"two cameras are called {twice!r}; name them with --camera NAME=VIDEO")
    if timestamps is not None:
        cameras = with_timestamps(cameras, timestamps, notes)
    elif camera:
        cameras = with_times(cameras, rate, notes)
    untimed = [one.name for one in cameras if not one.source.timed and one.frames > 1]
    if untimed:
        notes.append(f"{', '.join(untimed)}: written as one picture a second, for want of a time; give --rate")
    for remark in dict.fromkeys(notes):
        note(remark)
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
    if Path(where).is_dir() and (pictures := folder_images(Path(where))):
        return camera_of_source(name, where, image_files(pictures, f"camera {name!r}", notes))
    opened = open_recording([Path(where)])
    if len(opened.cameras) != 1:
        raise QuadrigError(f"--camera {given}: there are {len(opened.cameras)} cameras in {where}; give one")
    notes += opened.notes
    return replace(without_times(opened.cameras[0]), name=name)
