"""The pose graph in rerun: which camera saw which rectangle, how well, and which Views contradict the rig."""

from collections.abc import Sequence

import rerun as rr

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
    height = max(len(rig.cameras), len(rig.rectangles), 2)
    camera_at = {c.name: (0.0, y) for c, y in zip(rig.cameras, _spread(len(rig.cameras), height), strict=True)}
    rect_at = {
        p.name: (height * 1.2, y) for p, y in zip(rig.rectangles, _spread(len(rig.rectangles), height), strict=True)
    }
    edges = graph_edges(views)
    edges = [edge for edge in edges if edge.camera in camera_at and edge.rectangle in rect_at]
    limit = contradiction_limit(views)
    # Many rows leave little room between them.
    widths = [width * min(1, 4 / height) for width in edge_widths([edge.information for edge in edges])]
    lines = rr.LineStrips2D(
        [[camera_at[edge.camera], rect_at[edge.rectangle]] for edge in edges],
        colors=[FAULT if edge.sigmas > limit else FINE for edge in edges],
        radii=rr.Radius.ui_points(widths),
    )
    recording.log("graph/edges", lines, static=True)
    recording.log(
        "graph/cameras",
        rr.Points2D(
            list(camera_at.values()),
            colors=[colours[name] for name in camera_at],
            radii=rr.Radius.ui_points(9),
            labels=list(camera_at),
            show_labels=True,
        ),
        static=True,
    )
    recording.log(
        "graph/rectangles",
        rr.Points2D(
            list(rect_at.values()),
            colors=[MOVING if placed.rectangle.moving else STATIC for placed in rig.rectangles],
            radii=rr.Radius.ui_points(9),
            labels=[_node_label(placed) for placed in rig.rectangles],
            show_labels=True,
        ),
        static=True,
    )


def _node_label(placed: PlacedRectangle) -> str:
    return f"{placed.name} x{len(placed.framesets)}" if placed.rectangle.moving else placed.name


def _spread(count: int, height: int) -> list[float]:
    return [(index + 0.5) * height / count for index in range(count)]
