"""How a rig is looked at: space and pictures on the left, verdict, graph and residuals on the right."""

import numpy as np
import rerun.blueprint as rrb

from quadrig.io.drawing.geometry import bounds, extent, first_eye, positions
from quadrig.io.drawing.rig_figures import arrow_scale
from quadrig.io.viewer.inspect.graph import graph_view
from quadrig.io.viewer.inspect.room import room_view
from quadrig.io.viewer.shapes import level_grid
from quadrig.rig.result import Camera, Rig

# So much of a picture's size is seen around it: its frame stays in view.
_MARGIN = 0.02


def rig_blueprint(rig: Rig) -> rrb.Blueprint:
    """The blueprint for what log_rig logs."""
    pictures = [_picture(camera, f"space/cameras/{camera.name}", camera.name) for camera in rig.cameras]
    fields = [_picture(camera, f"field/{camera.name}", camera.name) for camera in rig.cameras]
    quiet = rrb.PlotLegend(visible=False)
    histograms = [
        rrb.BarChartView(
            origin=f"histogram/{camera.name}", name=f"{camera.name}: corners by residual, px", plot_legend=quiet
        )
        for camera in rig.cameras
    ]
    columns = picture_columns(len(pictures))
    residuals = rrb.Tabs(
        rrb.Grid(*fields, grid_columns=columns, name=f"residuals, {arrow_scale(rig):.0f} times longer, and coverage"),
        rrb.Grid(*histograms, grid_columns=columns, name="histograms"),
    )
    verdict = rrb.TextDocumentView(origin="verdict", name="verdict")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(_spaces(rig), rrb.Grid(*pictures, grid_columns=columns), row_shares=[3, 2]),
            rrb.Vertical(verdict, graph_view(rig), residuals, row_shares=[11, 5, 6]),
            column_shares=[1, 1],
        ),
        rrb.TimePanel(state="collapsed", timeline="frameset"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _spaces(rig: Rig) -> rrb.Spatial3DView | rrb.Tabs:
    """The rig in space; where it was carried, behind the room with its path."""
    if rig.room is None:
        return space_view(rig)
    return rrb.Tabs(room_view(rig, rig.room), space_view(rig), active_tab=0)


def _picture(camera: Camera, origin: str, name: str) -> rrb.Spatial2DView:
    """A view of just what a camera sees, whatever reaches beyond."""
    lens = camera.intrinsics
    across, down = _MARGIN * lens.width, _MARGIN * lens.height
    bounds = rrb.VisualBounds2D(x_range=[-across, lens.width + across], y_range=[-down, lens.height + down])
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=bounds)


def space_view(rig: Rig) -> rrb.Spatial3DView:
    """The rig in space, seen from where first_eye looks."""
    eye = first_eye(rig)
    hidden = [
        f"- space/cameras/{camera.name}/marks/{part}" for camera in rig.cameras for part in ("residuals", "names")
    ]
    return rrb.Spatial3DView(
        origin="space",
        name=f"rig frame: {rig.reference}",
        contents=["+ space/**", *hidden],
        line_grid=level_grid(np.concatenate([positions(rig), np.array(bounds(rig))]), eye.up, extent(rig)),
        eye_controls=rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=eye.up),
    )


def picture_columns(count: int) -> int:
    """Columns of a grid in which wide pictures are as large as can be, in a space more than twice as wide as high."""
    return max(round(float(np.sqrt(4 / 3 * count))), 1)
