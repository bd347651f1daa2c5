"""Rigs in the formats of other programs: one registry, one small function each."""

from collections.abc import Callable
from dataclasses import dataclass

from quadrig.io.export.colmap import colmap_files
from quadrig.io.export.kalibr import kalibr_files
from quadrig.io.export.opencv import opencv_files
from quadrig.io.export.ros import ros_files, tf_files, urdf_files
from quadrig.io.export.values import Files, json_files
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError


@dataclass(frozen=True)
class Format:
    """A format: what it is, and the function that makes its files, by name. single: it is one file, of any name."""

    what: str
    files: Callable[[Rig], Files]
    single: bool = True


def export_files(rig: Rig, name: str) -> Files:
    """The files of a rig in a format, by name. Raises QuadrigError where there is no such format."""
    if name not in FORMATS:
        raise QuadrigError(f"there is no format {name!r}; there are {', '.join(FORMATS)}")
    return FORMATS[name].files(rig)


FORMATS: dict[str, Format] = {
    "json": Format("cameras, rectangles and sigmas as JSON", json_files),
    "opencv": Format("one OpenCV FileStorage (YAML) with every camera", opencv_files),
    "opencv-xml": Format("the same as XML", lambda rig: opencv_files(rig, ".xml")),
    "ros": Format("camera_info YAML, one file for each camera", ros_files, single=False),
    "tf": Format("static transforms as a ROS 2 launch file", tf_files),
    "urdf": Format("links and fixed joints as URDF", urdf_files),
    "kalibr": Format("Kalibr's camchain YAML", kalibr_files),
    "colmap": Format("COLMAP's text model: cameras, images, points3D", colmap_files, single=False),
}
