"""How a live session is looked at: the sentence across the top, the pictures beside the rig in space, the graph."""

from collections.abc import Sequence

import rerun.blueprint as rrb

# Ellipsoids of one sigma are drawn so many times as large: millimetres in a room are seen, and seen to shrink.
MAGNIFIED = 50.0


def setup_blueprint(cameras: Sequence[str]) -> rrb.Blueprint:
    """The blueprint for what MomentLog logs."""
    pictures = [rrb.Spatial2DView(origin=f"cameras/{name}/image", name=name) for name in cameras]
    space = rrb.Spatial3DView(
        origin="/",
        name=f"rig (doubts {MAGNIFIED:.0f} times as large)",
        contents=["+ $origin/**", "- $origin/cameras/*/image/ghost", "- $origin/sentence"],
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial2DView(origin="sentence", name="do this", background=[13, 13, 13]),
            rrb.Horizontal(
                rrb.Grid(*pictures, grid_columns=1 if len(cameras) < 2 else 2),
                rrb.Vertical(space, rrb.GraphView(origin="graph", name="who shares sheets"), row_shares=[3, 1]),
                column_shares=[3, 2],
            ),
            row_shares=[1, 6],
        ),
        collapse_panels=True,
    )
