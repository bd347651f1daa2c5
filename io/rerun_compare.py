"""Two rigs in one space in rerun: the first in colour, the second thin and pale, arrows from one to the other."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from quadrig.rig.compare import Comparison
from quadrig.rig.result import Rig
from quadrig.rig.verdict import length

from .palette import FAULT, rig_colours
from .rig_geometry import apart, extent, first_eye, positions

_PALE = (170, 170, 180)


def log_comparison(recording: Any, first: Rig, second: Rig, found: Comparison, sentences: Sequence[str]) -> None:
    """Log both rigs, the second aligned, and the differences in words."""
    import rerun as rr

    colours, size = rig_colours(first), extent(first)
    recording.log("space", rr.ViewCoordinates.RDF, static=True)
    for which, rig in (("first", first), ("second", second)):
        for camera in rig.cameras:
            pose = camera.rig_from_camera if which == "first" else found.first_from_second @ camera.rig_from_camera
            path, lens = f"space/{which}/{camera.name}", camera.intrinsics
            transform = rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation)
            recording.log(path, transform, static=True)
            pinhole = rr.Pinhole(
                image_from_camera=lens.camera_matrix,
                resolution=[lens.width, lens.height],
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.1 * size,
                color=colours.get(camera.name, _PALE) if which == "first" else _PALE,
                line_width=(0.003 if which == "first" else 0.0015) * size,
            )
            recording.log(path, pinhole, static=True)
    places = apart(first_eye(first), [camera.name for camera in first.cameras], positions(first))
    names = [camera.name for camera in first.cameras]
    shades = [colours[name] for name in names]
    labels = rr.Points3D(places, radii=rr.Radius.ui_points(1.5), colors=shades, labels=names, show_labels=True)
    recording.log("space/names", labels, static=True)
    scale = _arrow_scale(first, found)
    origins = [first.camera(one.name).rig_from_camera.translation for one in found.cameras]
    vectors = [scale * one.step[3:] for one in found.cameras]
    arrows = rr.Arrows3D(origins=origins, vectors=vectors, colors=[FAULT], radii=0.003 * size)
    recording.log("space/shifts", arrows, static=True)
    text = rr.TextDocument(_markdown(found, sentences, scale), media_type="text/markdown")
    recording.log("summary", text, static=True)


def _arrow_scale(rig: Rig, found: Comparison) -> float:
    longest = max((one.shift for one in found.cameras), default=0.0)
    if not longest > 0:
        return 1.0
    return max(float(10.0 ** np.floor(np.log10(0.15 * extent(rig) / longest))), 1.0)


def _markdown(found: Comparison, sentences: Sequence[str], scale: float) -> str:
    rows = [
        f"| {one.name} | {one.focal:+.2f} ± {one.focal_sigma:.2f} | {length(one.shift)} ± {length(one.shift_sigma)} "
        f"| {np.degrees(one.turn):.4f} ± {np.degrees(one.turn_sigma):.4f} | {one.sigmas:.1f} |"
        for one in found.cameras
    ]
    head = ["| camera | focal px | position | turn degrees | sigmas |", "|---|---|---|---|---|"]
    note = f"First in colour, second pale; arrows: shifts, drawn {scale:.0f} times longer."
    return "\n".join([f"## {sentences[0]}", "", *sentences[1:], "", *head, *rows, "", note])
