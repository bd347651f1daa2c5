"""The report: a rig and its evidence as one HTML page that needs no network and no program but a browser."""

from datetime import UTC, datetime
from html import escape

from quadrig.io.drawing.palette import hexadecimal, rig_colours
from quadrig.io.drawing.tables import html_table
from quadrig.io.drawing.things import things
from quadrig.io.plain_words import plain
from quadrig.io.report import plots
from quadrig.io.report.body_section import body_section
from quadrig.io.report.camera_section import camera_section
from quadrig.io.report.figures import figures
from quadrig.io.report.style import STYLE
from quadrig.io.report.table import lens_figures, summary
from quadrig.io.rig_file.rig_mcap import RigFile
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.result import Rig, camera_columns, lens_columns
from quadrig.rig.words import ONE_SIGMA

_CLASSES = {"good": "good", "with care": "care", "not yet": "not"}
_POSES = (
    "A point p of a camera's frame (x right, y down, z ahead) is R p + (x, y, z) in the rig frame, with "
    "R = Rx(θx) Ry(θy) Rz(θz)."
)
# Stamps below a year are counted from the start of a recording, not from 1970.
_A_YEAR = 365 * 86_400 * 10**9


def report_html(held: RigFile, name: str = "") -> str:
    """The whole page. name: of the rig's file."""
    rig = held.rig
    parts = [_head(held, name), _verdict(rig), _cameras_table(rig)]
    parts += [_placed(rig)] if len(rig.cameras) > 1 else []
    parts += [body_section(rig, body) for body in rig.bodies]
    parts += [
        _evidence(rig),
        f"<h2>Each camera</h2><p>{_POSES}</p>",
        *(camera_section(rig, camera) for camera in rig.cameras),
    ]
    parts += [_lens_only(rig), *(camera_section(own, camera) for own, camera in rig.lens_only)]
    if held.config_text:
        parts.append(f"<h2>The rig.toml</h2><pre>{escape(held.config_text.strip())}</pre>")
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="generator" content="quadrig">'
        f"<title>{escape(_title(rig, name))}</title><style>{STYLE}</style></head>"
        f"<body>{''.join(parts)}</body></html>\n"
    )
    # What is in names is shown, and neither turns the page's writing nor breaks its encoding.
    return plain(page)


def _title(rig: Rig, name: str) -> str:
    what = f"Rig of {len(rig.cameras)} cameras" if len(rig.cameras) > 1 else f"Camera {next(iter(rig.cameras)).name}"
    return f"{what}: {name}" if name else what


def _head(held: RigFile, name: str) -> str:
    recorded = f"calibrated from {', '.join(held.recordings)}" if held.recordings else ""
    words = [part for part in (recorded, _recorded(held.times), f"quadrig {held.version}") if part.strip()]
    return f'<h1>{escape(_title(held.rig, name))}</h1><p class="source">{escape(", ".join(words))}</p>'


def _recorded(times: tuple[int, ...]) -> str:
    """When, in words; empty where the stamps are no times of day."""
    if not times or min(times) < _A_YEAR:
        return ""
    first, last = (datetime.fromtimestamp(time / 1e9, UTC) for time in (min(times), max(times)))
    end = f"{last:%H:%M:%S}" if first.date() == last.date() else f"{last:%Y-%m-%d %H:%M:%S}"
    return f"recorded {first:%Y-%m-%d %H:%M:%S} to {end} UTC"


def _verdict(rig: Rig) -> str:
    held = verdict(rig)
    weak = f"<h3>What is weak, and what to do</h3>{_items(held.weak)}" if held.weak else "<p>Nothing is weak.</p>"
    return (
        f'<div class="verdict {_CLASSES[held.grade]}" id="verdict"><h2>{escape(held.headline)}</h2>'
        f"<p>{escape(held.holds)}</p><h3>Why</h3>{_items(held.good)}{weak}</div>"
    )


def _lens_only(rig: Rig) -> str:
    """The heading of the cameras that have a lens and no pose."""
    if not rig.apart:
        return ""
    words = "These cameras share no rectangle at one time with those of the rig: lenses are known, poses are not."
    columns = [*lens_columns(rig.lens_only), *lens_figures(rig.lens_only)]
    return f"<h2>Lens only</h2><p>{words}</p>{html_table(columns)}"


def _items(sentences: tuple[str, ...]) -> str:
    return "<ul>" + "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences) + "</ul>"


def _cameras_table(rig: Rig) -> str:
    every = [(rig, camera) for camera in rig.cameras]
    columns = [*(camera_columns(rig) if len(every) > 1 else lens_columns(every)), *lens_figures(every)]
    marks = [f'<span style="color:{hexadecimal(colour)}">●</span>' for colour in rig_colours(rig).values()]
    return f"<h2>Cameras</h2><p>{escape(summary(rig))}. {ONE_SIGMA}</p>{html_table(columns, marks)}"


def _placed(rig: Rig) -> str:
    plan = plots.level_view(rig, (0, 1), "the rig from above", ("right, m", "ahead, m"))
    side = plots.level_view(rig, (0, 2), "the rig from behind", ("right, m", "up, m"))
    drawn = figures(("From above.", plan), ("From behind the cameras.", side))
    moved = " Grey rectangles stand, green ones were moved." if things(rig) else ""
    return (
        f'<h2>The rig</h2><div class="row">{drawn}</div><p>{escape(plots.doubt_sentence(rig))} Up is where the '
        f"pictures have it.{moved}</p>"
    )


def _evidence(rig: Rig) -> str:
    drawn = figures(
        ("Who saw what: thick lines carry more, red ones disagree.", plots.graph(rig)),
        ("Views against the rig, in their own sigmas; above the line they contradict it.", plots.cycle_errors(rig)),
        ("RMS of the fit, and below it of framesets held out of the fit.", plots.held_out(rig)),
    )
    return f'<h2>Evidence</h2><div class="row">{drawn}</div>'
