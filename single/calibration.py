"""The friendly way in: from one View, or several of one camera, to its lens and poses, and what limits them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS, Intrinsics, image_middle, unproject
from quadrig.single.lens_prior import usual_focal
from quadrig.single.pose import Pose, inverse_jacobian
from quadrig.single.posterior.lens_estimate import LensEstimate, LensPrior, estimate_lens, expected_sigma
from quadrig.single.posterior.lens_fit import LensViews, stacked_views
from quadrig.single.posterior.noise import EXPECTED_WEIGHT
from quadrig.single.solve.corners import REASON_WORDS, Reason
from quadrig.single.solve.focal_advice import focal_advice, percent, view_tilt
from quadrig.single.solve.maximum_likelihood import solve_points
from quadrig.single.solve.planar_pose import planar_poses, rotation_to
from quadrig.single.solve.twin import Twins, twin_poses
from quadrig.single.view import View

Distortion = Literal["none", "k1", "k1 k2", "auto"]
Model = Literal["auto", "pinhole", "fisheye"]

# Where a View's readings are compared, how far from the middle of the picture its axis may lie, of the longer side.
_USUAL_CENTRE = 0.02
# A focal is not known where the Views leave more than this share of it open: its sigma before any View is 0.44.
UNKNOWN_FOCAL = 0.25
# ln of a likelihood ratio of twenty to one: below it the mirrored tilt cannot be ruled out.
_SURE_OF_TILT = 3.0
# The share of lenses that are none of the usual kinds, above which something else may be wrong: a seventh beforehand.
_UNUSUAL = 0.5
# Sigmas of a shape that no sheet and no lens has.
_BENT = 3.0
_CHECK = "check the sizes, the order of the corners and that the sheet is flat"
# ln of the odds from which a fisheye is one: a thousand to one, where one lens in ten is beforehand.
_DECIDED = float(np.log(1000.0) + np.log(9.0))
# Focals that a fisheye may begin from, over the usual one, and how far apart they are.
_FISHEYE_STEP = 0.15
_FISHEYE_FOCALS = np.exp(_FISHEYE_STEP * np.arange(-5, 6))
# A sum of squares this many times its expectation is no noise: something else is wrong.
_MISFIT = 9.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """One camera from its Views.

    intrinsics; lens_covariance (9, 9) in the order of LENS_PARAMETERS; camera_from_rects: a batch (V) in the order of
    the Views, pose_covariance (V, 6, 6) of their steps, lens_pose_covariance (V, 9, 6). rms: root mean square
    residual a point, px; noise: standard deviation of a pixel coordinate that the covariances are for.
    reason: OK or FOCAL_UNKNOWABLE; readings: which reading of each View was taken; twins: for one View, both tilts at
    the focal found; notes: what limits the result and what was put right, in words.
    """

    intrinsics: Intrinsics
    lens_covariance: Floats
    camera_from_rects: Pose
    pose_covariance: Floats
    lens_pose_covariance: Floats
    focal_interval: tuple[float, float]
    residuals: tuple[Floats, ...]
    rms: float
    noise: float
    reason: Reason
    readings: tuple[int, ...]
    twins: Twins | None
    notes: tuple[str, ...]

    @property
    def focal_sigma(self) -> float:
        """Standard deviation of the focal, px; 0 where it was given."""
        return float(np.sqrt(self.lens_covariance[0, 0]))

    def covariance(self, view: int = 0) -> Floats:
        """Covariance (9, 9) of (focal, cx, cy, step of camera_from_rect) for one of the Views."""
        result = np.zeros((9, 9))
        result[:3, :3] = self.lens_covariance[:3, :3]
        result[:3, 3:] = self.lens_pose_covariance[view, :3]
        result[3:, :3] = result[:3, 3:].T
        result[3:, 3:] = self.pose_covariance[view]
        return result

    @property
    def rect_from_cameras(self) -> Pose:
        """The camera in the frame of each View's rectangle: the paper's [R T], a batch (V)."""
        return self.camera_from_rects.inverse()

    @property
    def rect_from_camera_covariance(self) -> Floats:
        """Covariance (V, 6, 6) of the steps of rect_from_cameras (rectangle's frame)."""
        jacobian = inverse_jacobian(self.camera_from_rects)
        return jacobian @ self.pose_covariance @ np.swapaxes(jacobian, -1, -2)


def calibrate_view(
    view: View,
    image_size: tuple[int, int],
    *,
    focal: float | None = None,
    principal_point: Floats | None = None,
    principal_point_sigma: float | None = None,
    distortion: Distortion = "auto",
    model: Model = "auto",
) -> Calibration:
    """The camera that took one View: calibrate_views of a single one."""
    return calibrate_views(
        [view],
        image_size,
        focal=focal,
        principal_point=principal_point,
        principal_point_sigma=principal_point_sigma,
        distortion=distortion,
        model=model,
    )


def calibrate_views(
    views: Sequence[View],
    image_size: tuple[int, int],
    *,
    focal: float | None = None,
    principal_point: Floats | None = None,
    principal_point_sigma: float | None = None,
    distortion: Distortion = "auto",
    model: Model = "auto",
) -> Calibration:
    """The lens that took all these Views and the pose of each rectangle, at the maximum of likelihood.

    image_size: width and height px; focal: px where known; principal_point (2,) px: the middle of the picture where
    None; principal_point_sigma: standard deviation of its prior, px: 0 where the principal point is given, two per
    cent of the longer side where it is not; distortion: "auto" for all that lenses have; model: "auto" for a pinhole,
    unless a fisheye meets by far better what it misses.
    The noise is the Views' sigma, or what the residuals show where that is more.
    Raises QuadrigError where no View can be solved, with the reason.
    """
    width, height = image_size
    if not views:
        raise QuadrigError("no View was given; calibrate from one View or more")
    if not (width > 0 and height > 0):
        raise QuadrigError(f"the image size is {width}x{height}; give the size of the picture in pixels")
    if focal is not None and not (np.isfinite(focal) and focal > 0):
        raise QuadrigError(f"the focal is {focal} px; give a length above zero")
    prior = _prior(image_size, focal, principal_point, principal_point_sigma, distortion)
    if model != "auto":
        return _calibration(_solved(views, replace(prior, model=model)))
    pinhole = _tried(views, prior)
    if isinstance(pinhole, _Solved) and (_freedom(pinhole) < 1 or not _is_suspect(pinhole.found)):
        return _calibration(pinhole)
    fisheye = _tried(views, replace(prior, model="fisheye"))
    if isinstance(fisheye, _Solved) and not _is_suspect(fisheye.found) and _is_decided(pinhole, fisheye):
        return _calibration(fisheye)
    if isinstance(pinhole, QuadrigError):
        raise pinhole
    return _calibration(pinhole)


@dataclass(frozen=True, eq=False)
class _Solved:
    """Views of a lens of one model: as they were read, which readings that are, and what they say."""

    views: list[View]
    readings: tuple[int, ...]
    stacked: LensViews
    prior: LensPrior
    found: LensEstimate


def _solved(views: Sequence[View], prior: LensPrior) -> _Solved:
    read, readings, focals = _likeliest_readings(views, prior)
    stacked = stacked_views(read, prior.image_size, prior.model)
    return _Solved(read, readings, stacked, prior, estimate_lens(stacked, prior, focals))


def _tried(views: Sequence[View], prior: LensPrior) -> _Solved | QuadrigError:
    try:
        return _solved(views, prior)
    except QuadrigError as error:
        return error


def _is_suspect(found: LensEstimate) -> bool:
    """Whether the points are explained by something rare alone, or not at all."""
    return _misses(found) or _most(found.shape) > _BENT or found.unusual > _UNUSUAL


def _freedom(solved: _Solved) -> int:
    """How many more numbers were measured than a lens and its poses have."""
    return solved.stacked.coordinates - 6 * len(solved.views) - len(LENS_PARAMETERS)


def _is_decided(pinhole: _Solved | QuadrigError, fisheye: _Solved) -> bool:
    """Whether a fisheye is a thousand times as likely as a pinhole: noise of unknown size, as each leaves it."""
    if isinstance(pinhole, QuadrigError):
        # Four corners in any order are a picture of some sheet, bent and edge on, by some fisheye.
        return _freedom(fisheye) > 0
    return _freedom(fisheye) * np.log(pinhole.found.noise / fisheye.found.noise) > _DECIDED


def _expected_noise(views: Sequence[View]) -> float:
    return float(np.sqrt(np.mean([view.expected_sigma**2 for view in views])))


def _prior(
    image_size: tuple[int, int],
    focal: float | None,
    principal_point: Floats | None,
    principal_point_sigma: float | None,
    distortion: Distortion,
) -> LensPrior:
    """What is known beforehand, in the terms of the solver."""
    held, lens, sigma = np.zeros(9, bool), np.zeros(9), np.zeros(9)
    lens[1:3] = image_middle(*image_size) if principal_point is None else principal_point
    if principal_point is not None or principal_point_sigma is not None:
        held[1:3], sigma[1:3] = True, principal_point_sigma or 0.0
    if distortion != "auto":
        held[3:8] = [name not in distortion.split() for name in LENS_PARAMETERS[3:8]]
    return LensPrior(image_size, focal, held, lens, sigma)


def _likeliest_readings(views: Sequence[View], prior: LensPrior) -> tuple[list[View], tuple[int, ...], list[float]]:
    """Each View under the reading that fits best, which that is, and focals to begin from; the first reading where
    others are no better than noise makes them."""
    taken, numbers, alone = [], [], []
    for view in views:
        answers = [_alone(view, prior, points) for points in view.readings]
        fits = [answer.chi2 if np.isfinite(answer.chi2) else np.inf for answer in answers]
        if not np.isfinite(fits).any():
            where = f"the View of {view.rectangle!r}" + (f" in camera {view.camera!r}" if view.camera else "")
            raise QuadrigError(f"{where}: {REASON_WORDS[answers[0].reason]}")
        best = int(np.argmin(fits))
        # Less than one unit of chi2 is what noise does to a reading that is as good.
        best = 0 if fits[0] < fits[best] + 1 else best
        taken.append(replace(view, points=view.readings[best], alternatives=()))
        numbers.append(best)
        alone.append(answers[best])
    return taken, tuple(numbers), _focals(alone) if prior.focal is None else []


@dataclass(frozen=True)
class _Alone:
    """What one View gives by itself: focal and its sigma, px; chi2, infinite where nothing fits, for that reason."""

    focal: float
    sigma: float
    chi2: float
    reason: Reason = Reason.OK


def _alone(view: View, prior: LensPrior, points: Floats) -> _Alone:
    if len(points) != len(view.pixels) or len(points) < 4:
        raise QuadrigError(
            f"the View of {view.rectangle!r} has {len(points)} points and {len(view.pixels)} pixels; "
            "give as many of each, four or more"
        )
    return (
        _alone_as_fisheye(view, prior, points) if prior.model == "fisheye" else _alone_as_pinhole(view, prior, points)
    )


def _alone_as_pinhole(view: View, prior: LensPrior, points: Floats) -> _Alone:
    # From behind, a rectangle is one seen from the front and turned over.
    front_from_rect = Pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)) if view.back else Pose.identity()
    answer = solve_points(
        front_from_rect.transform(points),
        view.pixels,
        prior.lens[1:3],
        focal=prior.focal,
        sigma=view.expected_sigma,
        principal_point_sigma=prior.sigma[1] if prior.held[1] else _USUAL_CENTRE * prior.side,
    )
    return _Alone(float(answer.focal), float(answer.focal_sigma), float(answer.chi2), Reason(int(answer.reason)))


def _alone_as_fisheye(view: View, prior: LensPrior, points: Floats) -> _Alone:
    """The focal under which a lens that bends as fisheyes do in the mean has the best pose, in closed form."""
    usual = usual_focal(np.array([prior.side]), ["fisheye"])
    focals = usual * _FISHEYE_FOCALS if prior.focal is None else np.array([prior.focal])
    lenses = prior.classes(focals).moments()[0]
    lenses[:, 0] = focals
    rays = unproject(lenses[:, None], view.pixels, "fisheye")
    errors = focals * planar_poses(points, rays).errors.min(axis=-1)
    best = int(np.argmin(errors))
    chi2 = len(points) * float(errors[best] / view.expected_sigma) ** 2
    reason = Reason.OK if np.isfinite(chi2) else Reason.FOCAL_UNKNOWABLE
    return _Alone(float(focals[best]), _FISHEYE_STEP * float(focals[best]), chi2, reason)


def _focals(alone: Sequence[_Alone]) -> list[float]:
    """The focal of all Views, each weighed as it knows it by itself; none where no View does."""
    inverse = np.array([1 / one.focal for one in alone])
    weight = np.array([(one.focal**2 / one.sigma) ** 2 for one in alone])
    weight = np.where(np.isfinite(weight * inverse), weight, 0.0)
    return [float(weight.sum() / (weight * inverse)[weight > 0].sum())] if weight.sum() > 0 else []


def _most(shape: Floats) -> float:
    """The largest number of a shape, in its sigmas."""
    return float(np.abs(shape).max())


def _misses(found: LensEstimate) -> bool:
    """Whether no lens fits: a sum of squares that is no noise."""
    return found.chi2 > _MISFIT * (found.freedom + EXPECTED_WEIGHT)


def _calibration(solved: _Solved) -> Calibration:
    views, readings, stacked, prior, found = (
        solved.views,
        solved.readings,
        solved.stacked,
        solved.prior,
        solved.found,
    )
    lens = Intrinsics.centred(*prior.image_size, 1.0, prior.model).with_parameters(found.lens)
    noise = found.noise * _expected_noise(views)
    relative = float(np.sqrt(found.lens_covariance[0, 0])) / lens.focal
    knowable = prior.focal is not None or (relative < UNKNOWN_FOCAL and not _misses(found))
    twins = _twins(views[0], lens, found.camera_from_rects[0], noise) if len(views) == 1 else None
    residuals = tuple(rows[: len(view.pixels)] for rows, view in zip(found.residuals, views, strict=True))
    square = np.concatenate([(r**2).sum(axis=-1) for r in residuals])
    low, high = found.focal_interval
    return Calibration(
        lens,
        found.lens_covariance,
        found.camera_from_rects,
        found.pose_covariance,
        found.lens_pose_covariance,
        (low, high if knowable else np.inf),
        residuals,
        float(np.sqrt(np.nanmean(square))),
        noise,
        Reason.OK if knowable else Reason.FOCAL_UNKNOWABLE,
        readings,
        twins,
        tuple(_notes(views, stacked, readings, prior, found, relative, twins)),
    )


def _twins(view: View, lens: Intrinsics, camera_from_rect: Pose, noise: float) -> Twins:
    """Both tilts at the lens found, from pixels freed of its distortion: of a pinhole that looks where the camera
    does, or, since a fisheye's rays may lie past any plane, at the rectangle."""
    rays = lens.unproject(view.pixels)
    towards = np.eye(3) if lens.model == "pinhole" else rotation_to(np.nansum(rays, axis=0))
    rays, turned = rays @ towards, Pose(towards.T, np.zeros(3))
    with np.errstate(all="ignore"):
        straight = lens.focal * rays[:, :2] / rays[:, 2:] + lens.principal_point
    found = twin_poses(view.points, straight, lens.focal, lens.principal_point, turned @ camera_from_rect, noise)
    return replace(found, camera_from_rect=Pose(towards, np.zeros(3)) @ found.camera_from_rect)


def _notes(
    views: Sequence[View],
    stacked: LensViews,
    readings: tuple[int, ...],
    prior: LensPrior,
    found: LensEstimate,
    relative: float,
    twins: Twins | None,
) -> list[str]:
    notes, sheets = [], found.shape[: stacked.by_sheet.shape[-1]]
    for view, reading in zip(views, readings, strict=True):
        if reading:
            notes.append(f"{view.rectangle!r} was read rotated: reading {reading + 1} of its corners fits best")
    if _misses(found):
        notes.append(
            f"the points miss a rectangle of this size by {found.noise:.1f} times their noise: {_CHECK}; the sigmas "
            "say too little"
        )
    elif (most := _most(sheets)) > _BENT:
        notes.append(
            f"only a sheet bent {most:.0f} times as far as sheets usually are explains these points: {_CHECK}"
        )
    elif _is_suspect(found):
        notes.append(f"only a rare lens, or a part of another picture, explains these points: {_CHECK}")
    if prior.focal is None and not _misses(found):
        notes += _focal_notes(stacked, prior, found, relative)
    if twins is not None and twins.log_likelihood_ratio < _SURE_OF_TILT:
        notes.append(
            f"the mirrored tilt fits almost as well (this one is {np.exp(twins.log_likelihood_ratio):.1f} times as "
            "likely): another View decides"
        )
    return notes


def _focal_notes(views: LensViews, prior: LensPrior, found: LensEstimate, relative: float) -> list[str]:
    notes = [] if relative < UNKNOWN_FOCAL else [REASON_WORDS[Reason.FOCAL_UNKNOWABLE]]
    if len(views.sigma) > 1:
        if relative > 0.01:
            tilts = np.degrees(view_tilt(found.camera_from_rects))
            notes.append(
                f"the focal is known to {percent(relative)}: the tilts are {tilts.min():.0f} to {tilts.max():.0f} "
                "degrees; add Views tilted by about 40"
            )
        return notes
    focal = float(found.lens[0])

    def expected(pose: Pose, *, centre_known: bool = False, distortion_known: bool = False) -> float:
        sigma = expected_sigma(
            views, found, prior, pose[None], centre_known=centre_known, distortion_known=distortion_known
        )
        return sigma / focal

    centre_sigma = 0.0 if prior.held[1] and not prior.sigma[1] else float(np.sqrt(found.lens_covariance[1, 1]))
    return notes + focal_advice(
        views.points[0][views.seen[0]],
        focal,
        found.camera_from_rects[0],
        expected,
        relative,
        centre_sigma,
        prior.image_size,
    )
