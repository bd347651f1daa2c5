"""Bodies: rectangles fixed to each other, and rigs that are found from them."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.moved import find_moved
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, image_middle
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import vector_from_rotation


@pytest.fixture(scope="module")
def box(bodies, table_lens):
    """A box of tags that turns before two cameras, and its rig."""
    made = bodies.turntable(np.random.default_rng(1), table_lens, 40)
    return made, calibrate(made.made.inputs, made.made.rectangles, made.made.views, "cam0")


@pytest.fixture(scope="module")
def walk(bodies, table_lens):
    """Four cameras that are carried through a room of tags, no two of which look the same way."""
    made = bodies.carried(np.random.default_rng(2), table_lens, 60)
    return made, calibrate(made.made.inputs, made.made.rectangles, made.made.views, "cam0")


def sigmas_off(step, covariance):
    return np.sqrt(step @ np.linalg.solve(covariance, step) / len(step))


def layout_of(made, body):
    """body_from_rect as it is, in the frame of the first of the body's rectangles."""
    places = [made.made.world_from_rect[name][0] for name in body.rectangles]
    return [places[0].inverse() @ place for place in places]


def test_cameras_stand_where_they_do(box, walk):
    for made, rig in (box, walk):
        assert len(rig.cameras) == len(made.made.inputs)
        for row in range(1, len(rig.cameras)):
            step = rig.cameras[row].rig_from_camera.step_to(made.true(0, row))
            assert sigmas_off(step, rig.pose_covariance(rig.cameras[row].name)) < 2.5


def test_layouts_are_found_with_their_doubt(box, walk):
    for made, rig in (box, walk):
        (body,) = rig.bodies
        for row, true in enumerate(layout_of(made, body)[1:], 1):
            found, covariance = body.rect_from_other(body.rectangles[0], body.rectangles[row])
            assert sigmas_off(found.step_to(true), covariance) < 3
            assert np.sqrt(np.diag(covariance)[3:]).max() < 0.02


def test_one_rectangle_of_a_body_is_its_frame(box):
    _, rig = box
    (body,) = rig.bodies
    known = np.sqrt(np.diag(body.layout_covariance).reshape(-1, 6).sum(axis=1))
    (frame,) = np.flatnonzero(known == 0)
    np.testing.assert_array_equal(body.body_from_rect[frame].matrix(), np.eye(4))


def test_rectangles_stand_where_their_body_has_them(box):
    _, rig = box
    (body,) = rig.bodies
    for row, name in enumerate(body.rectangles):
        placed = next(one for one in rig.rectangles if one.name == name)
        at = np.searchsorted(body.framesets, placed.framesets)
        expected = body.rig_from_body[at] @ body.body_from_rect[row]
        np.testing.assert_allclose(placed.rig_from_rect.matrix(), expected.matrix(), atol=1e-9)
        assert (np.linalg.eigvalsh(placed.covariance) > 0).all()


def test_a_layout_that_is_given_is_kept_and_helps(box):
    made, rig = box
    (body,) = rig.bodies
    layout = dict(zip(body.rectangles, layout_of(made, body), strict=True))
    given = [replace(r, body_from_rect=layout[r.name]) for r in made.made.rectangles]
    known = calibrate(made.made.inputs, given, made.made.views, "cam0")
    np.testing.assert_allclose(known.bodies[0].body_from_rect[2].matrix(), layout["tag2"].matrix(), atol=1e-12)
    assert not known.bodies[0].layout_covariance.any()
    # Known roughly, it is found again, and the surer for it.
    rough = [replace(r, layout_sigma=(0.01, 1e-3)) for r in given]
    roughly = calibrate(made.made.inputs, rough, made.made.views, "cam0")
    angle = np.linalg.norm(
        vector_from_rotation(roughly.bodies[0].body_from_rect.rotation[1].T @ layout["tag1"].rotation)
    )
    assert angle < 0.01
    # Up to the noise, which each of them estimates anew.
    assert known.position_sigma("cam1") < 1.05 * roughly.position_sigma("cam1")
    assert roughly.position_sigma("cam1") < 1.05 * rig.position_sigma("cam1")


def test_a_body_and_its_rectangles_fit_each_other(box):
    made, _ = box
    stands = [replace(r, moving=r.name != "tag1") for r in made.made.rectangles]
    with pytest.raises(QuadrigError, match=r"'box': rectangle '.*' of it moves and 'tag1' stands still"):
        calibrate(made.made.inputs, stands, made.made.views)
    named = [replace(r, body="tag0") for r in made.made.rectangles]
    with pytest.raises(QuadrigError, match="body 'tag0' has the name of a rectangle"):
        calibrate(made.made.inputs, named, made.made.views)


def test_cameras_that_see_nothing_in_common_are_placed_by_their_motion(bodies, table_lens):
    made = bodies.back_to_back(np.random.default_rng([0, 1]), table_lens, 60)
    seen = {camera: {v.rectangle for v in made.made.views if v.camera == camera} for camera in ("cam0", "cam1")}
    assert not seen["cam0"] & seen["cam1"]
    rig = calibrate(made.made.inputs, made.made.rectangles, made.made.views, "cam0")
    assert not rig.missing
    step = rig.camera("cam1").rig_from_camera.step_to(made.true(0, 1))
    assert sigmas_off(step, rig.pose_covariance("cam1")) < 2.5
    assert rig.position_sigma("cam1") < 0.01


def test_what_a_plane_cannot_show_is_said_and_has_no_small_sigma(bodies, table_lens):
    made = bodies.vehicle(np.random.default_rng([0, 5]), table_lens, 60)
    rig = calibrate(made.made.inputs, made.made.rectangles, made.made.views, "cam0")
    (said,) = [sentence for sentence in rig.weak if "cannot be known" in sentence]
    assert said.startswith("cam1: the position along y")
    assert "turn the rig about a second axis" in said
    values, axes = np.linalg.eigh(rig.pose_covariance("cam1")[3:, 3:])
    assert np.sqrt(values[2]) > 5
    assert np.sqrt(values[1]) < 0.05
    assert abs(axes[1, 2]) > 0.99
    step = rig.camera("cam1").rig_from_camera.step_to(made.true(0, 1))
    assert sigmas_off(step, rig.pose_covariance("cam1")) < 2.5


def test_what_nothing_ties_is_said_with_what_would(bodies, table_lens):
    """Each camera sees its own board, but at other times."""
    made = bodies.back_to_back(np.random.default_rng([0, 1]), table_lens, 60)
    views = [v for v in made.made.views if (v.frameset % 2 == 0) == (v.camera == "cam0")]
    rig = calibrate(made.made.inputs, made.made.rectangles, views, "cam0")
    assert list(rig.missing) == ["cam1"]
    few = [v for v in made.made.views if v.frameset < 8]
    rig = calibrate(made.made.inputs, made.made.rectangles, few, "cam0")
    assert "of body 'room' it saw 'board1' and cam0 other rectangles" in rig.missing.get("cam1", "")


def test_boards_on_a_real_body_stand_where_another_tool_has_them(load_script, shared_data):
    """Boards of one rigid body, one lens of 180 degrees: within a few tenths of a millimetre and a twentieth of a
    degree or so of an estimate that is good to as much."""
    wide, folder = load_script("benchmarks/wide.py"), shared_data / "cube"
    boards = wide.boards(folder)
    width, height = wide.SIZE
    sheets = [Rectangle(f"board{number}", 0.6, 0.6, moving=True, body="cube") for number in boards]
    lens = Intrinsics(width, height, 350.0, image_middle(width, height), np.zeros(5), model="fisheye")
    camera = CameraInput("wide", width, height, lens, lens="fisheye")
    rig = calibrate([camera], sheets, wide.views(folder, "train"))
    (cube,) = rig.bodies
    placed = {
        number: pose @ Pose(np.eye(3), boards[number][1]) for number, pose in wide.body_from_boards(folder).items()
    }
    for number in (1, 2, 4):
        true = placed[0].inverse() @ placed[number]
        found, covariance = cube.rect_from_other("board0", f"board{number}")
        step = found.step_to(true)
        assert np.linalg.norm(step[3:]) < 1e-3
        assert np.degrees(np.linalg.norm(step[:3])) < 0.07
        assert np.sqrt(np.diag(covariance)[3:]).max() < 1e-3


def test_a_moved_camera_is_found_where_no_two_see_one_rectangle(walk, bodies, table_lens):
    """By the walls, which stay as they are: a later walk through the same room."""
    made, rig = walk
    later = bodies.carried(np.random.default_rng(2), table_lens, 90)
    np.testing.assert_array_equal(later.rig_from_camera.translation, made.rig_from_camera.translation)
    views = [view for view in later.made.views if view.frameset >= 78]
    assert {move.state for move in find_moved(rig, made.made.rectangles, views)} == {"unmoved"}
    # The rig as it would be, had cam2 been pushed since.
    before = replace(rig.camera("cam2"), rig_from_camera=rig.camera("cam2").rig_from_camera.retract(np.full(6, 0.02)))
    pushed = replace(rig, cameras=tuple(before if one.name == "cam2" else one for one in rig.cameras))
    moves = find_moved(pushed, made.made.rectangles, views)
    assert [move.name for move in moves if move.state == "moved"] == ["cam2"]
    assert abs(moves[2].shift - 0.02 * np.sqrt(3)) < 4 * moves[2].shift_sigma


def test_a_carried_rig_is_good_for_its_poses(walk, box):
    _, rig = walk
    judged = verdict(rig)
    assert judged.grade == "good"
    assert "where its cameras are, to" in judged.headline
    assert "what one of them sees hardly another does" in judged.headline
    # A point in a sliver that two cameras happen to share says nothing of it.
    sliver = verdict(replace(rig, working_accuracy=45.0, point_accuracy=46.0))
    assert (sliver.grade, sliver.headline, sliver.holds) == ("good", judged.headline, "")
    assert rig.room is rig.bodies[0]
    assert box[1].room is None
    assert "volume" in verdict(box[1]).headline


def test_what_turning_about_one_fixed_axis_cannot_show_is_said_and_has_no_small_sigma(bodies, table_lens):
    """Both the turn about the axis and the position along it."""
    made = bodies.spinning(np.random.default_rng([0, 6]), table_lens, 40)
    rig = calibrate(made.made.inputs, made.made.rectangles, made.made.views, "cam0")
    (said,) = [sentence for sentence in rig.weak if "cannot be known" in sentence]
    assert said.startswith("cam1: the turn about y and the position along y of the rig frame cannot be known")
    covariance = rig.pose_covariance("cam1")
    assert np.degrees(np.sqrt(covariance[1, 1])) > 90
    assert np.sqrt(covariance[4, 4]) > 5
    step = rig.camera("cam1").rig_from_camera.step_to(made.true(0, 1))
    assert (np.abs(step) < 3.5 * np.sqrt(np.diag(covariance))).all()
    judged = verdict(rig)
    assert judged.grade == "not yet"
    assert "how cam1 stands to the others is not known" in judged.headline
