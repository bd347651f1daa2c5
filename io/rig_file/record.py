"""Our full record of a Rig, as JSON messages: every number a float64 that comes back to the last bit.

A Rig is one RigRecord and a FitRecord for each of its ViewFits, so that a reader can take the poses and leave the
points. Matrices are lists of rows.
"""

from typing import Any

import msgspec
import numpy as np

from quadrig.io.rig_file.json_numbers import Number, number, numbers, read_number, read_numbers
from quadrig.io.rig_file.view_record import ViewRecord, recorded_view, view_record
from quadrig.io.safe_json import read_json
from quadrig.rig.result import CAMERA_PARAMETERS, Camera, PlacedBody, PlacedRectangle, Rig, ViewFit
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, LensModel
from quadrig.single.lens_prior import LensEvidence
from quadrig.single.markings.registry import marking_kind, marking_values
from quadrig.single.pose import Pose
from quadrig.single.posterior.sheet_shape import SHAPE_PARAMETERS, SheetShape
from quadrig.single.rectangle import PRINT_SCALE_SIGMA, WORLD, Marking, Rectangle

RECORD_FORMAT = 1
"""Raised when a reader of the old record would misread the new one."""


class LensRecord(msgspec.Struct):
    """Intrinsics: pixels, and the five distortion coefficients in the order of the model."""

    width: int
    height: int
    model: LensModel
    focal: Number
    principal_point: list[Number]
    distortion: list[Number]
    aspect: Number


class EvidenceRecord(msgspec.Struct):
    """LensEvidence: pull (9,) and information (9, 9)."""

    pull: list
    information: list


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
    line_time: Number = None
    line_time_sigma: Number = None
    clock_offset_sigma: Number = None
    lens_evidence: EvidenceRecord | None = None
    remainder: Number = None


class RectangleRecord(msgspec.Struct):
    """A PlacedRectangle; rig_from_rect is 4x4 where static, (F, 4, 4) where moving. shape: values and covariance.
    world_from_rect: body_from_rect of files that know one body only, the world."""

    name: str
    width: float
    height: float
    marking: dict[str, Any]
    moving: bool
    rig_from_rect: list
    covariance: list
    framesets: list[int]
    world_from_rect: list | None = None
    back: bool = False
    scale_sigma: float = PRINT_SCALE_SIGMA
    shape: list | None = None
    body: str = ""
    sheet: str = ""
    body_from_rect: list | None = None
    layout_sigma: tuple[float, float] = (0.0, 0.0)


class BodyRecord(msgspec.Struct):
    """A PlacedBody; rig_from_body is 4x4 where it stands still, (F, 4, 4) where it moves; body_from_rect is (K, 4,
    4)."""

    name: str
    rectangles: tuple[str, ...]
    body_from_rect: list
    layout_covariance: list
    rig_from_body: list
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
    apart: list["RigRecord"] = []
    point_accuracy: Number = None
    scale_sigma: Number = None
    bodies: list[BodyRecord] = []


class FitRecord(ViewRecord, kw_only=True):
    """A ViewFit: the fields of its View beside its own; residuals (P, 2) px."""

    residuals: list
    used: list[bool]
    reading: int
    rejected: str


def encode_rig(rig: Rig, times: tuple[int, ...] = ()) -> bytes:
    """The RigRecord of a Rig, as JSON."""
    return msgspec.json.encode(_rig_record(rig, times))


def _rig_record(rig: Rig, times: tuple[int, ...] = ()) -> RigRecord:
    return RigRecord(
        format=RECORD_FORMAT,
        reference=rig.reference,
        cameras=[_camera_record(camera) for camera in rig.cameras],
        rectangles=[_rectangle_record(placed) for placed in rig.rectangles],
        covariance=numbers(rig.covariance),
        noise=number(rig.noise),
        rms=number(rig.rms),
        left_out_rms=number(rig.held_out_rms),
        working_accuracy=number(rig.working_accuracy),
        point_accuracy=number(rig.point_accuracy),
        scale_sigma=number(rig.scale_sigma),
        missing=dict(rig.missing),
        weak=tuple(rig.weak),
        costs=[number(cost) for cost in rig.costs],
        times=[int(time) for time in times],
        dispersion=number(rig.dispersion),
        apart=[_rig_record(each) for each in rig.apart],
        bodies=[_body_record(body) for body in rig.bodies],
    )


def encode_fit(fit: ViewFit) -> bytes:
    """The FitRecord of a ViewFit, as JSON."""
    return msgspec.json.encode(
        FitRecord(
            **msgspec.structs.asdict(view_record(fit.view)),
            residuals=numbers(fit.residuals),
            used=np.asarray(fit.used, bool).tolist(),
            reading=int(fit.reading),
            rejected=fit.rejected,
        )
    )


def decode_rig(record: bytes, fits: tuple[ViewFit, ...] = ()) -> tuple[Rig, tuple[int, ...]]:
    """The Rig of a RigRecord, holding these ViewFits, and the times of its framesets.

    Raises QuadrigError where the record is of a newer format, ValueError where it is no such record.
    """
    held: RigRecord = read_json(record, RigRecord)
    if held.format > RECORD_FORMAT:
        raise QuadrigError(
            f"the rig record has format {held.format} and this quadrig reads up to {RECORD_FORMAT}; upgrade quadrig"
        )
    return _rig(held, fits), tuple(held.times)


def _rig(held: RigRecord, fits: tuple[ViewFit, ...]) -> Rig:
    """The Rig of a record, with those of the fits that are of its cameras."""
    apart = tuple(_rig(each, fits) for each in held.apart)
    own = {camera.name for camera in held.cameras}
    size = CAMERA_PARAMETERS * len(held.cameras)
    return Rig(
        reference=held.reference,
        cameras=tuple(_camera(camera) for camera in held.cameras),
        rectangles=tuple(_placed_rectangle(rectangle) for rectangle in held.rectangles),
        covariance=read_numbers(held.covariance, size, size),
        fits=tuple(fit for fit in fits if fit.view.camera in own),
        noise=read_number(held.noise),
        rms=read_number(held.rms),
        held_out_rms=read_number(held.left_out_rms),
        working_accuracy=read_number(held.working_accuracy),
        point_accuracy=read_number(held.point_accuracy),
        scale_sigma=read_number(held.scale_sigma),
        missing=held.missing,
        weak=held.weak,
        costs=tuple(read_number(cost) for cost in held.costs),
        dispersion=read_number(held.dispersion),
        apart=apart,
        bodies=tuple(_placed_body(body) for body in held.bodies),
    )


def decode_fit(record: bytes) -> ViewFit:
    """The ViewFit of a FitRecord. Raises ValueError, of which msgspec's errors are, where it is none."""
    held: FitRecord = read_json(record, FitRecord)
    view = recorded_view(held)
    if len(held.used) != len(view.pixels) or held.reading not in range(len(view.readings)):
        raise ValueError(f"a View of {len(view.pixels)} points with {len(held.used)} marks, reading {held.reading}")
    residuals = read_numbers(held.residuals, len(view.pixels), 2)
    return ViewFit(view, residuals, np.array(held.used, bool), held.reading, held.rejected)


def _camera_record(camera: Camera) -> CameraRecord:
    lens, evidence = camera.intrinsics, camera.lens_evidence
    return CameraRecord(
        name=camera.name,
        lens=LensRecord(
            width=int(lens.width),
            height=int(lens.height),
            model=lens.model,
            focal=number(lens.focal),
            principal_point=numbers(lens.principal_point),
            distortion=numbers(lens.distortion),
            aspect=number(lens.aspect),
        ),
        rig_from_camera=numbers(camera.rig_from_camera.matrix()),
        free_lens=tuple(camera.free_lens),
        lens_reason=camera.lens_reason,
        rms=number(camera.rms),
        left_out_rms=number(camera.held_out_rms),
        views=int(camera.views),
        observable_focal=bool(camera.observable_focal),
        clock_offset=number(camera.clock_offset),
        line_time=number(camera.line_time),
        line_time_sigma=number(camera.line_time_sigma),
        clock_offset_sigma=number(camera.clock_offset_sigma),
        remainder=number(camera.remainder),
        lens_evidence=None
        if evidence is None
        else EvidenceRecord(numbers(evidence.pull), numbers(evidence.information)),
    )


def _camera(held: CameraRecord) -> Camera:
    lens, evidence = held.lens, held.lens_evidence
    return Camera(
        name=held.name,
        intrinsics=Intrinsics(
            width=lens.width,
            height=lens.height,
            focal=read_number(lens.focal),
            principal_point=read_numbers(lens.principal_point, 2),
            distortion=read_numbers(lens.distortion, 5),
            aspect=read_number(lens.aspect),
            model=lens.model,
        ),
        rig_from_camera=Pose.from_matrix(read_numbers(held.rig_from_camera, 4, 4)),
        free_lens=held.free_lens,
        lens_reason=held.lens_reason,
        rms=read_number(held.rms),
        held_out_rms=read_number(held.left_out_rms),
        views=held.views,
        observable_focal=held.observable_focal,
        clock_offset=read_number(held.clock_offset),
        line_time=read_number(held.line_time),
        line_time_sigma=read_number(held.line_time_sigma),
        clock_offset_sigma=read_number(held.clock_offset_sigma),
        remainder=read_number(held.remainder),
        lens_evidence=None
        if evidence is None
        else LensEvidence(read_numbers(evidence.pull, 9), read_numbers(evidence.information, 9, 9)),
    )


def _rectangle_record(placed: PlacedRectangle) -> RectangleRecord:
    rectangle = placed.rectangle
    on_body = rectangle.body_from_rect
    return RectangleRecord(
        name=rectangle.name,
        width=float(rectangle.width),
        height=float(rectangle.height),
        marking=marking_values(rectangle.marking),
        moving=rectangle.moving,
        body=rectangle.body,
        sheet=rectangle.sheet,
        body_from_rect=None if on_body is None else numbers(on_body.matrix()),
        layout_sigma=rectangle.layout_sigma,
        rig_from_rect=numbers(placed.rig_from_rect.matrix()),
        covariance=numbers(placed.covariance),
        framesets=np.asarray(placed.framesets, int).tolist(),
        back=rectangle.back,
        scale_sigma=float(rectangle.scale_sigma),
        shape=None if placed.shape is None else [numbers(placed.shape.values), numbers(placed.shape.covariance)],
    )


def _placed_rectangle(held: RectangleRecord) -> PlacedRectangle:
    on_body = held.world_from_rect or held.body_from_rect
    rectangle = Rectangle(
        held.name,
        held.width,
        held.height,
        recorded_marking(held.marking),
        held.moving,
        held.back,
        held.scale_sigma,
        WORLD if held.world_from_rect else held.body,
        None if on_body is None else Pose.from_matrix(read_numbers(on_body, 4, 4)),
        held.layout_sigma,
        held.sheet,
    )
    one_or_many = (len(held.framesets),) if held.moving else ()
    shape, count = None, len(SHAPE_PARAMETERS)
    if held.shape is not None:
        values, covariance = held.shape
        shape = SheetShape(read_numbers(values, count), read_numbers(covariance, count, count))
    return PlacedRectangle(
        rectangle=rectangle,
        rig_from_rect=Pose.from_matrix(read_numbers(held.rig_from_rect, *one_or_many, 4, 4)),
        covariance=read_numbers(held.covariance, *one_or_many, 6, 6),
        framesets=np.array(held.framesets, int),
        shape=shape,
    )


def _body_record(body: PlacedBody) -> BodyRecord:
    return BodyRecord(
        body.name,
        body.rectangles,
        numbers(body.body_from_rect.matrix()),
        numbers(body.layout_covariance),
        numbers(body.rig_from_body.matrix()),
        numbers(body.covariance),
        np.asarray(body.framesets, int).tolist(),
    )


def _placed_body(held: BodyRecord) -> PlacedBody:
    count, many = len(held.rectangles), (len(held.framesets),) if held.framesets else ()
    return PlacedBody(
        held.name,
        held.rectangles,
        Pose.from_matrix(read_numbers(held.body_from_rect, count, 4, 4)),
        read_numbers(held.layout_covariance, 6 * count, 6 * count),
        Pose.from_matrix(read_numbers(held.rig_from_body, *many, 4, 4)),
        read_numbers(held.covariance, *many, 6, 6),
        np.array(held.framesets, int),
    )


def recorded_marking(held: dict[str, Any]) -> Marking:
    """The marking of its values and kind. Raises QuadrigError where there is no such kind, msgspec.ValidationError
    where they are not its values."""
    kind = marking_kind(held.get("kind", ""))
    if kind is None:
        raise QuadrigError(f"the rig record has a marking of kind {held.get('kind')!r}; upgrade quadrig")
    return msgspec.convert({key: value for key, value in held.items() if key != "kind"}, type=kind)
