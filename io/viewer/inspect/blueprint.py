"""How a rig is looked at: space and pictures on the left, verdict, graph and residuals on the right."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.drawing.geometry import bounds, extent, first_eye, positions
from quadrig.io.drawing.rig_figures import arrow_scale
from quadrig.io.viewer.inspect.graph import graph_view
from quadrig.rig.result import Camera, Rig
from quadrig.single.arrays import Floats

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
            rrb.Vertical(space_view(rig), rrb.Grid(*pictures, grid_columns=columns), row_shares=[3, 2]),
            rrb.Vertical(verdict, graph_view(rig), residuals, row_shares=[10, 4, 7]),
            column_shares=[5, 4],
        ),
        rrb.TimePanel(state="collapsed", timeline="frameset"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


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
        line_grid=_floor(rig, eye.up),
        eye_controls=rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=eye.up),
    )


def _floor(rig: Rig, up: Floats) -> rrb.LineGrid3D:
    """A level grid under everything."""
    corners = np.concatenate([positions(rig), np.array(bounds(rig))])
    height = float((corners @ up).min())
    spacing = 10.0 ** np.round(np.log10(extent(rig) / 10))
    return rrb.LineGrid3D(
        visible=True,
        spacing=float(spacing),
        plane=rr.components.Plane3D(normal=up, distance=height),
        stroke_width=0.7,
        color=(90, 95, 105, 120),
    )


def picture_columns(count: int) -> int:
    """Columns of a grid in which wide pictures are as large as can be, in a space more than twice as wide as high."""
    return max(round(float(np.sqrt(4 / 3 * count))), 1)
