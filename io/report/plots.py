"""The plots of the report: each makes one picture of one thing."""

from collections.abc import Sequence

import numpy as np

from quadrig.io.drawing.geometry import (
    ellipsoid,
    extent,
    level_axes,
    magnification,
    positions,
    round_down,
)
from quadrig.io.drawing.palette import FAULT, FINE, MOVING, PREDICTED, STATIC, Colour, hexadecimal, rig_colours
from quadrig.io.drawing.rig_figures import (
    arrow_scale,
    edge_widths,
    graph_edges,
    longest_usual,
    residual_arrows,
    residual_histogram,
)
from quadrig.io.drawing.svg import LETTER, Plot
from quadrig.io.drawing.things import RoomMap, things
from quadrig.rig.doubt.disagreement import disagreements
from quadrig.rig.doubt.residual_field import COLUMNS, ROWS, residual_field
from quadrig.rig.doubt.verdict import contradiction_limit
from quadrig.rig.result import Camera, PlacedRectangle, Rig
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose

# A report shows a share of very many residuals: 1500 arrows fill a picture, and its file stays small.
_MOST_ARROWS = 1500
_MOST_OUTLINES = 120
_COVERED = "#4a86c8"
_WIDTH = 420
# Of the two plots beside the tables of a camera.
_BESIDE = 340
# Between two rows of bars or of names.
_ROW = 24


def level_view(rig: Rig, rows: tuple[int, int], title: str, labels: tuple[str, str]) -> str:
    """The rig on two of its level axes (right, ahead, up): cameras with their view and doubt, rectangles."""
    axes = level_axes(rig)[list(rows)]
    shown = things(rig)
    every = np.concatenate([positions(rig), *(thing.rings.reshape(-1, 3) for thing in shown)]) @ axes.T
    every = every[np.isfinite(every).all(axis=1)]
    size, doubt_scale = extent(rig), magnification(rig)
    margin = 0.12 * size
    low, high = every.min(axis=0) - margin, every.max(axis=0) + margin
    plot = Plot((low[0], high[0]), (low[1], high[1]), _WIDTH, 340, labels[0], labels[1], equal=True)
    for thing in shown:
        colour = hexadecimal(MOVING if thing.moves else STATIC)
        step = -(-thing.rings[..., 0, 0].size // _MOST_OUTLINES)
        for ring in thing.rings[::step].reshape(-1, 5, 3):
            plot.line(ring @ axes.T, colour, 0.6 if thing.moves else 2.0)
        if not thing.moves:
            _draw_name(plot, thing.rings[0, 0] @ axes.T, thing.name, colour)
    for camera, colour in zip(rig.cameras, rig_colours(rig).values(), strict=True):
        _draw_camera(plot, camera, camera.rig_from_camera, colour, axes, 0.09 * size)
        covariance = doubt_scale**2 * rig.pose_covariance(camera.name)[3:, 3:]
        at = camera.rig_from_camera.translation @ axes.T
        _draw_ellipse(plot, at, colour, axes, covariance)
        plot.dots(at[None], hexadecimal(colour), 2.5)
        plot.text(at, camera.name, hexadecimal(colour), below=True)
    return plot.svg(title)


def room_view(rig: Rig, room: RoomMap, rows: tuple[int, int], title: str, labels: tuple[str, str]) -> str:
    """The room that a rig was carried through, on two of its level axes: what hangs in it with its doubt, the path of
    the rig, and the rig where it began."""
    axes, path = room.axes[list(rows)], hexadecimal(PREDICTED)
    every, margin = room.points() @ axes.T, 0.1 * room.extent
    low, high = every.min(axis=0) - margin, every.max(axis=0) + margin
    plot = Plot((low[0], high[0]), (low[1], high[1]), _WIDTH, 400, labels[0], labels[1], equal=True)
    scale = room_scale(room)
    for name, ring, covariance in zip(room.names, room.rings, room.covariances, strict=True):
        _draw_ellipse(plot, ring[:4].mean(axis=0) @ axes.T, STATIC, axes, scale**2 * covariance)
        plot.line(ring @ axes.T, hexadecimal(STATIC), 2.5)
        # Seen from the side walls lie behind one another, and so would names.
        if 2 not in rows:
            _draw_name(plot, ring @ axes.T, name, hexadecimal(STATIC))
    for stretch in room.stretches():
        plot.line(stretch @ axes.T, path, 1.2)
    plot.dots(room.room_from_rig.translation[:1] @ axes.T, path, 3)
    for camera, colour in zip(rig.cameras, rig_colours(rig).values(), strict=True):
        _draw_camera(plot, camera, room.room_from_rig[0] @ camera.rig_from_camera, colour, axes, 0.08 * room.extent)
    return plot.svg(title)


def room_scale(room: RoomMap) -> float:
    """How many times larger than they are doubts are drawn in a map."""
    largest = max((ellipsoid(one)[0].max() for one in room.covariances), default=0.0)
    return max(round_down(0.04 * room.extent / largest), 1.0) if largest > 0 else 1.0


def _draw_name(plot: Plot, ring: Floats, name: str, colour: str) -> None:
    plot.text((ring[:, 0].mean(), ring[:, 1].max()), name, colour)


def _draw_camera(plot: Plot, camera: Camera, pose: Pose, colour: Colour, axes: Floats, size: float) -> None:
    """A camera at a pose with its view, so many metres long."""
    lens = camera.intrinsics
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [lens.width / 2, lens.height / 2] / lens.focal
    tips = pose.transform(size * np.column_stack([sides, np.ones(4)])) @ axes.T
    eye = pose.translation @ axes.T
    plot.line(tips, hexadecimal(colour), 1.2, closed=True)
    plot.segments(np.tile(eye, (4, 1)), tips, hexadecimal(colour), 1.2)


def _draw_ellipse(plot: Plot, at: Floats, colour: Colour, axes: Floats, covariance: Floats) -> None:
    """The ellipse of the covariance (3, 3) of a position (2,)."""
    if np.isfinite(covariance).all():
        sizes, directions = np.linalg.eigh(axes @ covariance @ axes.T)
        angle = np.linspace(0, 2 * np.pi, 40)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.sqrt(np.maximum(sizes, 0))
        plot.line(at + ring @ directions.T, hexadecimal(colour), 1.0, closed=True, fill=hexadecimal(colour) + "40")


def graph(rig: Rig) -> str:
    """Cameras left, rectangles right; lines as thick as what they carry, red where they disagree."""
    cameras, rectangles = [camera.name for camera in rig.cameras], [_with_count(p) for p in rig.rectangles]
    rows = max(len(cameras), len(rectangles), 2)
    rooms = [LETTER * max(map(len, names), default=0) + 14 for names in (cameras, rectangles)]
    width = max(_WIDTH, round(sum(rooms)) + 120)
    plot = Plot((0, width), (0, rows), width, _ROW * rows + 40, down=True, axes="", left=12)
    at = [plot.x[0] + rooms[0], plot.x[1] - rooms[1]]
    left = {name: (at[0], y) for name, y in zip(cameras, _spread(len(cameras), rows), strict=True)}
    right = {p.name: (at[1], y) for p, y in zip(rig.rectangles, _spread(len(rig.rectangles), rows), strict=True)}
    views = disagreements(rig)
    edges = [edge for edge in graph_edges(views) if edge.camera in left and edge.rectangle in right]
    limit = contradiction_limit(views)
    for edge, thick in zip(edges, edge_widths([edge.information for edge in edges]), strict=True):
        colour = hexadecimal(FAULT if edge.sigmas > limit else FINE)
        plot.line(np.array([left[edge.camera], right[edge.rectangle]]), colour, 1.2 * thick)
    colours = rig_colours(rig)
    for name, place in left.items():
        plot.dots(np.array([place]), hexadecimal(colours[name]), 5)
        plot.label((place[0] - 10, place[1]), name, hexadecimal(colours[name]), "end")
    for placed, words in zip(rig.rectangles, rectangles, strict=True):
        place, colour = right[placed.name], hexadecimal(MOVING if placed.rectangle.moving else STATIC)
        plot.dots(np.array([place]), colour, 5)
        plot.label((place[0] + 10, place[1]), words, colour, "start")
    return plot.svg("who saw what: cameras, rectangles, and how much each pair carries")


def _with_count(placed: PlacedRectangle) -> str:
    return f"{placed.name} x{len(placed.framesets)}" if placed.rectangle.moving else placed.name


def cycle_errors(rig: Rig) -> str:
    """Each View's disagreement with the rig by frameset, in its own sigmas."""
    known = [one for one in disagreements(rig) if np.isfinite(one.sigmas)]
    limit = contradiction_limit(known)
    framesets = [one.frameset for one in known] or [0]
    top = max([1.3 * limit, *(one.sigmas for one in known if not one.rejected)])
    bounds_ = (min(framesets) - 0.5, max(framesets) + 0.5)
    plot = Plot(bounds_, (0, 1.05 * top), _WIDTH, 240, "frameset", "distance from the rig, sigmas")
    plot.line(np.array([[bounds_[0], limit], [bounds_[1], limit]]), hexadecimal(FAULT), 1.0)
    # Cameras stand beside one another at each frameset.
    aside = np.linspace(-0.3, 0.3, len(rig.cameras)) if len(rig.cameras) > 1 else [0.0]
    for (name, colour), shift in zip(rig_colours(rig).items(), aside, strict=True):
        own = [(one.frameset + shift, one.sigmas) for one in known if one.camera == name and not one.rejected]
        plot.dots(np.array(own).reshape(-1, 2), hexadecimal(colour), 2.0)
    return plot.svg("how far each View disagrees with the rig, in its own sigmas")


def held_out(rig: Rig) -> str:
    """RMS of the fit (full) and of framesets held out of it (pale), for each camera."""
    rows = np.nan_to_num([(camera.rms, camera.held_out_rms) for camera in rig.cameras])
    top = max(1e-3, float(rows.max(initial=0.0)))
    left = round(LETTER * max(len(camera.name) for camera in rig.cameras)) + 14
    # The figures stand to the right of the bars.
    size = (max(_WIDTH, left + 200), (_ROW + 8) * len(rows) + 50)
    plot = Plot((0, 1.2 * top), (0, len(rows)), *size, "RMS px", down=True, axes="x", left=left)
    for index, (camera, (fit, out)) in enumerate(zip(rig.cameras, rows, strict=True)):
        colour = hexadecimal(rig_colours(rig)[camera.name])
        plot.box((0, index + 0.14), (fit, index + 0.48), colour)
        plot.box((0, index + 0.52), (out, index + 0.86), colour, 0.5)
        plot.label((-0.012 * top, index + 0.5), camera.name, colour, "end")
        for value, middle in ((fit, 0.31), (out, 0.69)):
            plot.label((value + 0.015 * top, index + middle), f"{value:.2f}" if value else "unknown", anchor="start")
    return plot.svg("RMS of the fit and of framesets held out of it, by camera")


def field(rig: Rig, camera: Camera) -> str:
    """Residual vectors over the picture, enlarged, on the fields that corners covered."""
    lens, held = camera.intrinsics, residual_field(rig, camera.name)
    height = round((_BESIDE - 60) * lens.height / lens.width) + 42
    plot = Plot((0, lens.width), (0, lens.height), _BESIDE, height, "x px", "y px", down=True)
    most = max(int(held.counts.max()), 1)
    for row in range(ROWS):
        for column in range(COLUMNS):
            if held.counts[row, column]:
                low = (column * lens.width / COLUMNS, row * lens.height / ROWS)
                high = ((column + 1) * lens.width / COLUMNS, (row + 1) * lens.height / ROWS)
                plot.box(low, high, _COVERED, 0.12 + 0.4 * float(np.sqrt(held.counts[row, column] / most)))
    chosen = _some(len(held.pixels), _MOST_ARROWS)
    starts = held.pixels[chosen] - held.residuals[chosen]
    ends = starts + residual_arrows(camera, held.residuals[chosen], arrow_scale(rig))
    plot.segments(starts, ends, hexadecimal(PREDICTED))
    return plot.svg(f"{camera.name}: residuals over the picture, and where corners were")


def histogram(rig: Rig, camera: Camera) -> str:
    """How long residuals are, on the scale of all cameras."""
    fields = {one.name: residual_field(rig, one.name) for one in rig.cameras}
    counts, edges = residual_histogram(fields[camera.name], longest_usual(fields.values()))
    top = float(max(counts.max(), 1))
    plot = Plot((0, float(edges[-1])), (0, 1.05 * top), _BESIDE, 200, "length of residual, px", "corners")
    colour = hexadecimal(rig_colours(rig)[camera.name])
    for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True):
        plot.box((low, 0), (low + 0.92 * (high - low), count), colour)
    return plot.svg(f"{camera.name}: lengths of residuals")


def doubt_sentence(rig: Rig) -> str:
    """What the ellipses show."""
    largest = max((ellipsoid(rig.pose_covariance(c.name)[3:, 3:])[0].max() for c in rig.cameras), default=0.0)
    return (
        f"Ellipses are one sigma of each camera's position, drawn {magnification(rig):.0f} times larger "
        f"(the longest half axis is {1e3 * largest:.2g} mm)."
    )


def _some(count: int, most: int) -> Sequence[int]:
    return [int(i) for i in np.linspace(0, count - 1, min(count, most))] if count else []


def _spread(count: int, height: int) -> list[float]:
    return [(index + 0.5) * height / count for index in range(count)]
