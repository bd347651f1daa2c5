"""What pictures of a rig in space are made of."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.drawing.geometry import ellipsoid
from quadrig.io.drawing.palette import Colour
from quadrig.rig.result import Camera, Rig
from quadrig.single.arrays import Floats
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose


def transform(pose: Pose) -> rr.Transform3D:
    """A pose, parent_from_child."""
    return rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation)


def frustum(
    lens: Intrinsics,
    colour: Colour,
    depth: float,
    line_width: "rr.datatypes.Float32Like | None" = None,
    shrink: int = 1,
) -> rr.Pinhole:
    """A camera with its picture `depth` m in front of it. shrink: by what the picture that is logged is smaller."""
    # The first pixel of a smaller picture covers shrink x shrink of the camera's.
    columns, rows = -(-lens.width // shrink), -(-lens.height // shrink)
    image_from_camera = lens.camera_matrix.copy()
    image_from_camera[:2] /= shrink
    image_from_camera[:2, 2] += 0.5 / shrink - 0.5
    return rr.Pinhole(
        image_from_camera=image_from_camera,
        resolution=[columns, rows],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=depth,
        color=colour,
        line_width=line_width,
    )


def doubt_ellipsoid(
    rig: Rig, camera: Camera, colour: Sequence[int], magnified: float, largest: float = np.inf
) -> rr.Ellipsoids3D | None:
    """The ellipsoid of one sigma of a camera's position, so many times as large, at most of half size `largest`, m;
    None for the reference, which has none."""
    sigmas, axes = ellipsoid(rig.pose_covariance(camera.name)[3:, 3:])
    if not sigmas.max() > 0:
        return None
    return rr.Ellipsoids3D(
        # A sigma far below the others' would be drawn as a sheet of no thickness, which flickers.
        half_sizes=[min(magnified, largest / sigmas.max()) * np.maximum(sigmas, 0.03 * sigmas.max())],
        centers=[camera.rig_from_camera.translation],
        quaternions=[rr.Quaternion(xyzw=Pose(axes, np.zeros(3)).quaternion())],
        colors=[list(colour)],
        fill_mode="majorwireframe",
    )


def named_points(names: Sequence[str], positions: Floats, colours: Sequence[Colour]) -> rr.Points3D:
    """Points (N, 3) with their names."""
    return rr.Points3D(positions, radii=rr.Radius.ui_points(1.5), colors=colours, labels=names, show_labels=True)


def outline(rings: Floats, colour: Colour, radius: float) -> rr.LineStrips3D:
    """Closed outlines (K, 5, 3), their lines so many points in half width."""
    return rr.LineStrips3D(list(rings), colors=[colour], radii=rr.Radius.ui_points(radius))


def faces(rings: Floats, colour: Colour) -> rr.Mesh3D:
    """What lies inside of outlines (K, 5, 3), half transparent, seen from both sides."""
    two = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]])
    triangles = (4 * np.arange(len(rings))[:, None, None] + two).reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=rings[:, :4].reshape(-1, 3), triangle_indices=triangles, albedo_factor=[*colour, 90]
    )


def level_grid(points: Floats, up: Floats, size: float) -> rrb.LineGrid3D:
    """A level grid under points (N, 3), its spacing a round share of what is so many metres large."""
    return rrb.LineGrid3D(
        visible=True,
        spacing=float(10.0 ** np.round(np.log10(size / 10))),
        plane=rr.components.Plane3D(normal=up, distance=float((points @ up).min())),
        stroke_width=0.7,
        color=(90, 95, 105, 120),
    )
