"""The report: a rig and its evidence as one HTML page that needs no network and no program but a browser."""

from html import escape

import numpy as np

from quadrig.io.drawing.palette import hexadecimal, rig_colours
from quadrig.io.report import plots
from quadrig.io.rig_file.rig_mcap import RigFile
from quadrig.rig.doubt.residual_field import residual_field
from quadrig.rig.doubt.verdict import PATTERN, verdict
from quadrig.rig.doubt.weaknesses import coverage
from quadrig.rig.result import Camera, Rig
from quadrig.rig.words import figure, length

_STYLE = """
:root { color-scheme: light dark; --ink: #222; --ground: #fafafa; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1120px; margin: 2em auto; padding: 0 1em;
  color: var(--ink); background: var(--ground); }
h1 { font-size: 1.5em; } h2 { font-size: 1.2em; margin-top: 2em; } h3 { font-size: 1.05em; margin-bottom: 0.3em; }
.verdict { padding: 0.8em 1.2em; border-left: 8px solid; border-radius: 6px; background: #8881; }
.good { border-color: #2a9d4e; } .care { border-color: #e0a020; } .not { border-color: #d03030; }
figure { margin: 0; } figcaption { font-size: 0.9em; opacity: 0.8; }
.row { display: flex; flex-wrap: wrap; gap: 1.2em; align-items: flex-start; }
svg { max-width: 100%; height: auto; fill: currentColor; } svg text { font: 11px system-ui, sans-serif; }
.name { paint-order: stroke; stroke: var(--ground); stroke-width: 3px; stroke-linejoin: round; }
table { border-collapse: collapse; margin: 0.6em 0; } td, th { padding: 0.2em 0.9em 0.2em 0; text-align: right; }
td:first-child, th:first-child { text-align: left; } th { font-weight: 600; border-bottom: 1px solid #8888; }
@media (prefers-color-scheme: dark) { :root { --ink: #ddd; --ground: #16181d; } }
"""
_CLASSES = {"good": "good", "with care": "care", "not yet": "not"}


def report_html(held: RigFile) -> str:
    """The whole page."""
    rig = held.rig
    parts = [_verdict(rig), _cameras_table(rig), _room(rig), _evidence(rig)]
    parts += [_camera(rig, camera) for camera in rig.cameras]
    parts += [_lens_only(rig), *(_camera(own, camera) for own, camera in rig.lens_only)]
    parts.append(f"<p><small>quadrig {escape(held.version)}; one sigma throughout.</small></p>")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(_title(rig))}</title><style>{_STYLE}</style></head>"
        f"<body>{''.join(parts)}</body></html>\n"
    )


def _title(rig: Rig) -> str:
    return f"Rig of {len(rig.cameras)} cameras" if len(rig.cameras) > 1 else f"Camera {next(iter(rig.cameras)).name}"


def _verdict(rig: Rig) -> str:
    held = verdict(rig)
    return (
        f"<h1>{escape(_title(rig))}</h1>"
        f'<div class="verdict {_CLASSES[held.grade]}" id="verdict"><h2 style="margin-top:0">{escape(held.headline)}'
        f"</h2><p>Because:</p>{_items(held.good)}"
        + (f"<p>What is weak, and what to do:</p>{_items(held.weak)}" if held.weak else "<p>Nothing is weak.</p>")
        + "</div>"
    )


def _lens_only(rig: Rig) -> str:
    """The heading of the cameras that have a lens and no pose."""
    if not rig.apart:
        return ""
    words = "These cameras share no rectangle at one time with those of the rig: lenses are known, poses are not."
    return f"<h2>Lens only</h2><p>{words}</p>"


def _items(sentences: tuple[str, ...]) -> str:
    return "<ul>" + "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences) + "</ul>"


def _cameras_table(rig: Rig) -> str:
    heads = (
        "camera",
        "focal px",
        "position m",
        "± position",
        "± rotation",
        "RMS px",
        "held out px",
        "Views",
        "covered",
    )
    cover = coverage(rig)
    rows = [_table_row(rig, camera, cover[camera.name]) for camera in rig.cameras]
    return (
        f"<h2>Cameras</h2><p>Positions in the rig frame, that of {escape(rig.reference)}: x right, y down, z ahead "
        "where it is a camera.</p><table><tr>"
        + "".join(f"<th>{head}</th>" for head in heads)
        + f"</tr>{''.join(rows)}</table>"
    )


def _table_row(rig: Rig, camera: Camera, cover: float) -> str:
    name, position = camera.name, camera.rig_from_camera.translation
    cells = [
        f'<span style="color:{hexadecimal(rig_colours(rig)[name])}">●</span> {escape(name)}',
        f"{camera.intrinsics.focal:.2f} ± {figure(rig.focal_sigma(name), 2)}",
        " ".join(f"{value:.4f}" for value in position.round(4) + 0.0),
        length(rig.position_sigma(name)),
        f"{figure(np.degrees(rig.rotation_sigma(name)), 4)}°",
        _figure(camera.rms),
        _figure(camera.held_out_rms),
        str(camera.views),
        f"{100 * cover:.0f} %",
    ]
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _room(rig: Rig) -> str:
    plan = plots.level_view(rig, (0, 1), "the rig from above", ("right m", "ahead m"))
    side = plots.level_view(rig, (0, 2), "the rig from behind", ("right m", "up m"))
    return (
        "<h2>The rig</h2>"
        + _row(("From above.", plan), ("From behind the cameras.", side))
        + f"<p>{escape(plots.doubt_sentence(rig))} Up is where the pictures have it. Grey rectangles stand, green "
        "ones were moved.</p>"
    )


def _evidence(rig: Rig) -> str:
    graph = ("Who saw what: thick lines carry more, red ones disagree.", plots.graph(rig))
    cycles = (
        "Views against the rig, in their own sigmas; above the line they contradict it.",
        plots.cycle_errors(rig),
    )
    out = ("RMS of the fit, and of framesets held out of it.", plots.held_out(rig))
    steps = ("The adjustment, step by step; it starts again where outliers are rejected.", plots.steps(rig))
    return f"<h2>Evidence</h2>{_row(graph, cycles)}{_row(out, steps)}"


def _camera(rig: Rig, camera: Camera) -> str:
    lens, held = camera.intrinsics, residual_field(rig, camera.name)
    distortion = " ".join(f"{value:.4f}" for value in lens.distortion)
    sentences = [
        f"{lens.width}x{lens.height}, {lens.model}: focal {lens.focal:.2f} ± "
        f"{figure(rig.focal_sigma(camera.name), 2)} px, "
        f"principal point {lens.principal_point[0]:.1f} {lens.principal_point[1]:.1f}, distortion {distortion}."
    ]
    if camera.lens_reason:
        sentences.append(f"Lens: {camera.lens_reason}.")
    if np.isfinite(held.pattern):
        fits = "no pattern" if held.pattern < PATTERN else "a pattern"
        sentences.append(
            f"Residuals of different poses agree {held.pattern:.1f} times as much as chance has it: {fits}."
        )
    words = "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)
    field = ("Residuals and coverage: a pattern means that the lens does not fit.", plots.field(rig, camera))
    return f"<h3>{escape(camera.name)}</h3>{words}" + _row(field, ("Their lengths.", plots.histogram(rig, camera)))


def _row(*figures: tuple[str, str]) -> str:
    drawn = (f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>" for caption, svg in figures)
    return f'<div class="row">{"".join(drawn)}</div>'


def _figure(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"
