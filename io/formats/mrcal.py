"""mrcal's cameramodels, one file for each camera: a Python literal with lensmodel, intrinsics, extrinsics and
imagersize. Poses are rt_fromref (our camera_from_rig): a rotation vector, then a translation."""

import ast
import warnings
from pathlib import Path

import numpy as np

from quadrig.io.formats.format import Files, Held, Options, camera_matrix, lens_of, pinhole_only
from quadrig.io.whole_file import LARGEST_OF_CAMERAS, read_whole
from quadrig.rig.result import Camera, Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose

# Models that are OpenCV's, with how many coefficients follow fx fy cx cy.
_COEFFICIENTS = {"PINHOLE": 0, "OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}
_PREFIX = "LENSMODEL_"


def mrcal_files(rig: Rig, _options: Options) -> Files:
    """NAME.cameramodel for each camera. Raises QuadrigError where a lens is a fisheye."""
    return {f"{camera.name}.cameramodel": _text(camera) for camera in rig.cameras}


def _text(camera: Camera) -> str:
    lens, pose = pinhole_only(camera, "mrcal"), camera.rig_from_camera.inverse()
    numbers = [lens.focal, lens.focal * lens.aspect, *lens.principal_point.tolist(), *lens.distortion.tolist()]
    values = {
        "lensmodel": f"{_PREFIX}OPENCV5",
        "intrinsics": numbers,
        "extrinsics": [*pose.rotation_vector().tolist(), *pose.translation.tolist()],
        "imagersize": [lens.width, lens.height],
    }
    return "{\n" + "".join(f"    {key!r}: {value!r},\n" for key, value in values.items()) + "}\n"


def is_mrcal(_path: Path, head: bytes) -> bool:
    """Whether a file speaks of a lens as mrcal does."""
    return _PREFIX.encode() in head and b"intrinsics" in head


def read_mrcal(path: Path) -> Held:
    """The lens and pose of one camera, named as the file. Raises QuadrigError where the model is none of OpenCV's."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        values = ast.literal_eval(read_whole(path, LARGEST_OF_CAMERAS).decode())
    kind = values["lensmodel"].removeprefix(_PREFIX)
    if kind not in _COEFFICIENTS:
        names = ", ".join(_COEFFICIENTS)
        raise QuadrigError(f"{path}: the model is {kind}; of mrcal's, quadrig reads {names}: mrcal-convert-lensmodel")
    fx, fy, cx, cy, *distortion = (float(value) for value in values["intrinsics"])
    if len(distortion) != _COEFFICIENTS[kind]:
        raise QuadrigError(f"{path}: {kind} has {_COEFFICIENTS[kind]} coefficients, not {len(distortion)}")
    name, where = path.stem, f"{path}"
    lens = lens_of(values["imagersize"], camera_matrix(fx, fy, cx, cy), distortion, where)
    # The older key and that of mrcal 2.5.
    seven = values.get("rt_cam_ref", values.get("extrinsics"))
    if seven is None:
        return Held({name: lens})
    step = np.array(seven, float)
    return Held({name: lens}, {name: Pose.from_vectors(step[:3], step[3:6]).inverse()})
