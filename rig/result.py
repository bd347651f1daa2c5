"""The Rig: cameras and rectangles in one frame, how sure each is, and what the Views said."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape

import numpy as np

from quadrig.rig.words import ONE_SIGMA, Column, counted, length, pixels, sigma_figure, with_sigma
from quadrig.single.arrays import Floats, Ints, Mask, median
from quadrig.single.lens import LENS_PARAMETERS, Intrinsics
from quadrig.single.lens_prior import LensEvidence
from quadrig.single.pose import Pose, compose_jacobians, inverse_jacobian
from quadrig.single.posterior.sheet_shape import SheetShape
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import angles_from_rotation
from quadrig.single.view import View

# More names than this are counted, so that a rig of hundreds still fits on a screen.
_MOST_NAMED = 8
# The body of that name is what a rig is carried through, whatever is known of it.
ROOM = "room"
# Rectangles of a body face inward or outward where that is this share of how far they are from its middle; else it is
# flat, and a wall where it is wider than anybody holds or turns, m.
_FACES, _WIDEST_HELD = 0.2, 1.5

CAMERA_PARAMETERS = len(LENS_PARAMETERS) + 6
"""Length of one camera's block in Rig.covariance: nine of the lens, then the step of rig_from_camera."""


@dataclass(frozen=True, eq=False)
class Camera:
    """One camera of a rig, solved.

    free_lens: the lens parameters that were estimated (the others kept their given or neutral values);
    lens_reason: why that lens, in words. rms: px, over the used points of the fit; views: how many Views it used.
    observable_focal: False where focal and distance cannot be separated. clock_offset, with its sigma: s, by how much
    later than the mean of the cameras it takes its pictures for one and the same stamp; zero, and nan, where it is
    not observable. A picture is taken when its middle row is. line_time, with its sigma: s from one row to the next,
    as given or as what moved shows it; nan where not known.
    remainder: px, root mean square over the picture of the smooth shifts of its pixels that the lens model does not
    have; nan where it is not known.
    lens_evidence: what its Views say of its lens, for another calibration of it; None where they were not asked for
    all of the lens.
    """

    name: str
    intrinsics: Intrinsics
    rig_from_camera: Pose
    free_lens: tuple[str, ...] = ()
    lens_reason: str = ""
    rms: float = float("nan")
    held_out_rms: float = float("nan")
    views: int = 0
    observable_focal: bool = True
    clock_offset: float = 0.0
    clock_offset_sigma: float = float("nan")
    lens_evidence: LensEvidence | None = None
    remainder: float = float("nan")
    line_time: float = float("nan")
    line_time_sigma: float = float("nan")


@dataclass(frozen=True, eq=False)
class PlacedRectangle:
    """A rectangle where it stood: once where static, at each frameset where moving.

    framesets (F,) int: those where it was seen; empty for a static one. rig_from_rect: one Pose, or a batch (F,).
    covariance: (6, 6), or (F, 6, 6), of the step of rig_from_rect. shape: how the sheet differs from a flat one of
    its size; None where nobody looked.
    """

    rectangle: Rectangle
    rig_from_rect: Pose
    covariance: Floats
    framesets: Ints = field(default_factory=lambda: np.zeros(0, int))
    shape: SheetShape | None = None

    @property
    def name(self) -> str:
        """The rectangle's name."""
        return self.rectangle.name

    @cached_property
    def row_of(self) -> dict[int, int]:
        """The row of each frameset among the poses of a moving one."""
        return {int(frameset): row for row, frameset in enumerate(self.framesets)}


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A body where it stood: once where it stands still, at each frameset where it moves.

    rectangles (K,): names of those on it. body_from_rect: a batch (K,); layout_covariance (6 K, 6 K): of its steps,
    zero for the rectangle that is the body's frame and for poses that were given exactly. rig_from_body: one Pose, or
    a batch (F,); covariance: (6, 6), or (F, 6, 6), of its step. framesets (F,) int: empty where it stands still.
    """

    name: str
    rectangles: tuple[str, ...]
    body_from_rect: Pose
    layout_covariance: Floats
    rig_from_body: Pose
    covariance: Floats
    framesets: Ints = field(default_factory=lambda: np.zeros(0, int))

    @property
    def is_room(self) -> bool:
        """Whether it is what the rig is carried through, not what moves before it: it bears that name, its rectangles
        face one another, or it is a wall."""
        if self.name == ROOM:
            return True
        offsets = self.body_from_rect.translation - self.body_from_rect.translation.mean(axis=0)
        size = float(np.linalg.norm(offsets, axis=1).mean())
        inward = float(np.mean(np.sum(offsets * self.body_from_rect.rotation[:, :, 2], axis=1)))
        return inward > _FACES * size or (inward > -_FACES * size and 2 * size > _WIDEST_HELD)

    def path(self) -> tuple[Pose, Floats]:
        """body_from_rig and the covariance (..., 6, 6) of its step: how the rig moves as the body sees it."""
        by_pose = inverse_jacobian(self.rig_from_body)
        return self.rig_from_body.inverse(), by_pose @ self.covariance @ np.swapaxes(by_pose, -1, -2)

    def layout_sigmas(self) -> Floats:
        """Sigmas (2, K) of where each rectangle stands on it: pose_sigmas."""
        count = len(self.rectangles)
        blocks = self.layout_covariance.reshape(count, 6, count, 6)[range(count), :, range(count)]
        return pose_sigmas(blocks)

    def rect_from_other(self, rectangle: str, other: str) -> tuple[Pose, Floats]:
        """The pose of another rectangle of the body in the frame of one, and the covariance (6, 6) of its step.
        Raises ValueError where either is none of its rectangles."""
        one, two = self.rectangles.index(rectangle), self.rectangles.index(other)
        body_from_one, body_from_two = self.body_from_rect[one], self.body_from_rect[two]
        by_inverse, by_two = compose_jacobians(body_from_one.inverse(), body_from_two)
        jacobian = np.concatenate([by_inverse @ inverse_jacobian(body_from_one), by_two], axis=1)
        rows = np.concatenate([6 * row + np.arange(6) for row in (one, two)])
        covariance = jacobian @ self.layout_covariance[np.ix_(rows, rows)] @ jacobian.T
        return body_from_one.inverse() @ body_from_two, covariance


@dataclass(frozen=True, eq=False)
class ViewFit:
    """How a View agrees with the rig. residuals (P, 2) px, seen minus predicted; nan where there is no prediction.

    reading: index in view.readings of the reading that the rig's other Views chose.
    used (P,): which points took part in the fit. rejected: why the whole View was rejected, in words, or "".
    """

    view: View
    residuals: Floats
    used: Mask
    reading: int = 0
    rejected: str = ""


@dataclass(frozen=True, eq=False)
class Rig:
    """The result of a calibration. Everything is in the rig frame: that of `reference`, a camera or a rectangle.

    covariance (15 C, 15 C): joint, over the cameras in order; each block is the nine lens parameters and the step of
    rig_from_camera (rotation, then translation, in the rig frame). Rows of fixed parameters are zero.
    noise: the standard deviation of a pixel coordinate, px, as the data showed it, of a View of median sigma.
    rms, held_out_rms: px, of the fit, and of framesets that took no part in it.
    working_accuracy: m, the sigma of a point triangulated in the volume where rectangles were seen (root mean
    square over the volume, of the largest axis), from the calibration's doubt alone and in units of the sheets as
    printed; point_accuracy: the same of one point, with the noise of its own pixels. scale_sigma: of all lengths
    together, as a share of them: sheets may be printed a little too large, and no picture shows it.
    dispersion: what all covariances have been multiplied by, because parts of the recording disagree on the cameras
    by more than noise explains; 1 where they do not.
    missing: a sentence for each camera that could not be placed, by name. weak: what is weak, in words.
    bodies: those of several rectangles, or of given poses: where they stood, and where rectangles stand on them.
    apart: what is known of those cameras all the same, their lenses above all: rigs of their own, often of one
    camera, each in a frame of its own that nothing ties to this one.
    """

    reference: str
    cameras: tuple[Camera, ...]
    rectangles: tuple[PlacedRectangle, ...]
    covariance: Floats
    fits: tuple[ViewFit, ...] = ()
    noise: float = float("nan")
    rms: float = float("nan")
    held_out_rms: float = float("nan")
    working_accuracy: float = float("nan")
    point_accuracy: float = float("nan")
    scale_sigma: float = float("nan")
    missing: dict[str, str] = field(default_factory=dict)
    weak: tuple[str, ...] = ()
    costs: tuple[float, ...] = ()
    dispersion: float = 1.0
    apart: tuple["Rig", ...] = ()
    bodies: tuple[PlacedBody, ...] = ()

    @cached_property
    def placed(self) -> dict[str, PlacedRectangle]:
        """The rectangles by name."""
        return {one.name: one for one in self.rectangles}

    @property
    def room(self) -> PlacedBody | None:
        """The body that the rig is carried through; None where the rig stands."""
        return next((body for body in self.bodies if len(body.framesets) and body.is_room), None)

    @property
    def is_doubt_known(self) -> bool:
        """Whether the whole covariance is known: of a rig from another program's file it is nan."""
        return bool(np.isfinite(self.covariance).all())

    @property
    def lens_only(self) -> tuple[tuple["Rig", Camera], ...]:
        """The cameras that have a lens here but no pose in this rig, each with the rig apart that has it."""
        return tuple((rig, camera) for rig in self.apart for camera in rig.cameras)

    def __repr__(self) -> str:
        """A few lines: what it is good for, its cameras, its rectangles, and how well the Views agree."""
        used, placed = [fit for fit in self.fits if not fit.rejected], [_described(each) for each in self.rectangles]
        framesets = counted(len({fit.view.frameset for fit in used}), "frameset")
        return "\n".join(
            (
                f"Rig in the frame of {self.reference}, working accuracy {length(self.working_accuracy)}",
                f"  {counted(len(self.cameras), 'camera')}: {_named([camera.name for camera in self.cameras])}",
                f"  {counted(len(self.rectangles), 'rectangle')}: {_named(placed)}",
                f"  {framesets}, {len(used)} of {counted(len(self.fits), 'View')}, RMS {pixels(self.rms)}",
            )
        )

    def _repr_html_(self) -> str:
        """The same as a notebook shows it, with a row for each camera."""
        headline, *lines = (escape(line.strip()) for line in repr(self).splitlines())
        columns = camera_columns(self)
        head = "".join(f"<th>{escape(column.heading)}</th>" for column in columns)
        rows = zip(*(column.cells for column in columns), strict=True)
        body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        return (
            f"<p><b>{headline}</b><br>{'<br>'.join(lines)}</p><table><tr>{head}</tr>{body}</table><p>{ONE_SIGMA}</p>"
        )

    def camera(self, name: str) -> Camera:
        """The camera of that name. Raises KeyError."""
        return self.cameras[self.camera_index(name)]

    def camera_index(self, name: str) -> int:
        """Where the camera stands in `cameras` and in `covariance`. Raises KeyError."""
        for index, camera in enumerate(self.cameras):
            if camera.name == name:
                return index
        raise KeyError(name)

    def lens_covariance(self, name: str) -> Floats:
        """(9, 9), in the order of LENS_PARAMETERS."""
        start = self.camera_index(name) * CAMERA_PARAMETERS
        return self.covariance[start : start + 9, start : start + 9]

    def pose_covariance(self, name: str) -> Floats:
        """(6, 6), of the step of rig_from_camera."""
        start = self.camera_index(name) * CAMERA_PARAMETERS + 9
        return self.covariance[start : start + 6, start : start + 6]

    def relative_covariance(self, left: str, right: str) -> Floats:
        """(6, 6), of the step of left_from_right between two cameras; where the rig frame stands does not matter."""
        rig_from_left, rig_from_right = self.camera(left).rig_from_camera, self.camera(right).rig_from_camera
        by_inverse, by_right = compose_jacobians(rig_from_left.inverse(), rig_from_right)
        jacobian = np.concatenate([by_inverse @ inverse_jacobian(rig_from_left), by_right], axis=1)
        rows = np.concatenate([self.camera_index(n) * CAMERA_PARAMETERS + 9 + np.arange(6) for n in (left, right)])
        return jacobian @ self.covariance[np.ix_(rows, rows)] @ jacobian.T

    def focal_sigma(self, name: str) -> float:
        """Standard deviation of the focal, px."""
        return float(np.sqrt(self.lens_covariance(name)[0, 0]))

    def rotation_sigma(self, name: str) -> float:
        """Sigma of the rotation about one axis, rad: root mean square over all."""
        return float(pose_sigmas(self.pose_covariance(name))[0])

    def position_sigma(self, name: str) -> float:
        """Sigma of the camera's position in one direction, m: root mean square over all."""
        return float(pose_sigmas(self.pose_covariance(name))[1])


def fits_by_camera(rig: Rig) -> dict[str, list[ViewFit]]:
    """The fits of the Views of every camera."""
    fits: dict[str, list[ViewFit]] = {camera.name: [] for camera in rig.cameras}
    for fit in rig.fits:
        if fit.view.camera in fits:
            fits[fit.view.camera].append(fit)
    return fits


def pose_sigmas(covariance: Floats) -> Floats:
    """Of covariances (..., 6, 6) of steps of poses: sigmas (2, ...) of the rotation about one axis, rad, and of the
    position in one direction, m; root mean squares over all."""
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)
    return np.sqrt([variances[..., :3].mean(axis=-1), variances[..., 3:].mean(axis=-1)])


def _described(placed: PlacedRectangle) -> str:
    many = len(placed.framesets)
    return f"{placed.name} (moving, {counted(many, 'frameset')})" if many else placed.name


def _named(names: Sequence[str]) -> str:
    rest = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {rest} more" if rest > 0 else "")


def camera_columns(rig: Rig) -> list[Column]:
    """The cameras of a rig as every table of them shows them: focal and pose with their sigmas, how well they fit."""
    cameras = rig.cameras
    posed = [camera.name != rig.reference for camera in cameras]
    positions = _aligned([camera.rig_from_camera.translation + 0.0 for camera in cameras])
    shifts = [1e3 * rig.position_sigma(camera.name) for camera in cameras]
    turns = [np.degrees(rig.rotation_sigma(camera.name)) for camera in cameras]
    name, focal, *fit = lens_columns([(rig, camera) for camera in cameras])
    return [
        name,
        focal,
        Column("position", "m", tuple(at if own else "rig frame" for at, own in zip(positions, posed, strict=True))),
        Column("position", "± mm", _unless_frame(posed, shifts)),
        Column("rotation", "± deg", _unless_frame(posed, turns)),
        *fit,
    ]


def lens_columns(every: Sequence[tuple[Rig, Camera]]) -> list[Column]:
    """The same of cameras, each of its rig, without their poses."""
    cameras = [camera for _, camera in every]
    focals = [with_sigma(camera.intrinsics.focal, rig.focal_sigma(camera.name)) for rig, camera in every]
    return [
        Column("camera", "", tuple(camera.name for camera in cameras), words=True),
        Column("focal", "px", tuple(focals)),
        Column("RMS", "px", tuple(_if_known(camera.rms) for camera in cameras)),
        Column("held out", "px", tuple(_if_known(camera.held_out_rms) for camera in cameras)),
        Column("Views", "", tuple(str(camera.views) for camera in cameras)),
        *_line_times(cameras),
    ]


def _line_times(cameras: Sequence[Camera]) -> list[Column]:
    """A column of line times where some are known."""
    known = [bool(np.isfinite(camera.line_time)) for camera in cameras]
    return [Column("line time", "µs", tuple(map(line_time, cameras)))] if any(known) else []


def line_time(camera: Camera) -> str:
    """ "20.1 ± 0.2", in microseconds a row; "not known" where it is not."""
    if not np.isfinite(camera.line_time):
        return "not known"
    return with_sigma(1e6 * camera.line_time, 1e6 * camera.line_time_sigma)


def body_columns(rig: Rig, body: PlacedBody) -> list[Column]:
    """Where the rectangles of a body stand on it, as every table shows them; angles of R = Rx Ry Rz (Eq. 6)."""
    turns, shifts = body.layout_sigmas()
    poses = [body.body_from_rect[row] for row in range(len(body.rectangles))]
    posed = [not np.array_equal(pose.matrix(), np.eye(4)) for pose in poses]
    positions = _aligned([pose.translation + 0.0 for pose in poses], _decimals(shifts))
    angles = np.degrees([angles_from_rotation(pose.rotation) for pose in poses]) + 0.0
    turned = _aligned(angles, _decimals(np.degrees(turns)))
    seen = Counter(fit.view.rectangle for fit in rig.fits if not fit.rejected)
    return [
        Column(body.name, "", body.rectangles, words=True),
        Column("position", "m", tuple(at if own else "body frame" for at, own in zip(positions, posed, strict=True))),
        Column("position", "± mm", _unless_frame(posed, 1e3 * shifts)),
        Column("θx θy θz", "deg", tuple(at if own else "" for at, own in zip(turned, posed, strict=True))),
        Column("rotation", "± deg", _unless_frame(posed, np.degrees(turns))),
        Column("Views", "", tuple(str(seen[name]) for name in body.rectangles)),
    ]


def body_sentence(body: PlacedBody) -> str:
    """What a body is, how often it was seen, and how well it is known where it was, or the rig in it."""
    what = f"{body.name}: {counted(len(body.rectangles), 'rectangle')} fixed to each other"
    poses, covariance = body.path() if body.is_room else (body.rig_from_body, body.covariance)
    turn, shift = (sigma_figure(median(part)) for part in pose_sigmas(covariance) * [[180 / np.pi], [1e3]])
    doubt = f"± {shift} mm and ± {turn} deg"
    if not len(body.framesets):
        return f"{what}, which stand still; where they do is known to {doubt}"
    many = counted(len(body.framesets), "frameset")
    if not body.is_room:
        return f"{what}, moved, seen in {many}; in the median its place in one is known to {doubt}"
    reach = length(float(np.linalg.norm(np.ptp(poses.translation, axis=0))))
    return (
        f"{what}, past which the rig was carried in {many}, within {reach}; in the median the rig's place in one is "
        f"known to {doubt}"
    )


def _decimals(sigmas: Floats) -> int:
    """As many as the first digit of the smallest of sigmas has, 1 to 4."""
    known = sigmas[sigmas > 0]
    return int(np.clip(np.ceil(-np.log10(known.min())), 1, 4)) if len(known) else 4


def _aligned(rows: Sequence[Floats] | Floats, decimals: int = 4) -> list[str]:
    """Vectors, those in m to a tenth of a millimetre, their parts below one another."""
    words = [[f"{value:.{decimals}f}" for value in row] for row in rows]
    widths = [max(map(len, part)) for part in zip(*words, strict=True)]
    return [" ".join(word.rjust(width) for word, width in zip(row, widths, strict=True)) for row in words]


def _unless_frame(posed: Sequence[bool], sigmas: Sequence[float] | Floats) -> tuple[str, ...]:
    return tuple(sigma_figure(sigma) if own else "" for own, sigma in zip(posed, sigmas, strict=True))


def _if_known(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else ""


def placed_pose(rig: Rig, rectangle: str, frameset: int) -> Pose | None:
    """rig_from_rect of a rectangle at a frameset; None where it was not placed there."""
    placed = rig.placed.get(rectangle)
    if placed is None or not placed.rectangle.moving:
        return None if placed is None else placed.rig_from_rect
    row = placed.row_of.get(frameset)
    return None if row is None else placed.rig_from_rect[row]
