"""What the report says of one camera: its lens by name, its pose, and where its residuals lie."""

from html import escape

import numpy as np

from quadrig.io.drawing.rig_figures import arrow_scale
from quadrig.io.drawing.tables import html_table
from quadrig.io.report import plots
from quadrig.io.report.figures import figures
from quadrig.rig.doubt.residual_field import residual_field
from quadrig.rig.doubt.verdict import PATTERN
from quadrig.rig.doubt.weaknesses import clock_offsets
from quadrig.rig.result import Camera, Rig, line_time
from quadrig.rig.words import Column, with_sigma
from quadrig.single.lens import DISTORTION_NAMES
from quadrig.single.rotation import angles_from_rotation


def camera_section(rig: Rig, camera: Camera) -> str:
    """Words, tables and plots of one camera, below its name."""
    words = "".join(f"<p>{escape(sentence)}</p>" for sentence in _sentences(rig, camera))
    tables = html_table(_lens_columns(rig, camera))
    if camera.name != rig.reference:
        tables += html_table(_pose_columns(rig, camera))
    field = (
        f"Residuals, drawn {arrow_scale(rig):.0f} times longer in every camera, and in blue where corners were: a "
        "pattern means that the lens does not fit."
    )
    drawn = figures((field, plots.field(rig, camera)), ("How long they are.", plots.histogram(rig, camera)))
    return (
        f'<section class="camera"><h3>{escape(camera.name)}</h3>{words}<div class="parts">'
        f'<div class="tables">{tables}</div>{drawn}</div></section>'
    )


def _sentences(rig: Rig, camera: Camera) -> list[str]:
    lens, held = camera.intrinsics, residual_field(rig, camera.name)
    reason = f"; {camera.lens_reason}" if camera.lens_reason else ""
    sentences = [f"{lens.width} x {lens.height} px, {lens.model}{reason}."]
    if camera.name == rig.reference and len(rig.cameras) > 1:
        sentences[0] += " Its frame is the rig frame."
    if np.isfinite(held.pattern):
        fits = "no pattern, the lens fits" if held.pattern < PATTERN else "a pattern, the lens does not fit"
        sentences.append(
            f"Residuals of different poses agree {held.pattern:.1f} times as much as chance has it: {fits}."
        )
    base, offsets = clock_offsets(rig)
    if camera.name in offsets and camera.name != base:
        late, sigma = offsets[camera.name]
        sentences.append(
            f"Its pictures were taken {with_sigma(1e3 * abs(late), 1e3 * sigma)} ms "
            f"{'later' if late > 0 else 'earlier'} than those of {base} with the same stamp."
        )
    if np.isfinite(camera.line_time):
        since = "as given" if camera.line_time_sigma == 0 else "as what moved shows"
        sentences.append(f"Its rows were taken {line_time(camera)} µs after one another, {since}.")
    elif rig.fits:
        sentences.append("How long after one another its rows were taken is not known: too little moved.")
    return sentences


def _lens_columns(rig: Rig, camera: Camera) -> list[Column]:
    lens, names = camera.intrinsics, DISTORTION_NAMES[camera.intrinsics.model]
    sigmas = np.sqrt(np.diag(rig.lens_covariance(camera.name)))
    rows = [("focal px", lens.focal, 0), ("centre x px", lens.principal_point[0], 1)]
    rows += [("centre y px", lens.principal_point[1], 2), ("aspect", lens.aspect, 8)]
    rows += [(name, lens.distortion[index], 3 + index) for index, name in enumerate(names)]
    return _rows("lens", [(name, float(value), float(sigmas[index])) for name, value, index in rows])


def _pose_columns(rig: Rig, camera: Camera) -> list[Column]:
    """Position, and rotation as the angles of R = Rx Ry Rz (Eq. 6), each with its sigma in the rig frame."""
    pose, sigmas = camera.rig_from_camera, np.sqrt(np.diag(rig.pose_covariance(camera.name)))
    angles = np.degrees(np.array(angles_from_rotation(pose.rotation)))
    turn = float(np.degrees(rig.rotation_sigma(camera.name)))
    rows = [(f"{axis} m", float(pose.translation[i]), float(sigmas[3 + i])) for i, axis in enumerate("xyz")]
    return _rows("pose", [*rows, *((f"θ{axis} deg", float(angles[i]), turn) for i, axis in enumerate("xyz"))])


def _rows(title: str, rows: list[tuple[str, float, float]]) -> list[Column]:
    """Names, values and sigmas below one another, each value to its sigma's second digit."""
    parts = [with_sigma(value + 0.0, sigma).split(" ± ") for _, value, sigma in rows]
    return [
        Column(title, "", tuple(name for name, *_ in rows), words=True),
        Column("value", "", tuple(value for value, _ in parts)),
        Column("±", "", tuple(sigma for _, sigma in parts)),
    ]
