"""Tags whose bits run into each other: read where a threshold reads none, and not where there are none."""

import cv2
import numpy as np
import pytest

from quadrig.single.detect.blurred_bits import read_tags
from quadrig.single.detect.dictionaries import tag_cells
from quadrig.single.detect.image_search import detect_views
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Marking, Rectangle
from quadrig.single.render.capture import Capture, ToneCurve
from quadrig.single.render.picture import Sheet, ray_grid, render_image

LENS = Intrinsics(640, 480, 700.0, np.array([321.0, 238.0]), np.array([-0.15, 0.04, 5e-4, -3e-4, 0.0]))
GRID = ray_grid(LENS)
SIDE = 40
ON_A_BOARD, ALONE = np.zeros(20, bool), np.ones(20, bool)


def drawn(dictionary: str, tag: int, turn: int = 0, blur: float = 0.0) -> np.ndarray:
    """A tag of SIDE px with its ring of paper, turned counterclockwise by quarters."""
    cells = np.pad(np.rot90(tag_cells(dictionary, tag), turn), 2, constant_values=True)
    size = SIDE * len(cells) // (len(cells) - 4)
    image = cv2.resize(40 + 180 * cells.astype(np.uint8), (size, size), interpolation=cv2.INTER_NEAREST)
    return image if blur == 0 else cv2.GaussianBlur(image, (0, 0), blur)


def outline(dictionary: str, image: np.ndarray) -> np.ndarray:
    cells = len(tag_cells(dictionary, 0))
    low, high = 2 * len(image) / (cells + 4) - 0.5, (cells + 2) * len(image) / (cells + 4) - 0.5
    return np.array([[[low, low], [high, low], [high, high], [low, high]]])


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize(("dictionary", "blur"), [("apriltag_36h11", 3.0), ("aruco_4x4_50", 3.5)])
def test_a_tag_is_read_with_its_turn_through_blur(dictionary, blur, turn):
    noise = np.random.default_rng(turn).normal(0, 4, (200, 200))
    for tag in (0, 5, 17):
        image = drawn(dictionary, tag, turn, blur)
        image = np.clip(image + noise[: len(image), : len(image)], 0, 255).astype(np.uint8)
        quad = outline(dictionary, image)
        (read,), (corners,) = read_tags(image, quad, dictionary, tuple(range(20)), ON_A_BOARD, 1)
        assert read == tag
        np.testing.assert_array_equal(corners, np.roll(quad[0], turn, axis=0))


@pytest.mark.parametrize(
    ("dictionary", "alone"),
    [
        ("apriltag_36h11", ON_A_BOARD),
        ("aruco_5x5_250", ON_A_BOARD),
        ("aruco_4x4_50", ALONE),
        ("apriltag_16h5", ALONE),
    ],
)
def test_other_tags_and_noise_are_not_read(dictionary, alone):
    rng, wanted = np.random.default_rng(1), tuple(range(20))
    square = np.array([[[10.0, 10], [50, 10], [50, 50], [10, 50]]])
    for tag in range(40):
        for other in ("aruco_6x6_250", "aruco_mip_36h12"):
            image = drawn(other, tag, blur=rng.uniform(0.5, 3))
            assert read_tags(image, outline(other, image), dictionary, wanted, alone, 1)[0] == -1
        clutter = cv2.GaussianBlur(rng.uniform(0, 255, (60, 60)), (0, 0), rng.uniform(1, 6)).astype(np.uint8)
        assert read_tags(clutter, square, dictionary, wanted, alone, 1)[0] == -1


def test_shades_on_a_black_square_are_no_bits():
    """Chessboards in a room have them: of 10,000 quadrilaterals 5 would read as one of twenty tags."""
    image = drawn("aruco_4x4_50", 3, blur=3.0)
    quad, inside = outline("aruco_4x4_50", image), np.s_[len(image) // 4 : -len(image) // 4]
    shaded = np.full(image.shape, 220.0)
    low, high = int(quad.min()) + 1, int(quad.max()) + 1
    shaded[low:high, low:high] = 40
    shaded[inside, inside] += 0.2 * (image[inside, inside] - 40.0)
    read = [
        read_tags(one.astype(np.uint8), quad, "aruco_4x4_50", tuple(range(20)), ON_A_BOARD, 1)[0][0]
        for one in (image, cv2.GaussianBlur(shaded, (0, 0), 1.0))
    ]
    assert read == [3, -1]


@pytest.mark.parametrize(
    "marking", [CharucoMarking(5, 4, 0.05, 0.038, "aruco_4x4_50"), AprilGridMarking(4, 3, 0.054, 0.25)]
)
def test_boards_are_found_in_blur_that_hides_the_bits_of_their_tags(marking: Marking):
    width, height = marking.size or (0.0, 0.0)
    board = Rectangle("board", width, height, marking)
    pose = Pose.from_vectors(np.array([0.3, -0.2, 0.5]), np.array([0.0, 0.0, 2.6 * np.hypot(width, height)]))
    capture = Capture(blur=2.3, noise=2.0, curve=ToneCurve(2.0), jpeg=85)
    image = render_image(GRID, Pose.identity(), [Sheet(board, pose)], capture=capture, samples=3, colour=False)
    (view,) = detect_views(image, [board])
    gap = view.pixels - LENS.project(pose.transform(view.points))
    assert len(gap) > 0.8 * len(marking.points(board))
    assert np.abs(gap).max() < 1
