"""Our full record of a Rig, as JSON messages: every number a float64 that comes back to the last bit.

JSON has no nan and no infinity: they are written as null and as the strings "inf" and "-inf".
A Rig is one RigRecord and a ViewRecord for each of its ViewFits, so that a reader can take the poses and leave the
points. Matrices are lists of rows.
"""

from dataclasses import asdict
from typing import Any

import msgspec
import numpy as np

from quadrig.rig.result import Camera, PlacedRectangle, Rig, ViewFit
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, LensModel
from quadrig.single.marking import CharucoMarking, ChessboardMarking, Marking, PlainMarking, PointsMarking, TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

RECORD_FORMAT = 1
"""Raised when a reader of the old record would misread the new one."""

Number = float | str | None
_MARKINGS = (TagMarking, CharucoMarking, ChessboardMarking, PlainMarking, PointsMarking)


class LensRecord(msgspec.Struct):
    """Intrinsics: pixels, and the five distortion coefficients in the order of the model."""

    width: int
    height: int
    model: LensModel
    focal: Number
    principal_point: list[Number]
    distortion: list[Number]
    aspect: Number


class CameraRecord(msgspec.Struct):
    """A Camera; rig_from_camera is 4x4."""

    name: str
    lens: LensRecord
    rig_from_camera: list
    free_lens: tuple[str, ...] = ()
    lens_reason: str = ""
    rms: Number = None
    left_out_rms: Number = None
    views: int = 0
    observable_focal: bool = True
    clock_offset: Number = 0.0


class RectangleRecord(msgspec.Struct):
    """A PlacedRectangle; rig_from_rect is 4x4 where static, (F, 4, 4) where moving."""

    name: str
    width: float
    height: float
    marking: dict[str, Any]
    moving: bool
    world_from_rect: list | None
    rig_from_rect: list
    covariance: list
    framesets: list[int]


class RigRecord(msgspec.Struct):
    """A Rig without its Views. times: ns since 1970 of each frameset, by index, where the recording had them."""

    format: int
    reference: str
    cameras: list[CameraRecord]
    rectangles: list[RectangleRecord]
    covariance: list
    noise: Number
    rms: Number
    left_out_rms: Number
    working_accuracy: Number
    missing: dict[str, str]
    weak: tuple[str, ...]
    costs: list[Number]
    times: list[int] = []
    dispersion: Number = 1.0


class ViewRecord(msgspec.Struct):
    """A ViewFit with its View: points (P, 3) m, pixels (P, 2), residuals (P, 2) px."""

    rectangle: str
    camera: str
    frameset: int
    points: list
    pixels: list
    alternatives: list
    sigma: float
    residuals: list
    used: list[bool]
    reading: int
    rejected: str
    time: Number = None


def encode_rig(rig: Rig, times: tuple[int, ...] = ()) -> bytes:
    """The RigRecord of a Rig, as JSON."""
    return msgspec.json.encode(
        RigRecord(
            format=RECORD_FORMAT,
            reference=rig.reference,
            cameras=[_camera_record(camera) for camera in rig.cameras],
            rectangles=[_rectangle_record(placed) for placed in rig.rectangles],
            covariance=_listed(rig.covariance),
            noise=_number(rig.noise),
            rms=_number(rig.rms),
            left_out_rms=_number(rig.left_out_rms),
            working_accuracy=_number(rig.working_accuracy),
            missing=dict(rig.missing),
            weak=tuple(rig.weak),
            costs=[_number(cost) for cost in rig.costs],
            times=[int(time) for time in times],
            dispersion=_number(rig.dispersion),
        )
    )


def encode_view(fit: ViewFit) -> bytes:
    """The ViewRecord of a ViewFit, as JSON."""
    view = fit.view
    return msgspec.json.encode(
        ViewRecord(
            rectangle=view.rectangle,
            camera=view.camera,
            frameset=int(view.frameset),
            points=_listed(view.points),
            pixels=_listed(view.pixels),
            alternatives=[_listed(points) for points in view.alternatives],
            sigma=float(view.sigma),
            residuals=_listed(fit.residuals),
            used=np.asarray(fit.used, bool).tolist(),
            reading=int(fit.reading),
            rejected=fit.rejected,
            time=_number(view.time),
        )
    )


def decode_rig(record: bytes, fits: tuple[ViewFit, ...] = ()) -> tuple[Rig, tuple[int, ...]]:
    """The Rig of a RigRecord, holding these ViewFits, and the times of its framesets.

    Raises QuadrigError where the record is of a newer format, msgspec.DecodeError where it is no such record.
    """
    held = msgspec.json.decode(record, type=RigRecord)
    if held.format > RECORD_FORMAT:
        raise QuadrigError(
            f"the rig record has format {held.format} and this quadrig reads up to {RECORD_FORMAT}; upgrade quadrig"
        )
    rig = Rig(
        reference=held.reference,
        cameras=tuple(_camera(camera) for camera in held.cameras),
        rectangles=tuple(_placed_rectangle(rectangle) for rectangle in held.rectangles),
        covariance=_array(held.covariance),
        fits=fits,
        noise=_float(held.noise),
        rms=_float(held.rms),
        left_out_rms=_float(held.left_out_rms),
        working_accuracy=_float(held.working_accuracy),
        missing=held.missing,
        weak=held.weak,
        costs=tuple(_float(cost) for cost in held.costs),
        dispersion=_float(held.dispersion),
    )
    return rig, tuple(held.times)


def decode_view(record: bytes) -> ViewFit:
    """The ViewFit of a ViewRecord. Raises msgspec.DecodeError where it is none."""
    held = msgspec.json.decode(record, type=ViewRecord)
    view = View(
        rectangle=held.rectangle,
        points=_array(held.points).reshape(-1, 3),
        pixels=_array(held.pixels).reshape(-1, 2),
        camera=held.camera,
        frameset=held.frameset,
        alternatives=tuple(_array(points).reshape(-1, 3) for points in held.alternatives),
        sigma=held.sigma,
        time=_float(held.time),
    )
    residuals = _array(held.residuals).reshape(-1, 2)
    return ViewFit(view, residuals, np.array(held.used, bool), held.reading, held.rejected)


def _camera_record(camera: Camera) -> CameraRecord:
    lens = camera.intrinsics
    return CameraRecord(
        name=camera.name,
        lens=LensRecord(
            width=int(lens.width),
            height=int(lens.height),
            model=lens.model,
            focal=_number(lens.focal),
            principal_point=_listed(lens.principal_point),
            distortion=_listed(lens.distortion),
            aspect=_number(lens.aspect),
        ),
        rig_from_camera=_listed(camera.rig_from_camera.matrix()),
        free_lens=tuple(camera.free_lens),
        lens_reason=camera.lens_reason,
        rms=_number(camera.rms),
        left_out_rms=_number(camera.left_out_rms),
        views=int(camera.views),
        observable_focal=bool(camera.observable_focal),
        clock_offset=_number(camera.clock_offset),
    )


def _camera(held: CameraRecord) -> Camera:
    lens = held.lens
    return Camera(
        name=held.name,
        intrinsics=Intrinsics(
            width=lens.width,
            height=lens.height,
            focal=_float(lens.focal),
            principal_point=_array(lens.principal_point),
            distortion=_array(lens.distortion),
            aspect=_float(lens.aspect),
            model=lens.model,
        ),
        rig_from_camera=Pose.from_matrix(_array(held.rig_from_camera)),
        free_lens=held.free_lens,
        lens_reason=held.lens_reason,
        rms=_float(held.rms),
        left_out_rms=_float(held.left_out_rms),
        views=held.views,
        observable_focal=held.observable_focal,
        clock_offset=_float(held.clock_offset),
    )


def _rectangle_record(placed: PlacedRectangle) -> RectangleRecord:
    rectangle = placed.rectangle
    world = rectangle.world_from_rect
    return RectangleRecord(
        name=rectangle.name,
        width=float(rectangle.width),
        height=float(rectangle.height),
        marking=asdict(rectangle.marking),
        moving=rectangle.moving,
        world_from_rect=None if world is None else _listed(world.matrix()),
        rig_from_rect=_listed(placed.rig_from_rect.matrix()),
        covariance=_listed(placed.covariance),
        framesets=np.asarray(placed.framesets, int).tolist(),
    )


def _placed_rectangle(held: RectangleRecord) -> PlacedRectangle:
    world = None if held.world_from_rect is None else Pose.from_matrix(_array(held.world_from_rect))
    rectangle = Rectangle(held.name, held.width, held.height, _marking(held.marking), held.moving, world)
    one_or_many = (-1,) if held.moving else ()
    return PlacedRectangle(
        rectangle=rectangle,
        rig_from_rect=Pose.from_matrix(_array(held.rig_from_rect).reshape(*one_or_many, 4, 4)),
        covariance=_array(held.covariance).reshape(*one_or_many, 6, 6),
        framesets=np.array(held.framesets, int),
    )


def _marking(held: dict[str, Any]) -> Marking:
    for kind in _MARKINGS:
        if held.get("kind") == kind.kind:
            return msgspec.convert(held, type=kind)
    raise QuadrigError(f"the rig record has a marking of kind {held.get('kind')!r}; upgrade quadrig")


def _number(value: float) -> Number:
    value = float(value)
    if np.isfinite(value):
        return value
    return None if np.isnan(value) else str(value)


def _float(held: Number) -> float:
    return float("nan") if held is None else float(held)


def _listed(values: Floats) -> list:
    values = np.asarray(values, float)
    if np.isfinite(values).all():
        return values.tolist()
    return np.array([_number(value) for value in values.ravel()], object).reshape(values.shape).tolist()


def _array(held: list) -> Floats:
    return np.array(held, float)
