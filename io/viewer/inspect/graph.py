"""The pose graph in rerun: which camera saw which rectangle, how well, and which Views contradict the rig."""

from collections.abc import Iterable, Sequence

import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.drawing.palette import FAULT, FINE, MOVING, STATIC, Colour
from quadrig.io.drawing.rig_figures import edge_widths, graph_edges
from quadrig.rig.doubt.disagreement import Disagreement
from quadrig.rig.doubt.verdict import contradiction_limit
from quadrig.rig.result import PlacedRectangle, Rig


def log_graph(
    recording: rr.RecordingStream, rig: Rig, views: Sequence[Disagreement], colours: dict[str, Colour]
) -> None:
    """Cameras on the left, rectangles on the right, a line for all Views of one rectangle by one camera.

    Rerun's graph nodes know no thickness and no colour of an edge, so it is drawn in the plane.
    """
    camera_at, rect_at = _places(rig)
    edges = graph_edges(views)
    edges = [edge for edge in edges if edge.camera in camera_at and edge.rectangle in rect_at]
    limit = contradiction_limit(views)
    # Many rows leave little room between them.
    thinner = min(1, 4 / max(len(camera_at), len(rect_at), 1))
    widths = [width * thinner for width in edge_widths([edge.information for edge in edges])]
    lines = rr.LineStrips2D(
        [[camera_at[edge.camera], rect_at[edge.rectangle]] for edge in edges],
        colors=[FAULT if edge.sigmas > limit else FINE for edge in edges],
        radii=rr.Radius.ui_points(widths),
    )
    recording.log("graph/edges", lines, static=True)
    shades = [MOVING if placed.rectangle.moving else STATIC for placed in rig.rectangles]
    _log_nodes(recording, "cameras", camera_at, list(camera_at), [colours[name] for name in camera_at], -1.0)
    _log_nodes(recording, "rectangles", rect_at, [_node_label(placed) for placed in rig.rectangles], shades, 1.0)


def graph_view(rig: Rig) -> rrb.Spatial2DView:
    """A view of the graph with room for the names on both sides."""
    left, right = _longest([camera.name for camera in rig.cameras]), _longest(map(_node_label, rig.rectangles))
    bounds = rrb.VisualBounds2D(x_range=[-2 * left - 0.03, _WIDE + 2 * right + 0.03], y_range=[-0.04, 1.04])
    return rrb.Spatial2DView(origin="graph", name="who saw what", visual_bounds=bounds)


# The graph is so much wider than high. In the first look a letter of a name takes so much of its height, what is
# around a name and between it and its dot as much as that, and a name stands so far below its point.
_WIDE, _LETTER, _AROUND, _RAISED = 2.4, 0.042, 0.25, 0.055


def _longest(names: Iterable[str]) -> float:
    """Half of the width of the longest name and its margin."""
    return (max(map(len, names), default=0) * _LETTER + _AROUND) / 2


def _log_nodes(
    recording: rr.RecordingStream,
    kind: str,
    at: dict[str, tuple[float, float]],
    labels: Sequence[str],
    colours: Sequence[Colour],
    side: float,
) -> None:
    """Dots, and their names beside them, outside of the graph."""
    dots = rr.Points2D(list(at.values()), colors=colours, radii=rr.Radius.ui_points(6))
    recording.log(f"graph/{kind}", dots, static=True)
    beside = [(x + side * _longest([label]), y - _RAISED) for (x, y), label in zip(at.values(), labels, strict=True)]
    names = rr.Points2D(beside, colors=colours, radii=rr.Radius.ui_points(0.1), labels=list(labels), show_labels=True)
    recording.log(f"graph/{kind}/names", names, static=True)


def _places(rig: Rig) -> tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]:
    cameras, rectangles = rig.cameras, rig.rectangles
    return (
        {one.name: (0.0, y) for one, y in zip(cameras, _spread(len(cameras)), strict=True)},
        {one.name: (_WIDE, y) for one, y in zip(rectangles, _spread(len(rectangles)), strict=True)},
    )


def _node_label(placed: PlacedRectangle) -> str:
    return f"{placed.name} x{len(placed.framesets)}" if placed.rectangle.moving else placed.name


def _spread(count: int) -> list[float]:
    return [(index + 0.5) / count for index in range(count)]
