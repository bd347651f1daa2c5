"""The closed forms give back exact corners, whatever the attitude, and say what is not observable."""

import numpy as np
import pytest

from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.closed_form import closed_form
from quadrig.single.solve.corners import Reason
from quadrig.single.solve.cramer_rao import MEAN_ABSOLUTE, cramer_rao
from quadrig.single.solve.maximum_likelihood import solve_points
from quadrig.single.solve.paper_form import paper_form

CENTRE = np.array([959.5, 539.5])
# Rounding of a pixel coordinate near 1000: no method can know the corners better.
ROUNDING = 1e-13


def project(points, focal, camera_from_rect, centre=CENTRE):
    located = points @ np.swapaxes(camera_from_rect.rotation, -1, -2) + camera_from_rect.translation[..., None, :]
    return np.asarray(focal)[..., None, None] * located[..., :2] / located[..., 2:] + centre


def tilted(tilt, direction, spin):
    """Rotations camera_from_rect of sheets tilted by `tilt` towards `direction`, upright sheets turned by `spin`."""
    zero = np.zeros_like(tilt)
    turn = rotation_from_angles(zero, zero, direction)
    return turn @ rotation_from_angles(tilt, zero, zero) @ rotation_from_angles(zero, zero, spin - direction)


def random_views(rng, count, tilt=(0.0, 80.0)):
    """width, height, focal, camera_from_rect, corners: squares, long thin sheets, and what lies between, in front."""
    width = rng.uniform(0.05, 2, count)
    height = width * np.exp(rng.choice([0.0, -0.35, 0.35, -3, 3], count))
    focal = rng.uniform(300, 6000, count)
    rotation = tilted(
        np.radians(rng.uniform(*tilt, count)), rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 2 * np.pi, count)
    )
    depth = np.hypot(width, height) * rng.uniform(1.2, 8, count)
    sideways = rng.uniform(-0.4, 0.4, (count, 2)) * depth[:, None]
    pose = Pose(rotation, np.concatenate([sideways, depth[:, None]], axis=-1))
    seen_from_front = (rotation[..., 2] * pose.translation).sum(axis=-1) > 0.02 * depth
    keep = np.flatnonzero(seen_from_front)
    width, height, focal, pose = width[keep], height[keep], focal[keep], pose[keep]
    return width, height, focal, pose, project(rectangle_corners(width, height), focal, pose)


def reachable(width, height, focal, pose, wanted=1e-9):
    """Views whose focal the rounding of their corners leaves known to the wanted relative accuracy."""
    bound = cramer_rao(rectangle_corners(width, height), focal, pose, CENTRE, ROUNDING)
    return 5 * np.sqrt(bound[:, 0, 0]) < wanted * focal


def relative_pose_error(pose, truth):
    step = truth.step_to(pose)
    distance = np.linalg.norm(truth.translation, axis=-1)
    return np.linalg.norm(step[..., :3], axis=-1) + np.linalg.norm(step[..., 3:], axis=-1) / distance


def test_exact_corners_come_back_from_any_attitude():
    rng = np.random.default_rng(1)
    width, height, focal, pose, corners = random_views(rng, 103_000)
    assert len(focal) >= 100_000
    answer = closed_form(corners, width, height, CENTRE, sigma=ROUNDING)
    sure = reachable(width, height, focal, pose)
    assert sure.mean() > 0.995
    assert (answer.reason[sure] == Reason.OK).all()
    assert np.abs(answer.focal / focal - 1)[sure].max() < 1e-9
    assert relative_pose_error(answer.camera_from_rect, pose)[sure].max() < 2e-9


SPECIAL = [
    (tilt, direction, spin)
    for tilt in (15.0, 40.0, 70.0)
    for direction in (0, 90, 180, -90, 45)
    for spin in (0, 90, 180, -90, 30)
]


@pytest.mark.parametrize("size", [(0.297, 0.21), (0.2, 0.2), (2.0, 0.02), (0.01, 1.0)])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.3, -0.2)])
def test_special_attitudes_have_no_hole(size, offset):
    """theta_x = 0 or theta_y = 0 (the paper's 0/0), theta_z = 0, 90, 180, -90, sheets in the middle of the image."""
    tilt, direction, spin = np.radians(np.array(SPECIAL, float)).T
    depth = 4 * np.hypot(*size)
    translation = np.broadcast_to([offset[0] * depth, offset[1] * depth, depth], (len(tilt), 3))
    pose = Pose(tilted(tilt, direction, spin), translation)
    pose = pose[(pose.rotation[..., 2] * translation).sum(axis=-1) > 0]
    focal = np.full(len(pose.translation), 1400.0)
    corners = project(rectangle_corners(*size), focal, pose)
    answer = closed_form(corners, size[0], size[1], CENTRE, sigma=ROUNDING)
    assert np.abs(answer.focal / 1400 - 1).max() < 1e-9
    assert relative_pose_error(answer.camera_from_rect, pose).max() < 1e-9


def test_corners_on_the_principal_points_row_and_column():
    rng = np.random.default_rng(2)
    width, height, focal, pose, corners = random_views(rng, 2000, (20.0, 70.0))
    for corner in range(4):
        for axis in (0, 1):
            shift = CENTRE[axis] - corners[:, corner, axis]
            depth = (
                pose.translation[:, 2]
                + (pose.rotation @ rectangle_corners(width, height)[:, corner, :, None])[:, 2, 0]
            )
            translation = pose.translation.copy()
            translation[:, axis] += shift / focal * depth
            there = Pose(pose.rotation, translation)
            moved = project(rectangle_corners(width, height), focal, there)
            assert np.abs(moved[:, corner, axis] - CENTRE[axis]).max() < 1e-9
            visible = (there.rotation[..., 2] * translation).sum(axis=-1) > 0.02 * translation[:, 2]
            visible &= reachable(width, height, focal, there)
            answer = closed_form(moved, width, height, CENTRE, sigma=ROUNDING)
            assert np.abs(answer.focal / focal - 1)[visible].max() < 1e-9


def test_the_papers_own_form_agrees_where_it_is_not_singular():
    rng = np.random.default_rng(3)
    width, height, focal, pose, corners = random_views(rng, 5000, (15.0, 75.0))
    answer = paper_form(corners, width, height, CENTRE)
    truth = pose.inverse()
    x_axis, y_axis = pose.rotation[..., 2, 0], pose.rotation[..., 2, 1]
    # Its one constraint is 0/0 where a pair of sides is parallel to the image plane.
    regular = (np.abs(x_axis) > 0.1) & (np.abs(y_axis) > 0.1) & (np.abs(np.log(width / height)) < 1)
    error = np.abs(answer.focal / focal - 1)
    assert np.median(error) < 1e-12
    assert error[regular].max() < 1e-9
    assert relative_pose_error(answer.rect_from_camera, truth)[regular].max() < 1e-7


@pytest.mark.parametrize("theta_z", [0.0, 90.0, 180.0, -90.0, 45.0])
def test_the_papers_form_keeps_every_theta_z(theta_z):
    angles = np.radians([-35.0, 25.0, theta_z])
    rect_from_camera = Pose(rotation_from_angles(*angles), np.zeros(3))
    camera_from_rect = Pose(rect_from_camera.rotation.T, np.array([0.02, -0.03, 1.1]))
    corners = project(rectangle_corners(0.297, 0.21), 1400.0, camera_from_rect)
    answer = paper_form(corners, 0.297, 0.21, CENTRE)
    assert answer.focal == pytest.approx(1400, rel=1e-9)
    found = np.array([answer.theta_x, answer.theta_y, answer.theta_z])
    assert np.abs(np.sin(found - angles)).max() < 1e-9
    assert np.allclose(answer.rect_from_camera.translation, camera_from_rect.inverse().translation, atol=1e-9)


def test_the_papers_form_fails_where_a_side_is_parallel_to_the_image_and_ours_answers():
    pose = Pose(rotation_from_angles(np.radians(40), 0, 0), np.array([0.0, 0.0, 1.0]))
    corners = project(rectangle_corners(0.297, 0.21), 1400.0, pose)
    paper = paper_form(corners, 0.297, 0.21, CENTRE).focal
    assert not abs(paper / 1400 - 1) < 1e-3
    assert closed_form(corners, 0.297, 0.21, CENTRE).focal == pytest.approx(1400, rel=1e-9)


def test_two_constraints_beat_one_under_noise():
    rng = np.random.default_rng(4)
    _, _, focal, pose, _ = random_views(rng, 3000, (20.0, 60.0))
    corners = project(rectangle_corners(0.297, 0.21), focal, pose)
    corners = corners + rng.normal(0, 0.3, corners.shape)
    ours = np.abs(closed_form(corners, 0.297, 0.21, CENTRE).focal / focal - 1)
    paper = np.abs(paper_form(corners, 0.297, 0.21, CENTRE).focal / focal - 1)
    assert np.nanmedian(ours) < 0.65 * np.nanmedian(np.where(np.isnan(paper), np.inf, paper))


def test_fronto_parallel_is_unknowable_but_has_a_pose_for_a_given_focal():
    angles = np.radians([0.0, 90.0, 30.0, -135.0])
    zero = np.zeros_like(angles)
    pose = Pose(rotation_from_angles(zero, zero, angles), np.broadcast_to([0.1, -0.05, 1.2], (4, 3)))
    corners = project(rectangle_corners(0.297, 0.21), np.full(4, 1400.0), pose)
    blind = closed_form(corners, 0.297, 0.21, CENTRE)
    assert (blind.reason == Reason.FOCAL_UNKNOWABLE).all()
    given = closed_form(corners, 0.297, 0.21, CENTRE, focal=1400.0)
    assert relative_pose_error(given.camera_from_rect, pose).max() < 1e-9


def test_sigma_of_the_focal_is_what_noise_does():
    rng = np.random.default_rng(5)
    pose = Pose(tilted(np.radians(40.0), 0.7, 0.2), np.array([0.1, 0.0, 1.0]))
    exact = project(rectangle_corners(0.297, 0.21), 1400.0, pose)
    answer = closed_form(exact + rng.normal(0, 0.2, (4000, 4, 2)), 0.297, 0.21, CENTRE, sigma=0.2)
    # 4000 draws know a standard deviation to 1.1 %; five of those.
    assert answer.focal.std() == pytest.approx(np.median(answer.focal_sigma), rel=0.06)


MIDDLE = np.array([160.0, 120.0])


def test_the_closed_form_is_efficient_and_its_sigma_the_bound():
    """Over all attitudes and shapes, where a focal is known to a per cent."""
    rng = np.random.default_rng(6)
    width, height, focal, pose, corners = random_views(rng, 20_000, (15.0, 75.0))
    bound = np.sqrt(cramer_rao(rectangle_corners(width, height), focal, pose, CENTRE, 0.2)[:, 0, 0])
    known = bound < 0.01 * focal
    answer = closed_form(corners + rng.normal(0, 0.2, corners.shape), width, height, CENTRE, sigma=0.2)
    share = (answer.focal_sigma / bound)[known]
    # Taken at the noisy corners, a sigma strays by some per cent; weights that are not the noise's stray by ten.
    assert np.percentile(share, 1) > 0.95
    assert np.percentile(share, 99) < 1.05
    # 5700 errors know their mean size to 1 %; three of those.
    assert np.mean(np.abs(answer.focal - focal)[known] / bound[known]) / MEAN_ABSOLUTE == pytest.approx(1, abs=0.03)


def behind_in_part(rng, count=300):
    """Formal projections: rectangles some of whose corners lie behind the camera, though most lie before it."""
    rotation = tilted(
        rng.uniform(0.8, 1.3, count), rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 2 * np.pi, count)
    )
    pose = Pose(rotation, np.column_stack([rng.uniform(-0.3, 0.3, (count, 2)), rng.uniform(0.05, 0.4, count)]))
    depths = pose[:, None].transform(rectangle_corners(1.0, 0.8))[..., 2]
    keep = ((depths < -0.02).sum(axis=1) == 1) & (np.abs(depths) > 0.02).all(axis=1)
    assert keep.sum() > 20
    pose = pose[keep]
    return pose, project(rectangle_corners(1.0, 0.8), np.full(int(keep.sum()), 1400.0), pose)


def test_formal_projections_come_back_where_they_are_accepted():
    pose, corners = behind_in_part(np.random.default_rng(7))
    assert (closed_form(corners, 1.0, 0.8, CENTRE).reason != Reason.OK).all()
    answer = closed_form(corners, 1.0, 0.8, CENTRE, photographed=False)
    assert np.abs(answer.focal / 1400 - 1).max() < 1e-8
    assert relative_pose_error(answer.camera_from_rect, pose).max() < 1e-8
    paper = paper_form(corners, 1.0, 0.8, CENTRE, photographed=False)
    assert np.median(np.abs(paper.focal / 1400 - 1)) < 1e-9
    assert np.isnan(paper_form(corners, 1.0, 0.8, CENTRE).focal).all()
    likeliest = solve_points(rectangle_corners(1.0, 0.8), corners, CENTRE, photographed=False)
    assert np.abs(likeliest.focal / 1400 - 1).max() < 1e-8


QUAD = np.array([[300.0, 220.0], [100.0, 200.0], [110.0, 90.0], [290.0, 60.0]])


def bad_members():
    nan, crossing, line, concave = QUAD.copy(), QUAD[[0, 2, 1, 3]], QUAD.copy(), QUAD.copy()
    nan[2, 1] = np.nan
    line[1] = (line[0] + line[2]) / 2
    concave[3] = [180, 150]
    return {
        Reason.NOT_FINITE: nan,
        Reason.CROSSING: crossing,
        Reason.COLLINEAR: line,
        Reason.NOT_CONVEX: concave,
        Reason.REVERSED: QUAD[::-1],
    }


@pytest.mark.parametrize("reason", list(bad_members()))
def test_a_bad_member_is_nan_with_its_reason_and_the_others_are_untouched(reason):
    alone = closed_form(QUAD, 0.3, 0.2, MIDDLE)
    batch = closed_form(np.stack([QUAD, bad_members()[reason], QUAD]), 0.3, 0.2, MIDDLE)
    assert batch.reason[1] == reason
    assert np.isnan(batch.focal[1])
    assert np.isnan(batch.camera_from_rect.rotation[1]).all()
    assert np.isnan(batch.camera_from_rect.translation[1]).all()
    assert batch.reason[0] == batch.reason[2] == alone.reason
    assert batch.focal[[0, 2]] == pytest.approx(float(alone.focal), rel=1e-12)


@pytest.mark.parametrize(("width", "height"), [(0.0, 0.2), (-0.3, 0.2), (0.3, np.nan), (np.inf, 0.2)])
def test_a_side_without_length_is_named(width, height):
    answer = closed_form(np.stack([QUAD, QUAD]), np.array([0.3, width]), np.array([0.2, height]), MIDDLE)
    assert answer.reason[1] == Reason.NO_SIZE
    assert np.isnan(answer.focal[1])
    assert np.isfinite(answer.focal[0])


@pytest.mark.parametrize("shape", [(4,), (3, 2), (2, 4, 3), (4, 4)])
def test_a_wrong_shape_is_an_error_that_names_it(shape):
    with pytest.raises(QuadrigError, match=r"shape"):
        closed_form(np.zeros(shape), 0.3, 0.2, MIDDLE)


def test_any_leading_shape():
    corners = np.broadcast_to(QUAD, (2, 3, 4, 2))
    answer = closed_form(corners, 0.3, np.full((2, 3), 0.2), MIDDLE)
    assert answer.focal.shape == (2, 3)
    assert answer.camera_from_rect.rotation.shape == (2, 3, 3, 3)
    single = closed_form(QUAD, 0.3, 0.2, MIDDLE)
    assert single.focal.shape == ()
    assert np.allclose(answer.focal, single.focal, rtol=1e-12)


def test_an_empty_batch_is_an_empty_answer():
    assert closed_form(np.zeros((0, 4, 2)), 0.3, 0.2, MIDDLE).focal.shape == (0,)


def test_a_principal_point_or_a_noise_that_is_none_is_named():
    with pytest.raises(QuadrigError, match="principal point"):
        closed_form(QUAD, 0.3, 0.2, np.ones(3))
    with pytest.raises(QuadrigError, match="principal point"):
        closed_form(QUAD, 0.3, 0.2, np.array(5.0))
    with pytest.raises(QuadrigError, match="sigma"):
        closed_form(QUAD, 0.3, 0.2, MIDDLE, sigma=0.0)
