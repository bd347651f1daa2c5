"""Rigs made up from numbers: four cameras around a desk, with Views, residuals and a covariance that fit together."""

from dataclasses import replace

import numpy as np

from quadrig.rig.result import Camera, PlacedBody, PlacedRectangle, Rig, ViewFit
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

FREE_LENS = ("focal", "cx", "cy", "k1", "k2")
FREE_LENS_COLUMNS = [0, 1, 2, 3, 4]
NOISE = 0.3
FRAMESETS = 12


def look_at(position, target) -> Pose:
    """rig_from_camera of a camera whose picture is upright where the rig's y axis points down."""
    z = np.asarray(target, float) - position
    z /= np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Pose(np.column_stack([x, np.cross(z, x), z]), np.asarray(position, float))


def true_cameras() -> list[Camera]:
    target = np.array([0.0, 0.0, 2.0])
    positions = ([0.0, 0.0, 0.0], [1.1, -0.2, 0.3], [-1.2, -0.5, 0.5], [0.4, -1.0, 0.2])
    cameras = []
    for index, position in enumerate(positions):
        pose = Pose.identity() if index == 0 else look_at(position, target)
        distortion = np.array([-0.1 + 0.05 * index, 0.02, 0, 0, 0])
        lens = Intrinsics(1280, 720, 900.0 + 40 * index, np.array([640.0 - 3 * index, 355.0 + index]), distortion)
        cameras.append(Camera(f"cam{index}", lens, pose, FREE_LENS, "radial terms lower the left-out RMS"))
    return cameras


def true_rectangles(rng) -> list[PlacedRectangle]:
    board = Rectangle("board", 0.3, 0.24, CharucoMarking(5, 4, 0.06, 0.045, "aruco_4x4_50"), moving=True)
    steps = np.concatenate([rng.normal(0, 0.4, (FRAMESETS, 3)), rng.normal(0, [0.3, 0.2, 0.2], (FRAMESETS, 3))], 1)
    moving = Pose(np.broadcast_to(np.eye(3), (FRAMESETS, 3, 3)), np.tile([0.0, 0.0, 1.9], (FRAMESETS, 1)))
    desk = Rectangle("desk", 0.2, 0.2, TagMarking("apriltag_36h11", 7))
    wall = Rectangle("wall", 0.25, 0.2, TagMarking("apriltag_36h11", 9))
    stands = Pose.from_vectors(
        np.array([[0.9, 0.1, 0.2], [0.1, 0.3, 0.0]]), np.array([[0.2, 0.4, 1.9], [-0.4, -0.2, 2.4]])
    )
    return [
        PlacedRectangle(board, moving.retract(steps), np.zeros((FRAMESETS, 6, 6)), np.arange(FRAMESETS)),
        PlacedRectangle(desk, stands[0], np.zeros((6, 6))),
        PlacedRectangle(wall, stands[1], np.zeros((6, 6))),
    ]


def simulate_views(cameras, rectangles, rng, noise=NOISE) -> list[View]:
    views = []
    for placed in rectangles:
        rectangle = placed.rectangle
        points = rectangle.marking.points(rectangle)
        for row, frameset in enumerate(placed.framesets if rectangle.moving else range(2)):
            pose = placed.rig_from_rect[row] if rectangle.moving else placed.rig_from_rect
            for camera in cameras:
                lens = camera.intrinsics
                pixels = lens.project((camera.rig_from_camera.inverse() @ pose).transform(points))
                inside = np.all((pixels > 5) & (pixels < [lens.width - 5, lens.height - 5]), axis=1)
                if inside.sum() >= 4:
                    seen = pixels[inside] + rng.normal(0, noise, (inside.sum(), 2))
                    views.append(View(rectangle.name, points[inside], seen, camera.name, int(frameset), sigma=noise))
    return views


def predict(cameras, rectangles, views) -> np.ndarray:
    by_name = {camera.name: camera for camera in cameras}
    placed_by_name = {placed.name: placed for placed in rectangles}
    predicted = []
    for view in views:
        camera, placed = by_name[view.camera], placed_by_name[view.rectangle]
        moving = placed.rectangle.moving
        pose = placed.rig_from_rect[view.frameset] if moving else placed.rig_from_rect
        predicted.append(camera.intrinsics.project((camera.rig_from_camera.inverse() @ pose).transform(view.points)))
    return np.concatenate(predicted)


def stepped(cameras, rectangles, step):
    """Cameras and rectangles after a step: 11 numbers a camera, then 6 a rectangle pose."""
    moved_cameras, at = [], 0
    for camera in cameras:
        parameters = camera.intrinsics.parameters
        parameters[FREE_LENS_COLUMNS] += step[at : at + 5]
        pose = camera.rig_from_camera.retract(step[at + 5 : at + 11])
        moved_cameras.append(
            replace(camera, intrinsics=camera.intrinsics.with_parameters(parameters), rig_from_camera=pose)
        )
        at += 11
    moved_rectangles = []
    for placed in rectangles:
        count = len(placed.framesets) if placed.rectangle.moving else 1
        steps = step[at : at + 6 * count].reshape(count, 6) if placed.rectangle.moving else step[at : at + 6]
        moved_rectangles.append(replace(placed, rig_from_rect=placed.rig_from_rect.retract(steps)))
        at += 6 * count
    return moved_cameras, moved_rectangles


def information_of(cameras, rectangles, views, noise=NOISE) -> np.ndarray:
    count = 11 * len(cameras) + 6 * sum(max(1, len(placed.framesets)) for placed in rectangles)
    columns = []
    for index in range(count):
        size = 1e-2 if index < 11 * len(cameras) and index % 11 < 3 else 1e-5
        step = np.zeros(count)
        step[index] = size
        plus = predict(*stepped(cameras, rectangles, step), views)
        minus = predict(*stepped(cameras, rectangles, -step), views)
        columns.append((plus - minus).ravel() / (2 * size))
    jacobian = np.stack(columns, axis=1)
    return jacobian.T @ jacobian / noise**2


def make_rig(seed: int = 1) -> tuple[Rig, list[Camera], list[PlacedRectangle]]:
    """A Rig drawn from its own covariance around a truth, with its truth."""
    rng = np.random.default_rng(seed)
    cameras, rectangles = true_cameras(), true_rectangles(rng)
    views = simulate_views(cameras, rectangles, rng)
    information = information_of(cameras, rectangles, views)
    free = np.ones(len(information), bool)
    free[5:11] = False  # the first camera is the rig frame
    covariance = np.zeros_like(information)
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    step = np.where(free, rng.multivariate_normal(np.zeros(len(covariance)), covariance), 0.0)
    found_cameras, found_rectangles = stepped(cameras, rectangles, step)
    return _rig(found_cameras, found_rectangles, covariance, views), cameras, rectangles


def carried(rig: Rig) -> Rig:
    """The same cameras, carried from left to right through a hall with four sheets on its walls."""
    names = ("north", "east", "south", "west")
    angles = np.pi / 2 * np.arange(4)
    facing = np.stack([np.sin(angles), np.zeros(4), np.cos(angles)], axis=1)
    hall_from_sheet = Pose.from_vectors(np.outer(angles, [0.0, 1.0, 0.0]), 3.0 * facing)
    across = np.stack([np.linspace(-1, 1, FRAMESETS), np.zeros(FRAMESETS), np.zeros(FRAMESETS)], axis=1)
    hall_from_rig = Pose.from_vectors(0.3 * across[:, [1, 0, 2]], across)
    rig_from_hall, framesets = hall_from_rig.inverse(), np.arange(FRAMESETS)
    sigmas = np.repeat([1e-3, 2e-3], 3)
    doubt = np.tile(np.diag(sigmas**2), (FRAMESETS, 1, 1))
    placed = tuple(
        PlacedRectangle(
            Rectangle(name, 0.297, 0.21, TagMarking("apriltag_36h11", row), moving=True, body="hall"),
            rig_from_hall @ hall_from_sheet[row],
            doubt,
            framesets,
        )
        for row, name in enumerate(names)
    )
    layout = np.diag(np.concatenate([np.zeros(6), np.tile(sigmas**2, 3)]))
    body = PlacedBody("hall", names, hall_from_sheet, layout, rig_from_hall, doubt, framesets)
    return replace(rig, rectangles=placed, bodies=(body,), fits=())


def _rig(cameras, rectangles, covariance, views) -> Rig:
    of_camera = [15 * c + offset for c in range(len(cameras)) for offset in [0, 1, 2, 3, 4, 9, 10, 11, 12, 13, 14]]
    joint = np.zeros((15 * len(cameras), 15 * len(cameras)))
    joint[np.ix_(of_camera, of_camera)] = covariance[: 11 * len(cameras), : 11 * len(cameras)]
    placed, at = [], 11 * len(cameras)
    for rectangle in rectangles:
        count = max(1, len(rectangle.framesets))
        blocks = [covariance[at + 6 * i : at + 6 * i + 6, at + 6 * i : at + 6 * i + 6] for i in range(count)]
        placed.append(replace(rectangle, covariance=np.array(blocks) if rectangle.rectangle.moving else blocks[0]))
        at += 6 * count
    residuals = np.concatenate([view.pixels for view in views]) - predict(cameras, rectangles, views)
    fits, row = [], 0
    for view in views:
        own = residuals[row : row + len(view.points)]
        row += len(view.points)
        fits.append(ViewFit(view, own, np.ones(len(own), bool)))
    rms = float(np.sqrt(np.mean(residuals**2) * 2))
    cameras = tuple(
        replace(camera, rms=rms, held_out_rms=1.1 * rms, views=sum(view.camera == camera.name for view in views))
        for camera in cameras
    )
    return Rig(
        reference="cam0",
        cameras=cameras,
        rectangles=tuple(placed),
        covariance=joint,
        fits=tuple(fits),
        noise=NOISE,
        rms=rms,
        held_out_rms=1.1 * rms,
        working_accuracy=0.0021,
        missing={"cam9": "camera 'cam9' shares no rectangle with the others; show 'board' to it and cam0 together"},
        weak=("cam2: the focal rests on 3 tilted Views; tilt the board more in front of it",),
        costs=(5321.0, 410.2, 88.1, 87.9),
    )
