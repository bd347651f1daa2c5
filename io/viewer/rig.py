"""A Rig in rerun: cameras, rectangles and their doubt in space, what was found and predicted in every picture, the
pose graph, the residuals over each picture, the adjustment's steps, and the verdict in words.

Entities: space/... in the rig frame (metres), space/cameras/<name> with a Pinhole each and what lies in its picture;
graph, field/<name>, histogram/<name>, steps, verdict.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import cv2
import numpy as np

from quadrig.io.drawing.geometry import (
    apart,
    ellipsoid,
    extent,
    first_eye,
    magnification,
    outlines,
    positions,
    rises,
)
from quadrig.io.drawing.palette import FAULT, FINE, FOUND, MOVED, MOVING, PREDICTED, STATIC, Colour, rig_colours
from quadrig.io.drawing.rig_figures import (
    edge_widths,
    graph_edges,
    predicted_outline,
    residual_arrows,
    residual_histogram,
)
from quadrig.io.drawing.verdict_markdown import verdict_markdown
from quadrig.rig.doubt.disagreement import disagreements
from quadrig.rig.doubt.residual_field import ResidualField, residual_field
from quadrig.rig.doubt.verdict import contradiction_limit
from quadrig.rig.result import Camera, PlacedRectangle, Rig, ViewFit, placed_pose
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose


def log_rig(recording: Any, rig: Rig, times: Sequence[int] = ()) -> None:
    """Log all of a Rig to a rerun.RecordingStream. times: ns since 1970 of each frameset, by index, where known."""
    import rerun as rr

    recording.log("verdict", rr.TextDocument(verdict_markdown(rig), media_type="text/markdown"), static=True)
    recording.log("space", rr.ViewCoordinates.RDF, static=True)
    colours = rig_colours(rig)
    for camera in rig.cameras:
        _log_camera(recording, rig, camera, colours[camera.name])
    _log_doubt(recording, rig, colours)
    for placed in rig.rectangles:
        _log_rectangle(recording, rig, placed, times)
    _log_names(recording, rig, colours, times)
    _log_views(recording, rig, times)
    _log_graph(recording, rig, colours)
    for camera in rig.cameras:
        _log_field(recording, rig, camera, colours[camera.name])
    if rig.costs:
        # Of hundreds of steps the first bring nearly all: bars of logarithms show the rest too.
        steps = np.log10(np.asarray(rig.costs, float))
        recording.log("steps", rr.BarChart(steps, color=FINE), static=True)


def log_pictures(recording: Any, pictures: Iterable[tuple[int, str, bytes]], times: Sequence[int] = ()) -> int:
    """Log JPEG pictures (frameset, camera, bytes) under their cameras; how many there were."""
    import rerun as rr

    count = 0
    for frameset, camera, picture in pictures:
        set_frameset(recording, frameset, times)
        image = rr.EncodedImage(contents=picture, media_type="image/jpeg")
        recording.log(f"space/cameras/{camera}/picture", image)
        count += 1
    return count


def set_frameset(recording: Any, frameset: int, times: Sequence[int]) -> None:
    """Put what is logged next at a frameset, on the timelines "frameset" and, where known, "time"."""
    recording.set_time("frameset", sequence=int(frameset))
    if 0 <= frameset < len(times):
        recording.set_time("time", timestamp=np.datetime64(int(times[frameset]), "ns"))


def log_frustum(recording: Any, path: str, camera: Camera, pose: Pose, colour: Colour, size: float) -> None:
    """Log a camera as a frustum of which a picture makes the far end. pose: of the camera in the space; size: m, of
    the whole rig."""
    import rerun as rr

    lens = camera.intrinsics
    recording.log(path, rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation), static=True)
    recording.log(
        path,
        rr.Pinhole(
            image_from_camera=lens.camera_matrix,
            resolution=[lens.width, lens.height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.1 * size,
            color=colour,
            line_width=0.003 * size,
        ),
        static=True,
    )


def _log_camera(recording: Any, rig: Rig, camera: Camera, colour: Colour) -> None:
    import rerun as rr

    path, lens = f"space/cameras/{camera.name}", camera.intrinsics
    log_frustum(recording, path, camera, camera.rig_from_camera, colour, extent(rig))
    frame = [[0, 0], [lens.width, 0], [lens.width, lens.height], [0, lens.height], [0, 0]]
    edge = rr.LineStrips2D([frame], colors=[colour], radii=rr.Radius.ui_points(1))
    recording.log(f"{path}/marks/frame", edge, static=True)


def _log_doubt(recording: Any, rig: Rig, colours: dict[str, Colour]) -> None:
    """One-sigma ellipsoids of the camera positions, enlarged by a factor that the verdict says."""
    import rerun as rr

    factor = magnification(rig)
    for camera in rig.cameras:
        sizes, axes = ellipsoid(rig.pose_covariance(camera.name)[3:, 3:])
        if not sizes.max() > 0:
            continue
        # A sigma far below the others' would be drawn as a sheet of no thickness, which flickers.
        sizes = np.maximum(factor * sizes, 0.03 * factor * sizes.max())
        drawn = rr.Ellipsoids3D(
            half_sizes=[sizes],
            centers=[camera.rig_from_camera.translation],
            quaternions=[rr.Quaternion(xyzw=Pose(axes, np.zeros(3)).quaternion())],
            colors=[(*colours[camera.name], 150)],
            fill_mode="majorwireframe",
        )
        recording.log(f"space/doubt/{camera.name}", drawn, static=True)


def _log_rectangle(recording: Any, rig: Rig, placed: PlacedRectangle, times: Sequence[int]) -> None:
    import rerun as rr

    path = f"space/rectangles/{placed.name}"
    rings = outlines(placed)
    if not placed.rectangle.moving:
        recording.log(path, _outline(rings[0], STATIC, 2.5), static=True)
        return
    faint = rr.LineStrips3D(list(rings), colors=[MOVED], radii=rr.Radius.ui_points(0.6))
    recording.log(f"space/everywhere/{placed.name}", faint, static=True)
    by_frameset = dict(zip(np.asarray(placed.framesets).tolist(), rings, strict=True))
    for frameset in _framesets(rig):
        set_frameset(recording, frameset, times)
        ring = by_frameset.get(frameset)
        recording.log(path, rr.Clear(recursive=False) if ring is None else _outline(ring, MOVING, 3.0))
    recording.reset_time()


def _outline(ring: Floats, colour: Colour, radius: float) -> Any:
    import rerun as rr

    return rr.LineStrips3D([ring], colors=[colour], radii=rr.Radius.ui_points(radius))


def _log_names(recording: Any, rig: Rig, colours: dict[str, Colour], times: Sequence[int]) -> None:
    """Names of cameras and rectangles, moved apart where they would lie on one another from where one looks first."""
    import rerun as rr

    still = [placed for placed in rig.rectangles if not placed.rectangle.moving]
    anchors = [*positions(rig), *(placed.rig_from_rect.translation for placed in still)]
    names = [*(camera.name for camera in rig.cameras), *(placed.name for placed in still)]
    shades = [*(colours[camera.name] for camera in rig.cameras), *([STATIC] * len(still))]
    eye = first_eye(rig)
    places = apart(eye, names, np.array(anchors))
    recording.log("space/names/still", named_points(names, places, shades), static=True)
    recording.log("space/names/leads", _leads(np.array(anchors), places, shades), static=True)
    moving = [placed for placed in rig.rectangles if placed.rectangle.moving]
    for frameset in _framesets(rig) if moving else []:
        set_frameset(recording, frameset, times)
        here = [(placed.name, placed_pose(rig, placed.name, frameset)) for placed in moving]
        here = [(name, pose.translation) for name, pose in here if pose is not None]
        if not here:
            recording.log("space/names/moving", rr.Clear(recursive=False))
            continue
        every = np.concatenate([places, np.array([place for _, place in here])])
        shown = apart(eye, names + [name for name, _ in here], every)[len(names) :]
        recording.log("space/names/moving", named_points([name for name, _ in here], shown, [MOVING] * len(here)))
    recording.reset_time()


def named_points(names: Sequence[str], places: Floats, colours: Sequence[Colour]) -> Any:
    """rerun.Points3D with their names."""
    import rerun as rr

    return rr.Points3D(places, radii=rr.Radius.ui_points(1.5), colors=colours, labels=names, show_labels=True)


def _leads(anchors: Floats, places: Floats, colours: Sequence[Colour]) -> Any:
    import rerun as rr

    return rr.LineStrips3D(list(np.stack([anchors, places], axis=1)), colors=colours, radii=rr.Radius.ui_points(0.5))


def _framesets(rig: Rig) -> list[int]:
    held = {fit.view.frameset for fit in rig.fits}
    return sorted(held.union(*(np.asarray(placed.framesets).tolist() for placed in rig.rectangles)))


def _log_views(recording: Any, rig: Rig, times: Sequence[int]) -> None:
    by_instant: dict[tuple[int, str], list[ViewFit]] = {}
    for fit in rig.fits:
        by_instant.setdefault((fit.view.frameset, fit.view.camera), []).append(fit)
    for frameset in sorted({fit.view.frameset for fit in rig.fits}):
        set_frameset(recording, frameset, times)
        for camera in rig.cameras:
            _log_picture_marks(recording, rig, camera, by_instant.get((frameset, camera.name), []))
    recording.reset_time()


def _log_picture_marks(recording: Any, rig: Rig, camera: Camera, fits: list[ViewFit]) -> None:
    """Found corners, predicted outlines, and residual arrows (enlarged) of one picture."""
    import rerun as rr

    path = f"space/cameras/{camera.name}/marks"
    if not fits:
        for part in ("found", "residuals", "predicted", "names"):
            recording.log(f"{path}/{part}", rr.Clear(recursive=False))
        return
    pixels = np.concatenate([fit.view.pixels for fit in fits])
    residuals = np.concatenate([fit.residuals for fit in fits])
    used = np.concatenate([np.asarray(fit.used, bool) for fit in fits])
    told = np.isfinite(residuals).all(axis=1)
    found = [FOUND if taken else FAULT for taken in used]
    recording.log(f"{path}/found", rr.Points2D(pixels, colors=found, radii=rr.Radius.ui_points(2.5), draw_order=30))
    recording.log(
        f"{path}/residuals",
        rr.Arrows2D(
            origins=(pixels - residuals)[told],
            vectors=residual_arrows(camera, residuals[told]),
            colors=[PREDICTED],
            radii=rr.Radius.ui_points(1.0),
            draw_order=31,
        ),
    )
    rings = [(fit, predicted_outline(rig, camera, fit)) for fit in fits]
    drawn = [(fit, ring) for fit, ring in rings if ring is not None]
    if not drawn:
        for part in ("predicted", "names"):
            recording.log(f"{path}/{part}", rr.Clear(recursive=False))
        return
    colours = [FAULT if fit.rejected else PREDICTED for fit, _ in drawn]
    lines = rr.LineStrips2D(
        [ring for _, ring in drawn], colors=colours, radii=rr.Radius.ui_points(1.2), draw_order=29
    )
    recording.log(f"{path}/predicted", lines)
    names = [fit.view.rectangle for fit, _ in drawn]
    places = _name_places([ring for _, ring in drawn], names, camera)
    labels = rr.Points2D(
        places, colors=colours, radii=rr.Radius.ui_points(0.5), labels=names, show_labels=True, draw_order=32
    )
    recording.log(f"{path}/names", labels)


def _name_places(rings: list[Floats], names: list[str], camera: Camera) -> Floats:
    """Below each outline, apart from one another at the size in which a picture of four is shown."""
    width = camera.intrinsics.width
    below = np.array([[(ring[:, 0].min() + ring[:, 0].max()) / 2, ring[:, 1].max()] for ring in rings])
    # The names lowest in the picture are placed first, and the others move up.
    order = np.argsort(-below[:, 1])
    up = below[order] * [1, -1]
    rise = rises(up, [names[i] for i in order], 0.03 * width, 0.06 * width, 0.075 * width)
    below[order, 1] -= rise
    return below


def _log_graph(recording: Any, rig: Rig, colours: dict[str, Colour]) -> None:
    """Cameras on the left, rectangles on the right, a line for all Views of one rectangle by one camera.

    Rerun's graph nodes know no thickness and no colour of an edge, so it is drawn in the plane.
    """
    import rerun as rr

    height = max(len(rig.cameras), len(rig.rectangles), 2)
    camera_at = {c.name: (0.0, y) for c, y in zip(rig.cameras, _spread(len(rig.cameras), height), strict=True)}
    rect_at = {
        p.name: (height * 1.2, y) for p, y in zip(rig.rectangles, _spread(len(rig.rectangles), height), strict=True)
    }
    views = disagreements(rig)
    edges = graph_edges(views)
    edges = [edge for edge in edges if edge.camera in camera_at and edge.rectangle in rect_at]
    limit = contradiction_limit(views)
    # Many rows leave little place between them.
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


def _log_field(recording: Any, rig: Rig, camera: Camera, colour: Colour) -> None:
    import rerun as rr

    field, path, lens = residual_field(rig, camera.name), f"field/{camera.name}", camera.intrinsics
    frame = [[0, 0], [lens.width, 0], [lens.width, lens.height], [0, lens.height], [0, 0]]
    recording.log(f"{path}/frame", rr.LineStrips2D([frame], colors=[FINE], radii=rr.Radius.ui_points(1)), static=True)
    recording.log(
        f"{path}/coverage",
        rr.EncodedImage(contents=_coverage_png(field, camera), media_type="image/png"),
        static=True,
    )
    if not len(field.pixels):
        return
    recording.log(
        f"{path}/residuals",
        rr.Arrows2D(
            origins=field.pixels - field.residuals,
            vectors=residual_arrows(camera, field.residuals),
            colors=[PREDICTED],
            radii=rr.Radius.ui_points(0.8),
            draw_order=20,
        ),
        static=True,
    )
    counts, edges = residual_histogram(field)
    middles = (edges[1:] + edges[:-1]) / 2
    bars = rr.BarChart(counts, abscissa=middles, widths=np.diff(edges) * 0.9, color=colour)
    recording.log(f"histogram/{camera.name}", bars, static=True)


def _coverage_png(field: ResidualField, camera: Camera) -> bytes:
    """Where corners were: a picture of blue fields, the more corners the lighter, of the size of the camera's."""
    share = np.sqrt(field.counts / max(field.counts.max(), 1))
    # BGR from near black to a mid blue: arrows stay readable on both.
    blocks = (np.array([34, 26, 22]) + share[..., None] * np.array([120, 70, 20])).astype(np.uint8)
    size = (camera.intrinsics.width, camera.intrinsics.height)
    done, data = cv2.imencode(".png", cv2.resize(blocks, size, interpolation=cv2.INTER_NEAREST))
    return data.tobytes() if done else b""
