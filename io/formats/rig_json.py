"""Rigs as plain JSON: the format of quadrig's own, for programs of any language."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from quadrig.io.formats.format import Files, Held, Options, lens_of, pose_of, rig_of
from quadrig.io.rig_file.record import recorded_marking
from quadrig.io.safe_json import read_json as read_values
from quadrig.rig.doubt.lens_accuracy import lens_accuracy
from quadrig.rig.result import CAMERA_PARAMETERS, Camera, PlacedBody, PlacedRectangle, Rig, pose_sigmas
from quadrig.single.arrays import Floats, Ints
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS, LensModel
from quadrig.single.markings.registry import marking_values
from quadrig.single.pose import Pose, stacked
from quadrig.single.rectangle import PRINT_SCALE_SIGMA, Rectangle

JSON_VERSION = 1
"""Raised when a reader of the old file would misread the new one."""

_POSE_STEP = ("rx", "ry", "rz", "tx", "ty", "tz")
_CONVENTIONS = {
    "lengths": "metres",
    "pixels": "the centre of the top-left pixel is (0, 0)",
    "camera_axes": "x right, y down, z forward",
    "a_from_b": "4x4, takes coordinates in frame b to coordinates in frame a",
    "pinhole": "OpenCV's k1 k2 p1 p2 k3",
    "fisheye": "OpenCV's fisheye (Kannala-Brandt) k1 k2 k3 k4 0",
    "sigma.lens_px": "of where a point far away is seen, over the picture, whatever the pose",
    "sigma.lens": "px for focal, cx and cy; aspect is the focal along y over that along x",
    "line_time_s": "from one row of a picture to the next; null where not known",
    "clock_offset_s": "how much later than the mean of the cameras the middle row is taken, of one stamp",
    "bodies.sigma": "of body_from_rect and of rig_from_body, root mean square over the axes; null where not known",
    "sigma.pose": "of a small rotation (rad) and translation (m) that follow rig_from_camera, in the rig frame",
}


class _Sigma(msgspec.Struct):
    """Standard deviations; null where not known, zero where held."""

    lens: dict[str, float | None] = {}
    pose: dict[str, float | None] = {}
    focal_px: float | None = None
    lens_px: float | None = None
    rotation_deg: float | None = None
    position_m: float | None = None
    line_time_s: float | None = None
    clock_offset_s: float | None = None


class _Lens(msgspec.Struct, kw_only=True):
    """Lens of one camera."""

    width: int
    height: int
    model: LensModel
    camera_matrix: list[list[float]]
    distortion: list[float]
    sigma: _Sigma = msgspec.field(default_factory=_Sigma)
    rms_px: float | None = None
    clock_offset_s: float = 0.0
    line_time_s: float | None = None


class _Camera(_Lens, kw_only=True):
    """Lens and pose of one camera."""

    rig_from_camera: list[list[float]]


class _Rectangle(msgspec.Struct):
    """rig_from_rect: one pose (4x4) of what stands, one for each of `framesets` of what moves."""

    width: float
    height: float
    rig_from_rect: list[Any]
    marking: dict[str, Any] | None = None
    framesets: list[int] | None = None
    body: str = ""
    back: bool = False
    scale_sigma: float = PRINT_SCALE_SIGMA


class _PoseSigma(msgspec.Struct):
    """Sigmas of a pose, or of one for each frameset."""

    rotation_deg: Any = None
    position_m: Any = None


class _OnBody(msgspec.Struct):
    """Where a rectangle stands on its body: 4x4; zero sigmas where that is given, and of the body's frame."""

    body_from_rect: list[list[float]]
    sigma: _PoseSigma = msgspec.field(default_factory=_PoseSigma)


class _Body(msgspec.Struct):
    """Rectangles fixed to each other. rig_from_body: one pose (4x4) of what stands, one for each of `framesets` of
    what moves; is_room: the rig is carried through it."""

    rectangles: dict[str, _OnBody]
    rig_from_body: list[Any]
    framesets: list[int] | None = None
    is_room: bool = False
    sigma: _PoseSigma = msgspec.field(default_factory=_PoseSigma)


class _Covariance(msgspec.Struct):
    """Joint, over the cameras in their order: `order` names the rows, camera and parameter."""

    order: list[tuple[str, str]]
    matrix: list[list[float | None]]


class _File(msgspec.Struct):
    """A rig. lens_only: cameras that could not be placed in it."""

    cameras: dict[str, _Camera]
    rig_frame: str
    lens_only: dict[str, _Lens] = {}
    rectangles: dict[str, _Rectangle] = {}
    bodies: dict[str, _Body] = {}
    working_accuracy_mm: float | None = None
    point_accuracy_mm: float | None = None
    scale_sigma: float | None = None
    covariance: _Covariance | None = None
    format: str = "quadrig rig"
    version: int = JSON_VERSION
    conventions: dict[str, str] = {}


def json_files(rig: Rig, options: Options) -> Files:
    """Everything a program needs, with sigmas, as JSON; what is not determined is null."""
    return {"rig.json": json_text(rig_values(rig, covariance=options.covariance)) + "\n"}


def json_schema() -> dict[str, Any]:
    """The JSON Schema of these files."""
    return msgspec.json.schema(_File)


def is_rig_json(_path: Path, head: bytes) -> bool:
    """Whether a file begins like ours."""
    return head.lstrip()[:1] == b"{" and b'"rig_frame"' in head and b'"cameras"' in head


def read_json(path: Path) -> Held:
    """The Rig of our JSON. What doubt the file does not state is nan: all but the diagonal, where there are sigmas
    and no covariance. Raises QuadrigError where a newer quadrig wrote it."""
    held: _File = read_values(path.read_bytes(), _File)
    if held.version > JSON_VERSION:
        raise QuadrigError(f"{path}: has version {held.version}, this quadrig reads up to {JSON_VERSION}; upgrade it")
    poses = {
        name: pose_of(np.array(camera.rig_from_camera, float), f"{path}: camera {name!r}")
        for name, camera in held.cameras.items()
    }
    rig = _rig_of(held.cameras, poses, held.rig_frame, path)
    accuracies = (held.working_accuracy_mm, held.point_accuracy_mm, held.scale_sigma)
    working, point, scale = (np.nan if value is None else value for value in accuracies)
    if held.covariance is not None:
        rig = replace(rig, covariance=_joint_covariance(held.covariance, held.cameras, path))
    apart = [_rig_of({name: lens}, {name: Pose.identity()}, name, path) for name, lens in held.lens_only.items()]
    figures = {"working_accuracy": working / 1e3, "point_accuracy": point / 1e3, "scale_sigma": scale}
    rectangles = (_placed(name, each, f"{path}: rectangle {name!r}") for name, each in held.rectangles.items())
    found = tuple(placed for placed in rectangles if placed is not None)
    bodies = tuple(_placed_body(name, each, f"{path}: body {name!r}") for name, each in held.bodies.items())
    return Held(rig=replace(rig, **figures, apart=tuple(apart), rectangles=found, bodies=bodies))


def _placed(name: str, held: _Rectangle, where: str) -> PlacedRectangle | None:
    """The rectangle where it stood; None where the file does not say its marking, as older ones."""
    if held.marking is None:
        return None
    moving = held.framesets is not None
    rectangle = Rectangle(
        name,
        held.width,
        held.height,
        recorded_marking(held.marking),
        moving=moving,
        back=held.back,
        scale_sigma=held.scale_sigma,
        body=held.body,
    )
    return PlacedRectangle(rectangle, *_poses(held.rig_from_rect, held.framesets, where))


def _placed_body(name: str, held: _Body, where: str) -> PlacedBody:
    """The body where it stood, its doubt unknown."""
    names, count = tuple(held.rectangles), len(held.rectangles)
    layout, _, _ = _poses([one.body_from_rect for one in held.rectangles.values()], list(range(count)), where)
    unknown = np.full((6 * count, 6 * count), np.nan)
    return PlacedBody(name, names, layout, unknown, *_poses(held.rig_from_body, held.framesets, where))


def _poses(matrices: list[Any], framesets: list[int] | None, where: str) -> tuple[Pose, Floats, Ints]:
    """A pose, or one for each frameset, with covariances that nobody knows."""
    many = 1 if framesets is None else len(framesets)
    poses = stacked([pose_of(matrix, where) for matrix in np.array(matrices, float).reshape(many, 4, 4)])
    unknown = np.full((many, 6, 6), np.nan)
    if framesets is None:
        return poses[0], unknown[0], np.zeros(0, int)
    return poses, unknown, np.array(framesets, int)


def _rig_of(cameras: Mapping[str, _Lens], poses: Mapping[str, Pose], frame: str, path: Path) -> Rig:
    """The cameras at these poses, with what doubt of each its sigmas state."""
    lenses = {}
    for name, camera in cameras.items():
        size, matrix = (camera.width, camera.height), np.array(camera.camera_matrix, float)
        lenses[name] = lens_of(size, matrix, camera.distortion, f"{path}: camera {name!r}", camera.model)
    rig = rig_of(lenses, poses, frame)
    placed = tuple(
        replace(
            camera,
            rms=_or_nan(held.rms_px),
            clock_offset=held.clock_offset_s,
            line_time=_or_nan(held.line_time_s),
            line_time_sigma=_or_nan(held.sigma.line_time_s),
            clock_offset_sigma=_or_nan(held.sigma.clock_offset_s),
        )
        for camera, held in zip(rig.cameras, cameras.values(), strict=True)
    )
    return replace(rig, cameras=placed, covariance=_own_covariance(cameras))


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def json_text(values: object) -> str:
    """JSON of nested values and arrays; JSON has no nan and no infinity, which become null."""
    return json.dumps(_plain(values), indent=2)


def rig_values(rig: Rig, *, covariance: bool = False) -> dict[str, Any]:
    """The values of the JSON export: poses 4x4 in the rig frame, metres; sigma in px, degrees, metres."""
    values = {
        "format": "quadrig rig",
        "version": JSON_VERSION,
        "conventions": _CONVENTIONS,
        "rig_frame": rig.reference,
        "cameras": {camera.name: _camera_values(rig, camera) for camera in rig.cameras},
        "lens_only": {camera.name: _lens_values(own, camera) for own, camera in rig.lens_only},
        "working_accuracy_mm": 1e3 * rig.working_accuracy,
        "point_accuracy_mm": 1e3 * rig.point_accuracy,
        "scale_sigma": rig.scale_sigma,
        "rectangles": {placed.name: _rectangle_values(placed) for placed in rig.rectangles},
        "bodies": {body.name: _body_values(body) for body in rig.bodies},
    }
    if not covariance:
        return values
    order = [(camera.name, name) for camera in rig.cameras for name in _parameters(camera.intrinsics.model)]
    return {**values, "covariance": {"order": order, "matrix": rig.covariance}}


def _parameters(model: LensModel) -> tuple[str, ...]:
    """The names of a camera's rows of the covariance, those of its lens as its model calls them."""
    renamed = {"p1": "k3", "p2": "k4", "k3": "unused"} if model == "fisheye" else {}
    return (*(renamed.get(name, name) for name in LENS_PARAMETERS), *_POSE_STEP)


def _camera_values(rig: Rig, camera: Camera) -> dict[str, Any]:
    lens = camera.intrinsics
    start = rig.camera_index(camera.name) * CAMERA_PARAMETERS
    sigmas = np.sqrt(np.diag(rig.covariance)[start : start + CAMERA_PARAMETERS])
    stated = dict(zip(_parameters(lens.model), sigmas, strict=True))
    return {
        "width": lens.width,
        "height": lens.height,
        "model": lens.model,
        "camera_matrix": lens.camera_matrix,
        "distortion": lens.distortion,
        "rig_from_camera": camera.rig_from_camera.matrix(),
        "sigma": {
            "focal_px": rig.focal_sigma(camera.name),
            "lens_px": lens_accuracy(rig, camera.name),
            "rotation_deg": np.degrees(rig.rotation_sigma(camera.name)),
            "position_m": rig.position_sigma(camera.name),
            "line_time_s": camera.line_time_sigma,
            "clock_offset_s": camera.clock_offset_sigma,
            "lens": {name: sigma for name, sigma in stated.items() if name not in _POSE_STEP},
            "pose": {name: stated[name] for name in _POSE_STEP},
        },
        "rms_px": camera.rms,
        "clock_offset_s": camera.clock_offset,
        "line_time_s": camera.line_time,
    }


def _lens_values(rig: Rig, camera: Camera) -> dict[str, Any]:
    """The values of a camera that has no pose."""
    values = _camera_values(rig, camera)
    own = ("focal_px", "lens_px", "lens", "line_time_s", "clock_offset_s")
    sigma = {key: value for key, value in values["sigma"].items() if key in own}
    return {**{key: value for key, value in values.items() if key != "rig_from_camera"}, "sigma": sigma}


def _rectangle_values(placed: PlacedRectangle) -> dict[str, Any]:
    values = {
        "width": placed.rectangle.width,
        "height": placed.rectangle.height,
        "marking": marking_values(placed.rectangle.marking),
        "body": placed.rectangle.body,
        "back": placed.rectangle.back,
        "scale_sigma": placed.rectangle.scale_sigma,
        "rig_from_rect": placed.rig_from_rect.matrix(),
    }
    return {**values, "framesets": np.asarray(placed.framesets)} if placed.rectangle.moving else values


def _body_values(body: PlacedBody) -> dict[str, Any]:
    layout = body.layout_sigmas()
    values = {
        "rectangles": {
            name: {"body_from_rect": body.body_from_rect[row].matrix(), "sigma": _pose_sigma(layout[:, row])}
            for row, name in enumerate(body.rectangles)
        },
        "is_room": body.is_room,
        "rig_from_body": body.rig_from_body.matrix(),
        "sigma": _pose_sigma(pose_sigmas(body.covariance)),
    }
    return {**values, "framesets": np.asarray(body.framesets)} if len(body.framesets) else values


def _pose_sigma(sigmas: Floats) -> dict[str, Any]:
    """Of rotation, rad, and position, m, (2, ...)."""
    return {"rotation_deg": np.degrees(sigmas[0]), "position_m": sigmas[1]}


def _joint_covariance(held: _Covariance, cameras: Mapping[str, _Lens], path: Path) -> Floats:
    """(15 C, 15 C) as the file states it."""
    size, matrix = CAMERA_PARAMETERS * len(cameras), np.array(held.matrix, float)
    order = [(name, each) for name, camera in cameras.items() for each in _parameters(camera.model)]
    if matrix.shape != (size, size) or held.order != order:
        raise QuadrigError(f"{path}: the covariance is not that of its cameras in their order; write it again")
    return matrix


def _own_covariance(cameras: Mapping[str, _Lens]) -> Floats:
    """(15 C, 15 C) of which sigmas state the diagonal: nan off it, zero along what is held."""
    sigmas = np.array(
        [_sigma(camera.sigma, name) for camera in cameras.values() for name in _parameters(camera.model)]
    )
    covariance = np.full((len(sigmas), len(sigmas)), np.nan)
    np.fill_diagonal(covariance, sigmas**2)
    covariance[sigmas == 0] = covariance[:, sigmas == 0] = 0
    return covariance


def _sigma(sigma: _Sigma, name: str) -> float:
    value = (sigma.pose if name in _POSE_STEP else sigma.lens).get(name)
    return np.nan if value is None else value


def _plain(value: object) -> object:
    match value:
        case dict():
            return {key: _plain(item) for key, item in value.items()}
        case np.ndarray():
            return _plain(value.tolist())
        case list() | tuple():
            return [_plain(item) for item in value]
        case float() | np.floating():
            return float(value) if np.isfinite(value) else None
        case _:
            return value
