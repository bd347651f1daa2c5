"""The friendly way in: from one View, or several of one camera, to its lens and poses, and what limits them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, image_middle
from quadrig.single.pose import Pose, inverse_jacobian
from quadrig.single.solve.corners import REASON_WORDS, Reason
from quadrig.single.solve.focal_advice import focal_advice, percent, view_tilt
from quadrig.single.solve.lens_fit import LensFit, fit_lens
from quadrig.single.solve.maximum_likelihood import NORMAL_95, Solution, solve_points
from quadrig.single.solve.twin import Twins, twin_poses
from quadrig.single.view import View

Distortion = Literal["none", "k1", "k1 k2", "auto"]

# How far from the middle of the picture a lens's axis is taken to lie, as a share of the longer side, where nobody
# says: calibrated consumer cameras lie within one to three per cent.
USUAL_CENTRE_SIGMA = 0.02
# Where the axis is not given, the lens elements may be off it too: the standard deviation of p1 and p2. Over the real
# pictures of two cameras (13 and 5 Views, each calibrated alone, against all together) it brings the errors from four
# and two of their sigmas to 1.4 and 1.2, and makes them no larger.
_DECENTRING = 1e-3
# What k1 may be where nobody says and few points cannot show it: that of phones and plain webcams.
USUAL_DISTORTION_SIGMA = 0.05
# Fewer points than this cannot distinguish distortion from a wrong corner.
_POINTS_FOR_DISTORTION = 12
# A distortion coefficient is kept where it lowers the sum of squares by this many variances: far beyond chance (9 is
# three sigma), as each costs the focal some certainty.
_WORTH_A_COEFFICIENT = 15.0
# Degrees of freedom from which the residuals know the noise better than the detector does.
_DOF_FOR_NOISE = 10
# ln of a likelihood ratio of twenty to one: below it the mirrored tilt cannot be ruled out.
_SURE_OF_TILT = 3.0
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

    @property
    def focal_interval(self) -> tuple[float, float]:
        """The 95 % interval of the focal, px, symmetric in 1/f: it may reach infinity."""
        inverse = 1 / self.intrinsics.focal
        spread = NORMAL_95 * self.focal_sigma * inverse**2
        return 1 / (inverse + spread), 1 / (inverse - spread) if inverse > spread else np.inf

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
    distortion_sigma: float | None = None,
) -> Calibration:
    """The camera that took one View: calibrate_views of a single one."""
    return calibrate_views(
        [view],
        image_size,
        focal=focal,
        principal_point=principal_point,
        principal_point_sigma=principal_point_sigma,
        distortion=distortion,
        distortion_sigma=distortion_sigma,
    )


def calibrate_views(
    views: Sequence[View],
    image_size: tuple[int, int],
    *,
    focal: float | None = None,
    principal_point: Floats | None = None,
    principal_point_sigma: float | None = None,
    distortion: Distortion = "auto",
    distortion_sigma: float | None = None,
) -> Calibration:
    """The lens that took all these Views and the pose of each rectangle, at the maximum of likelihood.

    image_size: width and height px; focal: px where known; principal_point (2,) px: the middle of the picture where
    None; principal_point_sigma: standard deviation of its prior, px: 0 where the principal point is given, two per
    cent of the longer side where it is not; distortion: "auto" keeps k1 and k2 as far as the Views show them;
    distortion_sigma: standard deviation of a prior on k1 about 0, so that what a lens may bend and few points cannot
    show enters the sigmas; None: 0.05 where that is so and the principal point is not given either, else no prior.
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
    if principal_point_sigma is None:
        principal_point_sigma = 0.0 if principal_point is not None else USUAL_CENTRE_SIGMA * max(width, height)
    centre = image_middle(width, height) if principal_point is None else np.asarray(principal_point, float)
    given = _Given(
        image_size,
        focal,
        centre,
        principal_point_sigma,
        _distortion_sigma(views, distortion, distortion_sigma, principal_point is None),
        _DECENTRING if principal_point_sigma > 0 and distortion != "none" and _many(views) else 0.0,
    )
    views, readings, alone = _likeliest_readings(views, given)
    start, poses = _start(views, given, alone)
    fit, noise = _fitted(views, given, start, poses, distortion)
    return _calibration(views, readings, given, fit, noise)


@dataclass(frozen=True, eq=False)
class _Given:
    image_size: tuple[int, int]
    focal: float | None
    centre: Floats
    centre_sigma: float
    distortion_sigma: float
    decentring: float


def _many(views: Sequence[View]) -> bool:
    """Whether there are points enough to show distortion."""
    return sum(len(view.pixels) for view in views) >= _POINTS_FOR_DISTORTION * len(views)


def _distortion_sigma(
    views: Sequence[View], distortion: Distortion, asked: float | None, camera_unknown: bool
) -> float:
    if asked is not None:
        return asked
    return USUAL_DISTORTION_SIGMA if distortion == "auto" and camera_unknown and not _many(views) else 0.0


def _alone(view: View, given: _Given, points: Floats, focal: float | None) -> Solution:
    if len(points) != len(view.pixels) or len(points) < 4:
        raise QuadrigError(
            f"the View of {view.rectangle!r} has {len(points)} points and {len(view.pixels)} pixels; "
            "give as many of each, four or more"
        )
    # From behind, a rectangle is one seen from the front and turned over.
    front_from_rect = Pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)) if view.back else Pose.identity()
    answer = solve_points(
        front_from_rect.transform(points),
        view.pixels,
        given.centre,
        focal=focal,
        sigma=view.expected_sigma,
        principal_point_sigma=given.centre_sigma,
    )
    return replace(answer, camera_from_rect=answer.camera_from_rect @ front_from_rect)


def _likeliest_readings(views: Sequence[View], given: _Given) -> tuple[list[View], tuple[int, ...], list[Solution]]:
    """Each View under the reading that fits best, which that is, and what it gives alone; the first reading where
    others are no better than noise makes them."""
    taken, numbers, alone = [], [], []
    for view in views:
        answers = [_alone(view, given, points, given.focal) for points in view.readings]
        fits = [float(answer.chi2) if np.isfinite(answer.chi2) else np.inf for answer in answers]
        if not np.isfinite(fits).any():
            where = f"the View of {view.rectangle!r}" + (f" in camera {view.camera!r}" if view.camera else "")
            raise QuadrigError(f"{where}: {REASON_WORDS[Reason(int(answers[0].reason))]}")
        best = int(np.argmin(fits))
        # Less than one unit of chi2 is what noise does to a reading that is as good.
        best = 0 if fits[0] < fits[best] + 1 else best
        taken.append(replace(view, points=view.readings[best], alternatives=()))
        numbers.append(best)
        alone.append(answers[best])
    return taken, tuple(numbers), alone


def _start(views: Sequence[View], given: _Given, alone: Sequence[Solution]) -> tuple[Intrinsics, Pose]:
    """A lens and poses to start from: every View at one focal, their own weighted as each knows it."""
    focal, at_focal = given.focal, alone
    if focal is None:
        inverse = np.array([1 / float(answer.focal) for answer in alone])
        weight = np.array([(float(answer.focal) ** 2 / float(answer.focal_sigma)) ** 2 for answer in alone])
        weight = np.where(np.isfinite(weight * inverse), weight, 0.0)
        known = weight.sum() > 0
        focal = float(weight.sum() / (weight * inverse)[weight > 0].sum()) if known else float(max(given.image_size))
        if len(views) > 1 or not known:
            at_focal = [_alone(view, given, view.points, focal) for view in views]
    rotations = np.stack([answer.camera_from_rect.rotation for answer in at_focal])
    translations = np.stack([answer.camera_from_rect.translation for answer in at_focal])
    return Intrinsics(*given.image_size, focal, given.centre.copy()), Pose(rotations, translations)


def _fitted(
    views: Sequence[View], given: _Given, start: Intrinsics, poses: Pose, distortion: Distortion
) -> tuple[LensFit, float]:
    """The fit with as much distortion as asked for or shown, and by how much its noise exceeds the Views' sigma."""
    free = [] if given.focal is not None else ["focal"]
    prior = {"cx": given.centre_sigma, "cy": given.centre_sigma} if given.centre_sigma > 0 else {}
    if given.distortion_sigma > 0:
        prior["k1"] = given.distortion_sigma
    points, pixels = [view.points for view in views], [view.pixels for view in views]
    sigma, common = [view.expected_sigma for view in views], [view.common for view in views]

    def fit(intrinsics: Intrinsics, at: Pose, coefficients: Sequence[str], excess: float = 1.0) -> LensFit:
        names = dict.fromkeys([*free, *prior, *coefficients])
        return fit_lens(points, pixels, intrinsics, at, list(names), [s * excess for s in sigma], prior, common)

    if distortion == "auto":
        ladder = [[], ["k1"], ["k1", "k2"]] if _many(views) else [[]]
    else:
        ladder = [[] if distortion == "none" else distortion.split()]
    best = fit(start, poses, ladder[0])
    used = ladder[0]
    for coefficients in ladder[1:]:
        richer = fit(best.intrinsics, best.camera_from_rects, coefficients)
        variance = max(richer.chi2 / max(richer.dof, 1), 1e-300)
        if not (richer.converged and best.chi2 - richer.chi2 > _WORTH_A_COEFFICIENT * variance):
            break
        best, used = richer, coefficients
    excess = max(float(np.sqrt(best.chi2 / best.dof)), 1.0) if best.dof >= _DOF_FOR_NOISE else 1.0
    if given.decentring > 0:
        # Last, at the right noise: before the radial terms are in, tangential ones would go after their residuals.
        prior |= {"p1": given.decentring, "p2": given.decentring}
    if given.decentring > 0 or excess > 1:
        best = fit(best.intrinsics, best.camera_from_rects, used, excess)
    return best, excess


def _calibration(
    views: Sequence[View], readings: tuple[int, ...], given: _Given, fit: LensFit, excess: float
) -> Calibration:
    noise = excess * float(np.sqrt(np.mean([view.expected_sigma**2 for view in views])))
    relative = float(np.sqrt(fit.lens_covariance[0, 0])) / fit.intrinsics.focal
    knowable = given.focal is not None or NORMAL_95 * relative < 1
    twins = _twins(views[0], fit, noise) if len(views) == 1 else None
    square = np.concatenate([(r**2).sum(axis=-1) for r in fit.residuals])
    return Calibration(
        fit.intrinsics,
        fit.lens_covariance,
        fit.camera_from_rects,
        fit.pose_covariance,
        fit.lens_pose_covariance,
        fit.residuals,
        float(np.sqrt(np.nanmean(square))),
        noise,
        Reason.OK if knowable else Reason.FOCAL_UNKNOWABLE,
        readings,
        twins,
        tuple(_notes(views, readings, given, fit, noise, relative, twins)),
    )


def _twins(view: View, fit: LensFit, noise: float) -> Twins:
    """Both tilts at the lens found, from pixels freed of its distortion."""
    lens = fit.intrinsics
    rays = lens.unproject(view.pixels)
    with np.errstate(all="ignore"):
        straight = lens.focal * rays[:, :2] / rays[:, 2:] + lens.principal_point
    return twin_poses(view.points, straight, lens.focal, lens.principal_point, fit.camera_from_rects[0], noise)


def _notes(
    views: Sequence[View],
    readings: tuple[int, ...],
    given: _Given,
    fit: LensFit,
    noise: float,
    relative: float,
    twins: Twins | None,
) -> list[str]:
    notes = []
    for view, reading in zip(views, readings, strict=True):
        if reading:
            notes.append(f"{view.rectangle!r} was read rotated: reading {reading + 1} of its corners fits best")
    if fit.dof > 0 and fit.chi2 > _MISFIT * fit.dof:
        notes.append(
            f"the points miss a rectangle of this size by {np.sqrt(fit.chi2 / fit.dof):.1f} times their noise: "
            "check the sizes, the order of the corners and that the sheet is flat; the sigmas say too little"
        )
    if given.focal is None:
        if not NORMAL_95 * relative < 1:
            notes.append(f"{REASON_WORDS[Reason.FOCAL_UNKNOWABLE]}")
        if len(views) == 1:
            notes += focal_advice(
                views[0].points,
                fit.intrinsics.focal,
                fit.camera_from_rects[0],
                fit.intrinsics.principal_point,
                noise,
                given.centre_sigma,
                relative,
                given.image_size,
            )
        elif relative > 0.01:
            tilts = np.degrees(view_tilt(fit.camera_from_rects))
            notes.append(
                f"the focal is known to {percent(relative)}: the tilts are {tilts.min():.0f} to {tilts.max():.0f} "
                "degrees; add Views tilted by about 40"
            )
    if twins is not None and twins.log_likelihood_ratio < _SURE_OF_TILT:
        notes.append(
            f"the mirrored tilt fits almost as well (this one is {np.exp(twins.log_likelihood_ratio):.1f} times as "
            "likely): another View decides"
        )
    return notes
