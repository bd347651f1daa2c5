"""What a format of other programs is, and what a file in it says of cameras."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from quadrig.rig.result import CAMERA_PARAMETERS, Camera, Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, LensModel
from quadrig.single.pose import Pose
from quadrig.single.rotation import nearest_rotation, rotation_from_quaternion

Files = dict[str, str | bytes]

HALF_PIXEL = 0.5
"""What a principal point gains where pixels count from the corner of the top-left pixel, not from its centre."""

GRAPHICS = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""camera_from_graphics, and its inverse: graphics look along -z with y up, cameras along z with y down."""

# A rotation written with four decimals is off by less; what is off by more is no rotation, or another convention.
_ROTATION_TOLERANCE = 1e-3
# Nearer than this to the identity a camera's frame is the rig's: the last digits of a matrix that was inverted.
_SAME_FRAME = 1e-9
# Focal lengths and points of pictures that exist lie below this many pixels.
_LARGEST = 1e6


@dataclass(frozen=True, eq=False)
class Held:
    """What one file says: lenses by camera, poses rig_from_camera by camera, and the rig frame's name ("": none).

    A lens whose image size is 0 x 0 is one whose size the file does not say.
    unit: metres of one unit of its lengths, None where the file does not say. rig: the whole of it with its doubt,
    where the format holds that; the rest is then empty.
    """

    lenses: Mapping[str, Intrinsics] = field(default_factory=dict)
    poses: Mapping[str, Pose] = field(default_factory=dict)
    frame: str = ""
    unit: float | None = 1.0
    rig: Rig | None = None


@dataclass(frozen=True, eq=False)
class Options:
    """What a user may ask of an export.

    covariance: the joint covariance too, where the format has a place for it. base: the name of the frame that
    carries the rig, where the format has frames, and base_from_rig.
    """

    covariance: bool = False
    base: str = "rig"
    base_from_rig: Pose = field(default_factory=Pose.identity)


@dataclass(frozen=True)
class Format:
    """A format of rigs.

    what: it is, and loses: of a rig, in words. suffixes: of its one file, the first of which chooses it; empty where
    it is several files in a folder. write: a rig's files by name. read: what a file (or a folder) says.
    recognises: from a path and the first bytes of its content. names: cameras' names as the format can hold them.
    ideal: it holds no distortion, and square pixels alone. lenses: it holds lenses alone, and so cameras that have no
    pose too.
    """

    what: str
    loses: str
    write: Callable[[Rig, Options], Files] | None = None
    suffixes: tuple[str, ...] = ()
    read: Callable[[Path], Held] | None = None
    recognises: Callable[[Path, bytes], bool] = lambda _path, _head: False
    names: Callable[[Sequence[str]], list[str]] = list
    ideal: bool = False
    lenses: bool = False


def plain_names(names: Sequence[str]) -> list[str]:
    """The names in letters, digits and _, a letter first, of 60 at most (Blender keeps 63); distinct, also where
    capitals do not count."""
    plain = [re.sub("[^A-Za-z0-9_]", "_", name.strip("/"))[:60] for name in names]
    return _distinct([name if name[:1].isalpha() else f"cam_{name}" for name in plain])


def opencv_names(names: Sequence[str]) -> list[str]:
    """The names without the backslashes and single quotes that OpenCV writes as neither YAML nor JSON reads them."""
    return _distinct([re.sub(r"[\\']", "_", name) for name in names])


def _distinct(names: Sequence[str]) -> list[str]:
    taken: list[str] = []
    for name in names:
        unique, number = name, 2
        while unique.casefold() in (each.casefold() for each in taken):
            unique, number = f"{name}_{number}", number + 1
        taken.append(unique)
    return taken


def lens_of(
    size: Sequence[float] | Floats | None,
    matrix: Floats,
    distortion: Sequence[float] | Floats,
    where: str,
    model: LensModel = "pinhole",
) -> Intrinsics:
    """The lens of an image size (width, height), camera matrix (3, 3) and OpenCV's coefficients of the model.

    Without a size, where the file does not say it, that of the lens is 0 x 0.
    Pixels as ours. Raises QuadrigError where the numbers are none of a lens, or are more than our models hold: skew,
    or coefficients past k3 of a pinhole and past k4 of a fisheye that are not zero.
    """
    matrix, given = np.asarray(matrix, float), np.asarray(distortion, float).ravel()
    width, height = (int(value) for value in ((1, 1) if size is None else size))
    if matrix.shape != (3, 3) or not (np.isfinite(matrix).all() and np.isfinite(given).all()):
        raise QuadrigError(f"{where}: the lens has no nine finite numbers as its camera matrix; write the file again")
    if not (0 < width < _LARGEST and 0 < height < _LARGEST and 0 < matrix[0, 0] < _LARGEST and matrix[1, 1] > 0):
        raise QuadrigError(
            f"{where}: an image of {width} x {height} and focal lengths of {matrix[0, 0]:g} and {matrix[1, 1]:g} px "
            "are no camera's; write the file again"
        )
    if matrix[0, 1] != 0:
        raise QuadrigError(f"{where}: the camera matrix has a skew of {matrix[0, 1]:g}; quadrig's lenses have none")
    most = 5 if model == "pinhole" else 4
    if np.any(given[most:]):
        raise QuadrigError(
            f"{where}: the lens has {len(given)} coefficients, {most} of which a {model} lens of quadrig holds; "
            "calibrate that camera with fewer"
        )
    coefficients = np.zeros(5)
    coefficients[: min(len(given), most)] = given[:most]
    focal = float(matrix[0, 0])
    width, height = (width, height) if size is not None else (0, 0)
    return Intrinsics(width, height, focal, matrix[:2, 2].copy(), coefficients, float(matrix[1, 1]) / focal, model)


def pinhole_only(camera: Camera, program: str) -> Intrinsics:
    """The camera's lens. Raises QuadrigError where it is a fisheye, which the program does not know."""
    if camera.intrinsics.model != "pinhole":
        raise QuadrigError(f"camera {camera.name!r} is a fisheye, which {program} does not know; take another format")
    return camera.intrinsics


def coefficients(lens: Intrinsics) -> Floats:
    """OpenCV's: k1 k2 p1 p2 k3 of a pinhole, k1 k2 k3 k4 of a fisheye."""
    return lens.distortion if lens.model == "pinhole" else lens.distortion[:4]


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Floats:
    """K (3, 3)."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def pose_of(matrix: Floats, where: str) -> Pose:
    """The pose of a matrix (4, 4) or (3, 4). Raises QuadrigError where it is no rigid motion."""
    matrix = np.asarray(matrix, float)
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise QuadrigError(f"{where}: the pose is no matrix of 4 x 4 finite numbers; write the file again")
    rotation = nearest_rotation(matrix[:3, :3])
    if np.abs(rotation - matrix[:3, :3]).max() > _ROTATION_TOLERANCE:
        raise QuadrigError(f"{where}: the pose's 3 x 3 part is no rotation; write the file again")
    return Pose(rotation, matrix[:3, 3].copy())


def pose_of_quaternion(xyzw: Sequence[float], translation: Sequence[float], where: str) -> Pose:
    """The pose of a unit quaternion (x, y, z, w) and a translation. Raises QuadrigError where its length is not 1."""
    quaternion = np.array(xyzw, float)
    if not abs(np.linalg.norm(quaternion) - 1) < _ROTATION_TOLERANCE:
        raise QuadrigError(f"{where}: a quaternion has the length {np.linalg.norm(quaternion):.3g}, not 1; mend it")
    return Pose(rotation_from_quaternion(quaternion), np.array(translation, float))


def rig_of(lenses: Mapping[str, Intrinsics], poses: Mapping[str, Pose], frame: str = "") -> Rig:
    """A Rig of lenses and poses whose doubt is not known: nan throughout, but for the pose that is the rig frame."""
    cameras = tuple(Camera(name, lens, poses[name], lens_reason="as imported") for name, lens in lenses.items())
    covariance = np.full((CAMERA_PARAMETERS * len(cameras),) * 2, np.nan)
    reference = frame or "world"
    for index, camera in enumerate(cameras):
        if np.abs(camera.rig_from_camera.matrix() - np.eye(4)).max() < _SAME_FRAME:
            rows = slice(CAMERA_PARAMETERS * index + 9, CAMERA_PARAMETERS * (index + 1))
            covariance[rows] = covariance[:, rows] = 0
            reference = camera.name
            break
    return Rig(reference, cameras, (), covariance)
