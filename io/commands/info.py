"""`rig info`: what a recording holds, which topics are cameras, what would be used."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from quadrig.io.file_kind import RIG, file_kind
from quadrig.io.plain_words import console
from quadrig.io.report.terminal import print_sentence, print_table
from quadrig.rig.words import Column
from quadrig.single.errors import QuadrigError

if TYPE_CHECKING:
    from quadrig.io.recording.camera import RecordedCamera
    from quadrig.io.recording.framesets import CameraReport, Framesets
    from quadrig.io.recording.recorded_cameras import Recording


def info(
    recording: Annotated[list[Path], typer.Argument(help="MCAP files, videos or folders.", metavar="RECORDING")],
    tolerance: Annotated[float | None, typer.Option(help="Most that stamps of one instant differ, seconds.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Show what is in a recording, which topics are cameras and what would be used; or what a rig.mcap holds.

    Images are grouped by the time of their recording here, which is quick; calibrate goes by their own stamps.

    Example: rig info room.mcap
    """
    if len(recording) == 1 and recording[0].is_file() and file_kind(recording[0]) == RIG:
        _print_rig(recording[0], as_json)
        return
    # Loaded when they are used: a rig is shown without them.
    from quadrig.io.recording.framesets import build_framesets
    from quadrig.io.recording.recorded_cameras import open_recording

    try:
        opened = open_recording(recording)
    except QuadrigError:
        from quadrig.io.rig_file.rig_mcap import is_rig_file

        # What another program copied no longer says in its first bytes whose it is.
        if len(recording) == 1 and is_rig_file(recording[0]):
            _print_rig(recording[0], as_json)
            return
        raise
    framesets = build_framesets(opened, tolerance, quick=True)
    if as_json:
        from quadrig.io.formats.rig_json import json_text

        print(json_text(_as_json(opened, framesets)))
        return
    _print(opened, framesets)


def _print_rig(path: Path, as_json: bool) -> None:
    from quadrig.io.rig_file.rig_mcap import read_rig

    rig = read_rig(path)
    if as_json:
        from quadrig.io.formats.rig_json import json_text, rig_values

        print(json_text(rig_values(rig)))
        return
    from quadrig.io.report.table import print_rig

    print_rig(rig)


def _as_json(recording: "Recording", framesets: "Framesets") -> dict[str, Any]:
    offsets = dict(zip(framesets.cameras, clock_offsets(framesets.report), strict=True))
    reports = {report.camera: report for report in framesets.report}
    return {
        "paths": [str(path) for path in recording.paths],
        "indexed": recording.indexed,
        "seconds": _seconds(framesets),
        "cameras": {
            camera.name: _camera_json(camera, reports[camera.name], offsets[camera.name])
            for camera in recording.cameras
        },
        "framesets": {
            "count": len(framesets),
            "tolerance_s": framesets.tolerance,
            "shared": int(sum(framesets.sizes() > 1)),
            "complete": int(sum(framesets.sizes() == len(framesets.cameras))),
        },
        "other_topics": [
            {"topic": topic, "schema": schema, "messages": count} for topic, schema, count in recording.other_topics
        ],
        "notes": list(recording.notes),
    }


def _camera_json(camera: "RecordedCamera", report: "CameraReport", offset: float | None) -> dict[str, Any]:
    prior = camera.prior
    return {
        "topic": camera.topic,
        "encoding": camera.encoding,
        "width": camera.width,
        "height": camera.height,
        "frames": camera.frames,
        "rate_hz": _rate(camera),
        "used": report.used,
        "dropped": report.dropped,
        "median_offset_s": offset,
        "prior_focal_px": None if prior is None else prior.focal,
    }


def _columns(recording: "Recording", framesets: "Framesets") -> list[Column]:
    cameras, reports = recording.cameras, framesets.report
    rates, offsets = [_rate(camera) for camera in cameras], clock_offsets(reports)
    priors = [camera.prior for camera in cameras]
    return [
        Column("camera", "", tuple(camera.name for camera in cameras), words=True),
        Column("images", "", tuple(str(camera.frames) for camera in cameras)),
        Column("rate", "Hz", tuple("" if rate is None else f"{rate:.2f}" for rate in rates)),
        Column("used", "", tuple(str(report.used) for report in reports)),
        Column("dropped", "", tuple(str(report.dropped) for report in reports)),
        Column("later", "ms", tuple("" if late is None else f"{1e3 * late:.1f}" for late in offsets)),
        Column("size", "px", tuple(f"{camera.width}x{camera.height}" for camera in cameras)),
        Column("stored as", "", tuple(camera.encoding for camera in cameras), words=True),
        Column("focal given", "px", tuple("no" if prior is None else f"{prior.focal:.1f}" for prior in priors)),
        Column("topic", "", tuple(camera.topic for camera in cameras), words=True),
    ]


def clock_offsets(reports: "Sequence[CameraReport]") -> list[float | None]:
    """By how much the stamps of one instant come after those of the first camera, s; None where there are none."""
    first = next((report.offset for report in reports if report.used), 0.0)
    return [report.offset - first + 0.0 if report.used else None for report in reports]


def _print(recording: "Recording", framesets: "Framesets") -> None:
    where = console()
    print_table(_columns(recording, framesets), where)
    where.print()
    sizes, whole = framesets.sizes(), len(framesets.cameras)
    sentences = [
        f"{len(framesets)} framesets over {_seconds(framesets):.1f} s, "
        f"{sum(sizes == whole)} with all {whole} cameras, {sum(sizes > 1)} with more than one; "
        f"what is up to {1e3 * framesets.tolerance:.1f} ms apart counts as one instant"
    ]
    if whole > 1:
        first = framesets.cameras[0]
        sentences.append(f"later: by how much the stamps of one instant come after those of {first}")
    sentences += [
        f"not used: {topic} ({schema}, {count} messages)" for topic, schema, count in recording.other_topics
    ]
    for sentence in (*sentences, *(f"note: {note}" for note in recording.notes)):
        print_sentence(sentence, where)


def _rate(camera: "RecordedCamera") -> float | None:
    """Images a second; None where their times say nothing."""
    stamps = camera.source.quick_stamps()
    span = (int(stamps.max()) - int(stamps.min())) / 1e9 if len(stamps) else 0.0
    return (len(stamps) - 1) / span if span > 0 else None


def _seconds(framesets: "Framesets") -> float:
    return (float(framesets.times[-1]) - float(framesets.times[0])) / 1e9 if len(framesets) else 0.0
