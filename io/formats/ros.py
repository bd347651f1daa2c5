"""ROS: sensor_msgs/CameraInfo as camera_info_manager's YAML, static transforms as a launch file, and URDF.

Frames: NAME is the camera's optical frame (x right, y down, z forward), as image messages carry it.
"""

from xml.sax.saxutils import quoteattr

import numpy as np

from quadrig.io.formats.format import Options
from quadrig.rig.result import Camera, Rig
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose


def ros_files(rig: Rig, _options: Options) -> dict[str, str]:
    """NAME.yaml for each camera."""
    return {f"{file_name(camera.name)}.yaml": _camera_info(camera) for camera in rig.cameras}


def tf_files(rig: Rig, _options: Options) -> dict[str, str]:
    """A ROS 2 XML launch file that starts a static_transform_publisher for each camera and standing rectangle."""
    lines = ["<launch>"]
    for child, parent_from_child in _still(rig):
        x, y, z = parent_from_child.translation.tolist()
        qx, qy, qz, qw = parent_from_child.quaternion().tolist()
        arguments = (
            f"--x {x!r} --y {y!r} --z {z!r} --qx {qx!r} --qy {qy!r} --qz {qz!r} --qw {qw!r} "
            f"--frame-id {rig.reference} --child-frame-id {child}"
        )
        lines.append(f'  <node pkg="tf2_ros" exec="static_transform_publisher" args={quoteattr(arguments)}/>')
    return {"rig.launch.xml": "\n".join([*lines, "</launch>", ""])}


def urdf_files(rig: Rig, _options: Options) -> dict[str, str]:
    """A link for each camera and standing rectangle, fixed to the rig frame's."""
    children = _still(rig)
    lines = ['<?xml version="1.0"?>', '<robot name="rig">', f"  <link name={quoteattr(rig.reference)}/>"]
    for child, parent_from_child in children:
        xyz = " ".join(repr(value) for value in parent_from_child.translation.tolist())
        rpy = " ".join(repr(value) for value in roll_pitch_yaw(parent_from_child.rotation))
        lines += [
            f"  <link name={quoteattr(child)}/>",
            f'  <joint name={quoteattr(f"{rig.reference}_to_{child}")} type="fixed">',
            f"    <parent link={quoteattr(rig.reference)}/>",
            f"    <child link={quoteattr(child)}/>",
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
            "  </joint>",
        ]
    return {"rig.urdf": "\n".join([*lines, "</robot>", ""])}


def roll_pitch_yaw(rotation: Floats) -> tuple[float, float, float]:
    """URDF's angles, rad, of a rotation (3, 3) = Rz(yaw) Ry(pitch) Rx(roll); roll is zero where pitch is upright."""
    r = np.asarray(rotation, float)
    upright = np.hypot(r[0, 0], r[1, 0])
    pitch = float(np.arctan2(-r[2, 0], upright))
    # Below this roll and yaw turn about the same axis to the last bits, and one of them is free.
    if upright < 1e-12:
        return 0.0, pitch, float(np.arctan2(-r[0, 1], r[1, 1]))
    return float(np.arctan2(r[2, 1], r[2, 2])), pitch, float(np.arctan2(r[1, 0], r[0, 0]))


def file_name(name: str) -> str:
    """A camera's name as a file's."""
    return name.strip("/").replace("/", "_") or "camera"


def _still(rig: Rig) -> list[tuple[str, Pose]]:
    standing = [(placed.name, placed.rig_from_rect) for placed in rig.rectangles if not placed.rectangle.moving]
    every = [*((camera.name, camera.rig_from_camera) for camera in rig.cameras), *standing]
    return [(name, pose) for name, pose in every if name != rig.reference]


def _camera_info(camera: Camera) -> str:
    lens = camera.intrinsics
    pinhole = lens.model == "pinhole"
    distortion = lens.distortion if pinhole else lens.distortion[:4]
    projection = np.column_stack([lens.camera_matrix, np.zeros(3)])
    return "\n".join(
        [
            f"image_width: {lens.width}",
            f"image_height: {lens.height}",
            f"camera_name: {file_name(camera.name)}",
            *_matrix("camera_matrix", lens.camera_matrix),
            f"distortion_model: {'plumb_bob' if pinhole else 'equidistant'}",
            *_matrix("distortion_coefficients", distortion.reshape(1, -1)),
            *_matrix("rectification_matrix", np.eye(3)),
            *_matrix("projection_matrix", projection),
            "",
        ]
    )


def _matrix(name: str, values: Floats) -> list[str]:
    rows, columns = values.shape
    data = ", ".join(repr(value) for value in values.ravel().tolist())
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{data}]"]
