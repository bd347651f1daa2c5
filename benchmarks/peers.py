"""The same Views given to other solvers: pycolmap's bundle adjustment and OpenCV's calibrateMultiview.

Each gets what it would get from a user: for pycolmap, which has no boards, a first rig from OpenCV, each camera
by itself; its time counts that initialisation. calibrateMultiview initialises itself.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.arrays import Floats
from quadrig.single.lens import image_middle
from quadrig.single.pose import Pose
from quadrig.single.view import View

# OpenCV's flags for a lens of which only the focal is estimated.
STRAIGHT = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
STRAIGHT |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3


@dataclass(frozen=True, eq=False)
class Peer:
    """What a peer found: focal (C,), rig_from_camera (C,) in the frame of the first camera."""

    focal: Floats
    rig_from_camera: Pose


def _first_poses(
    cameras: Sequence[CameraInput], views: Sequence[View], bent: bool, usual: bool
) -> tuple[Floats, dict[tuple[str, int], Pose]]:
    """Each camera by itself: its focal, and camera_from_rect of every View.

    usual: by calibrateCamera, as users do; else by the quickest that OpenCV has, a closed form and solvePnP.
    """
    focals, poses = np.zeros(len(cameras)), {}
    for index, camera in enumerate(cameras):
        own = [v for v in views if v.camera == camera.name]
        points = [v.points.astype(np.float32) for v in own]
        pixels = [v.pixels.astype(np.float32) for v in own]
        if usual:
            size = (camera.width, camera.height)
            flags = 0 if bent else STRAIGHT
            _, matrix, _, turns, places = cv2.calibrateCamera(points, pixels, size, None, None, flags=flags)
            focals[index] = matrix[0, 0]
            for view, turn, place in zip(own, turns, places, strict=True):
                poses[camera.name, view.frameset] = _opencv_pose(turn, place)
            continue
        matrix = cv2.initCameraMatrix2D(points, pixels, (camera.width, camera.height), 1.0)
        focals[index] = matrix[0, 0]
        for view in own:
            _, turn, place = cv2.solvePnP(view.points, view.pixels, matrix, None, flags=cv2.SOLVEPNP_IPPE)
            poses[camera.name, view.frameset] = _opencv_pose(turn, place)
    return focals, poses


def _chained(cameras: Sequence[CameraInput], poses: dict) -> tuple[list[Pose], dict[int, Pose]]:
    """camera_from_rig over the framesets that most cameras share, and rig_from_rect of every frameset."""
    shared: dict[tuple[str, str], list[int]] = defaultdict(list)
    names = [camera.name for camera in cameras]
    for name, frameset in poses:
        for other in names:
            if other != name and (other, frameset) in poses:
                shared[name, other].append(frameset)
    camera_from_rig = {names[0]: Pose.identity()}
    while len(camera_from_rig) < len(names):
        ways = [p for p in shared if p[0] in camera_from_rig and p[1] not in camera_from_rig]
        pair = max(ways, key=lambda p: len(shared[p]))
        steps = [poses[pair[1], f] @ poses[pair[0], f].inverse() for f in shared[pair]]
        middle = np.median([s.translation for s in steps], axis=0)
        best = min(steps, key=lambda s: np.linalg.norm(s.translation - middle))
        camera_from_rig[pair[1]] = best @ camera_from_rig[pair[0]]
    rig_from_rect: dict[int, Pose] = {}
    for name, frameset in poses:
        rig_from_rect.setdefault(frameset, camera_from_rig[name].inverse() @ poses[name, frameset])
    return [camera_from_rig[name] for name in names], rig_from_rect


def pycolmap_rig(cameras: Sequence[CameraInput], views: Sequence[View], bent: bool, usual: bool = False) -> Peer:
    """Bundle adjustment of COLMAP with the board held rigid: each frameset is a frame of a rig of the cameras, the
    board's points are the fixed 3-D points, and the rig moves in the board's frame.

    bent: OPENCV with its principal point; else SIMPLE_PINHOLE with the principal point in the middle.
    usual: start from calibrateCamera instead of the quickest initialisation.
    """
    import pycolmap

    focals, poses = _first_poses(cameras, views, bent, usual)
    camera_from_rig, rig_from_rect = _chained(cameras, poses)
    reconstruction = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    for index, camera in enumerate(cameras):
        middle = image_middle(camera.width, camera.height)
        model = "OPENCV" if bent else "SIMPLE_PINHOLE"
        parameters = [focals[index]] * 2 + [*middle, 0, 0, 0, 0] if bent else [focals[index], *middle]
        number = index + 1
        reconstruction.add_camera(
            pycolmap.Camera(
                model=model, width=camera.width, height=camera.height, params=parameters, camera_id=number
            )
        )
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number)
        if index == 0:
            rig.add_ref_sensor(sensor)
        else:
            rig.add_sensor(sensor, _rigid(camera_from_rig[index]))
    reconstruction.add_rig(rig)
    points = {}
    every = np.unique(np.concatenate([v.points for v in views]), axis=0)
    for point in every:
        points[tuple(point)] = reconstruction.add_point3D(point, pycolmap.Track())
    numbers = {camera.name: index + 1 for index, camera in enumerate(cameras)}
    by_frame: dict[int, list[View]] = defaultdict(list)
    for view in views:
        by_frame[view.frameset].append(view)
    image_id = 0
    for frame_id, frameset in enumerate(sorted(by_frame), start=1):
        frame = pycolmap.Frame(frame_id=frame_id, rig_id=1)
        images = []
        for view in by_frame[frameset]:
            image_id += 1
            number = numbers[view.camera]
            frame.add_data_id(pycolmap.data_t(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number), image_id))
            image = pycolmap.Image(str(image_id), view.pixels, number, image_id)
            image.frame_id = frame_id
            images.append((image, view))
        frame.rig_from_world = _rigid(rig_from_rect[frameset])
        reconstruction.add_frame(frame)
        for image, view in images:
            reconstruction.add_image(image)
            for place, point in enumerate(view.points):
                reconstruction.add_observation(points[tuple(point)], pycolmap.TrackElement(image.image_id, place))
        reconstruction.register_frame(frame_id)
    config = pycolmap.BundleAdjustmentConfig()
    for number in range(1, image_id + 1):
        config.add_image(number)
    for point in points.values():
        config.add_constant_point(point)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = bent
    options.refine_extra_params = bent
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
    found = []
    solved = reconstruction.rig(1)
    for number in range(1, len(cameras) + 1):
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number)
        found.append(Pose.identity() if number == 1 else _pose(solved.sensor_from_rig(sensor)).inverse())
    focal = np.array([reconstruction.camera(n).params[:1][0] for n in range(1, len(cameras) + 1)])
    return Peer(focal, _stack(found))


def multiview(cameras: Sequence[CameraInput], views: Sequence[View], bent: bool) -> Peer:
    """OpenCV's calibrateMultiview. bent: its default lens; else the focal alone."""
    every = np.unique(np.concatenate([v.points for v in views]), axis=0)
    place = {tuple(p): i for i, p in enumerate(every)}
    framesets = sorted({v.frameset for v in views})
    names = [c.name for c in cameras]
    pixels = np.full((len(cameras), len(framesets), len(every), 2), -1.0, np.float32)
    mask = np.zeros((len(cameras), len(framesets)), np.uint8)
    for view in views:
        c, f = names.index(view.camera), framesets.index(view.frameset)
        mask[c, f] = 255
        pixels[c, f, [place[tuple(p)] for p in view.points]] = view.pixels
    flags = np.full((len(cameras), 1), 0 if bent else STRAIGHT, np.int32)
    _, matrices, _, turns, places = cv2.calibrateMultiview(
        [every.astype(np.float32)] * len(framesets),
        [[pixels[c, f] for f in range(len(framesets))] for c in range(len(cameras))],
        [(c.width, c.height) for c in cameras],
        mask,
        np.full((len(cameras), 1), cv2.CALIB_MODEL_PINHOLE, np.uint8),
        [],
        [],
        [],
        [],
        flagsForIntrinsics=flags,
    )
    found = [_opencv_pose(turn, place).inverse() for turn, place in zip(turns, places, strict=True)]
    return Peer(np.array([m[0, 0] for m in matrices]), _stack(found))


def _opencv_pose(turn: np.ndarray, place: np.ndarray) -> Pose:
    """The pose of OpenCV's turn, a vector or a matrix (3, 3), and place."""
    matrix = turn if turn.shape == (3, 3) else cv2.Rodrigues(turn)[0]
    return Pose(np.asarray(matrix, float), np.asarray(place, float).ravel())


def _stack(poses: Sequence[Pose]) -> Pose:
    return Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))


def _rigid(pose: Pose):
    import pycolmap

    return pycolmap.Rigid3d(pycolmap.Rotation3d(pose.rotation), pose.translation)


def _pose(rigid) -> Pose:
    return Pose(rigid.rotation.matrix(), np.asarray(rigid.translation))
