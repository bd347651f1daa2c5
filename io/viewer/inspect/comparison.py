"""Two rigs in one space in rerun: the first in colour, the second in grey, arrows from one to the other."""

import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.drawing.differences import ALONG, difference_columns, difference_sentences
from quadrig.io.drawing.geometry import apart, extent, first_eye, positions, round_down
from quadrig.io.drawing.palette import FAULT, STATIC, rig_colours
from quadrig.io.drawing.tables import markdown_table
from quadrig.io.viewer.inspect.blueprint import space_view
from quadrig.io.viewer.inspect.space import log_frustum
from quadrig.io.viewer.shapes import named_points
from quadrig.rig.comparison import Comparison
from quadrig.rig.result import Rig


def comparison_blueprint(first: Rig) -> rrb.Blueprint:
    """The blueprint for what log_comparison logs."""
    words = rrb.TextDocumentView(origin="summary", name="differences")
    return rrb.Blueprint(
        rrb.Vertical(space_view(first), words, row_shares=[3, 2]),
        rrb.TimePanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def log_comparison(recording: rr.RecordingStream, first: Rig, second: Rig, found: Comparison) -> None:
    """Log both rigs, the second aligned, and the differences in words."""
    colours, size = rig_colours(first), extent(first)
    recording.log("space", rr.ViewCoordinates.RDF, static=True)
    for camera in first.cameras:
        log_frustum(
            recording, f"space/first/{camera.name}", camera, camera.rig_from_camera, colours[camera.name], size
        )
    for camera in second.cameras:
        pose = found.first_from_second @ camera.rig_from_camera
        log_frustum(recording, f"space/second/{camera.name}", camera, pose, STATIC, size)
    names = list(colours)
    labels = apart(first_eye(first), names, positions(first))
    recording.log("space/names", named_points(names, labels, list(colours.values())), static=True)
    scale = _arrow_scale(size, found)
    origins = [first.camera(one.name).rig_from_camera.translation for one in found.cameras]
    vectors = [scale * one.step[3:] for one in found.cameras]
    arrows = rr.Arrows3D(origins=origins, vectors=vectors, colors=[FAULT], radii=0.004 * size)
    recording.log("space/shifts", arrows, static=True)
    text = rr.TextDocument(_markdown(found, scale), media_type="text/markdown")
    recording.log("summary", text, static=True)


def _arrow_scale(size: float, found: Comparison) -> float:
    """How many times longer than they are shifts are drawn in a rig of that size, m; a round number."""
    longest = max((one.shift for one in found.cameras), default=0.0)
    if not longest > 0:
        return 1.0
    return max(round_down(0.2 * size / longest), 1.0)


def _markdown(found: Comparison, scale: float) -> str:
    headline, *sentences = difference_sentences(found)
    note = f"First in colour, second grey; red arrows: shifts, drawn {scale:.0f} times longer."
    return "\n".join(
        [
            f"## {headline}",
            "",
            *(line for sentence in sentences for line in (sentence, "")),
            *markdown_table(difference_columns(found)),
            "",
            ALONG,
            "",
            note,
        ]
    )
