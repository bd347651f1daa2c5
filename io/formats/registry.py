"""Rigs in the formats of other programs: one registry, one file each."""

from quadrig.io.formats.colmap import colmap_files
from quadrig.io.formats.format import Files, Format, Options
from quadrig.io.formats.kalibr import is_kalibr, kalibr_files, read_kalibr
from quadrig.io.formats.opencv import is_opencv, opencv_files, read_opencv
from quadrig.io.formats.rig_json import is_rig_json, json_files, read_json
from quadrig.io.formats.ros import ros_files, tf_files, urdf_files
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError


def export_files(rig: Rig, name: str, options: Options | None = None) -> Files:
    """The files of a rig in a format, by name. Raises QuadrigError where there is no such format."""
    if name not in FORMATS:
        raise QuadrigError(f"there is no format {name!r}; there are {', '.join(FORMATS)}")
    return FORMATS[name].write(rig, options or Options())


FORMATS: dict[str, Format] = {
    "json": Format("cameras, rectangles and sigmas as JSON", json_files, read=read_json, recognises=is_rig_json),
    "opencv": Format(
        "one OpenCV FileStorage (YAML) with every camera", opencv_files, read=read_opencv, recognises=is_opencv
    ),
    "opencv-xml": Format("the same as XML", lambda rig, options: opencv_files(rig, options, ".xml")),
    "ros": Format("camera_info YAML, one file for each camera", ros_files, single=False),
    "tf": Format("static transforms as a ROS 2 launch file", tf_files),
    "urdf": Format("links and fixed joints as URDF", urdf_files),
    "kalibr": Format("Kalibr's camchain YAML", kalibr_files, read=read_kalibr, recognises=is_kalibr),
    "colmap": Format("COLMAP's text model: cameras, images, points3D", colmap_files, single=False),
}
