"""The renderer against geometry that is known without it."""

import numpy as np
import pytest

from quadrig.single.lens import Intrinsics
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import LINEAR, SRGB, Capture, Glare, Hand, Shadow, ToneCurve
from quadrig.single.render.ground import fabric, wood
from quadrig.single.render.marking_image import marking_image, marking_patches
from quadrig.single.render.picture import Sheet, backdrop, ray_grid, render_image
from quadrig.single.render.room import Room

STRAIGHT = Intrinsics.centred(160, 120, 200.0)
BENT = Intrinsics(160, 120, 130.0, np.array([80.0, 58.0]), np.array([-0.25, 0.08, 1e-3, -5e-4, 0.0]))
SHEET = Rectangle("sheet", 0.2, 0.1, PlainMarking())


def facing(x: float, y: float, z: float) -> Pose:
    return Pose(np.eye(3), np.array([x, y, z]))


def test_light_of_a_sheet_is_its_projected_area():
    sheet = Sheet(SHEET, facing(0.013, -0.007, 0.5), tone=1.0)
    image = render_image(STRAIGHT, Pose.identity(), [sheet], background=0.0, samples=8, colour=False)
    area = (0.2 * 200 / 0.5) * (0.1 * 200 / 0.5)
    # Eight samples a side and whole grey levels leave a hundredth of a pixel's area along the outline.
    assert image.sum() / 255 == pytest.approx(area, rel=2e-3)


def test_middle_of_light_is_where_the_lens_puts_it():
    small = Rectangle("small", 0.01, 0.01, PlainMarking())
    pose = facing(0.18, 0.12, 0.5)
    # Blur leaves the middle of the light where it is, and frees it from the pixels' own middles.
    light = {"background": 0.0, "samples": 6, "capture": Capture(blur=1.0), "colour": False}
    image = render_image(BENT, Pose.identity(), [Sheet(small, pose, tone=1.0)], **light)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    middle = np.array([(x * image).sum(), (y * image).sum()]) / image.sum()
    # Distortion moves the middle of a square 3 px wide by less than this against its projected middle.
    np.testing.assert_allclose(middle, BENT.project(pose.translation), atol=0.01)


def test_nearer_sheet_hides_the_other_whatever_their_order():
    near, far = Sheet(SHEET, facing(0, 0, 0.5), tone=0.9), Sheet(SHEET, facing(0, 0, 0.8), tone=0.2)
    one, other = (
        render_image(STRAIGHT, Pose.identity(), order, colour=False) for order in ([near, far], [far, near])
    )
    np.testing.assert_array_equal(one, other)
    assert one[60, 80] == pytest.approx(0.9 * 255, abs=2)


def test_what_lies_on_a_sheet_later_in_the_list_is_on_top():
    table = Sheet(Rectangle("table", 2.0, 2.0, PlainMarking()), facing(0.6, 0, 0.8), tone=0.2)
    card = Sheet(SHEET, facing(0, 0, 0.8), tone=0.9)
    image = render_image(STRAIGHT, Pose.identity(), [table, card], colour=False)
    assert image[60, 80] > 200


def test_back_of_a_sheet_is_blank():
    tag = Rectangle("tag", 0.2, 0.2, TagMarking("aruco_4x4_50", 1))
    turned = Pose(np.diag([-1.0, 1.0, -1.0]), np.array([0, 0, 0.6]))
    front, back = (
        render_image(STRAIGHT, Pose.identity(), [Sheet(tag, pose)], background=0.5, colour=False)
        for pose in (facing(0, 0, 0.6), turned)
    )
    assert front[40:80, 60:100].std() > 50
    assert back[40:80, 60:100].std() < 1


def test_motion_spreads_an_edge_but_keeps_its_light():
    still = Sheet(SHEET, facing(0, 0, 0.5), tone=1.0)
    moved = Sheet(SHEET, facing(0, 0, 0.5), tone=1.0, motion=np.array([0, 0, 0, 0.02, 0, 0]))
    sharp, soft = (
        render_image(STRAIGHT, Pose.identity(), [s], background=0.0, colour=False).astype(float)
        for s in (still, moved)
    )
    assert soft.sum() == pytest.approx(sharp.sum(), rel=0.01)
    # 0.02 m at 0.5 m and focal 200 are 8 px, so the edge is some 8 px wide.
    between = (soft[60] > 20) & (soft[60] < 235)
    assert 12 <= between.sum() <= 20


def test_noise_and_exposure_are_what_was_asked_for():
    image = render_image(
        STRAIGHT,
        Pose.identity(),
        [],
        background=0.4,
        capture=Capture(noise=3.0, exposure=1.2),
        rng=np.random.default_rng(4),
    )
    assert image.shape == (120, 160, 3)
    assert image.mean() == pytest.approx(0.4 * 1.2 * 255, abs=0.2)
    assert image[..., 0].std() == pytest.approx(3.0, rel=0.05)


def test_same_seed_gives_the_same_picture():
    first, second = (
        render_image(STRAIGHT, Pose.identity(), [], capture=Capture(noise=2.0), rng=np.random.default_rng(9))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_sheet_behind_the_camera_is_not_seen():
    image = render_image(STRAIGHT, Pose.identity(), [Sheet(SHEET, facing(0, 0, -0.5))], background=0.5, colour=False)
    assert np.ptp(image) == 0


def test_room_is_lit_and_soft():
    grid = ray_grid(BENT)
    light = backdrop(grid, Pose(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0, 1.5, 1])), Room())
    assert light.shape == (120, 160, 3)
    assert 0.1 < light.mean() < 0.9
    assert np.isfinite(light).all()


@pytest.mark.parametrize(
    "marking",
    [
        TagMarking("apriltag_36h11", 3),
        CharucoMarking(5, 4, 0.04, 0.03, "aruco_4x4_50"),
        CharucoMarking(5, 4, 0.04, 0.03, "aruco_4x4_50", legacy=True, inverted=True, first_id=7),
        ChessboardMarking(5, 4, 0.04),
        PlainMarking(),
    ],
)
def test_patches_fill_the_rectangle_and_stay_within_the_sheet(marking):
    rectangle = Rectangle("r", 0.2, 0.16, marking)
    sheet, *rest = marking_patches(rectangle)
    assert sheet.right == pytest.approx(0.1 + rectangle.marking.quiet_zone(rectangle))
    if rest:
        assert min(p.left for p in rest) >= -0.1 - 1e-12
        assert max(p.bottom for p in rest) <= 0.08 + 1e-12
    image = marking_image(rectangle, 1000.0)
    assert image.min() >= 0
    assert image.max() <= 1


def test_picture_of_a_marking_keeps_its_ink_at_any_scale():
    rectangle = Rectangle("r", 0.2, 0.16, ChessboardMarking(5, 4, 0.04))
    for density in (500.0, 777.7, 1234.5):
        ink = (1 - marking_image(rectangle, density)).mean() * (0.24 * 0.20)
        assert ink == pytest.approx(0.2 * 0.16 / 2, rel=1e-3)


def white_under(capture: Capture) -> np.ndarray:
    return render_image(STRAIGHT, Pose.identity(), [], background=0.4, capture=capture, colour=False).astype(float)


@pytest.mark.parametrize(("curve", "grey"), [(LINEAR, 102.0), (ToneCurve(2.2), 168.1), (SRGB, 169.6)])
def test_tone_curves_are_those_of_their_names(curve, grey):
    # sRGB of 0.4 and 0.4 to the power 1/2.2, from their published formulas.
    assert white_under(Capture(curve=curve)).mean() == pytest.approx(grey, abs=0.5)
    assert curve(np.array([0.0, 1.0])) == pytest.approx([0, 1])
    light = np.linspace(0, 1, 200)
    assert np.all(np.diff(curve(light)) > 0)


def test_shadow_takes_its_share_within_its_outline():
    outline = ((40.0, 30.0), (100.0, 30.0), (100.0, 90.0), (40.0, 90.0))
    image = white_under(Capture(shadows=(Shadow(outline, depth=0.5),)))
    assert image[60, 70] == pytest.approx(51, abs=1)
    assert image[60, 120] == pytest.approx(102, abs=1)
    # Its edge runs through the middle of a pixel.
    assert image[60, 40] == pytest.approx((51 + 102) / 2, abs=8)
    soft = white_under(Capture(shadows=(Shadow(outline, depth=0.5, softness=6.0),)))
    assert soft.sum() == pytest.approx(image.sum(), rel=2e-3)
    assert np.abs(np.diff(soft, axis=1)).max() < 6


def test_glare_adds_its_light_within_its_outline():
    outline = ((20.0, 20.0), (60.0, 20.0), (60.0, 60.0), (20.0, 60.0))
    plain, glared = (
        white_under(Capture(exposure=0.4, glares=glares)) for glares in ((), (Glare(outline, 0.3, 2.0),))
    )
    added = glared.astype(int) - plain
    assert np.abs(added[35:45, 35:45] - 0.3 * 0.4 * 255).max() <= 1
    assert not added[:10].any()


def test_hand_lies_where_it_points():
    image = white_under(Capture(hands=(Hand((80.0, 60.0), np.pi / 2, 8.0),)))
    assert np.all(image[64:] == 102)
    assert image[52, 76] < 95
    assert image[:30, 60:100].mean() < 95


def test_uneven_light_is_what_was_asked_for():
    image = white_under(Capture(slope=(0.2, 0.0)))
    assert image[:, -1].mean() / image[:, 0].mean() == pytest.approx(1.2 / 0.8, rel=0.01)


def test_corners_of_a_sheet_are_rounded_off():
    sharp, rounded = (
        render_image(
            STRAIGHT,
            Pose.identity(),
            [Sheet(SHEET, facing(0, 0, 0.5), tone=1.0, rounding=radius)],
            background=0.0,
            samples=6,
            colour=False,
        ).astype(float)
        for radius in (0.0, 0.02)
    )
    lost = (4 - np.pi) * (0.02 * 200 / 0.5) ** 2
    assert (sharp - rounded).sum() / 255 == pytest.approx(lost, rel=0.05)


@pytest.mark.parametrize("texture", [wood, fabric])
def test_grounds_are_tones(texture):
    tones = texture((600, 400), np.random.default_rng(1))
    assert tones.shape == (400, 600)
    assert tones.mean() == pytest.approx(0.5, abs=0.02)
    assert tones.min() >= 0
    assert tones.max() <= 1


def test_edge_of_what_lies_on_a_sheet_is_where_it_would_be_without_it():
    # The table's middle is nearer to the camera than the card's, and farther: either way the card is on top, its
    # blurred edge included.
    card = Sheet(SHEET, facing(0, 0, 0.8), tone=0.9)
    capture = Capture(blur=1.5)
    alone = render_image(STRAIGHT, Pose.identity(), [card], background=0.2, capture=capture, colour=False)
    for x in (0.0, 0.3, -0.6):
        ground = Sheet(Rectangle("table", 4.0, 4.0, PlainMarking()), facing(x, 0, 0.8), tone=0.2)
        image = render_image(STRAIGHT, Pose.identity(), [ground, card], capture=capture, colour=False)
        assert np.abs(image.astype(int) - alone).max() <= 1
