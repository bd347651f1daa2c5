"""Rigs such as users make, simulated: cameras around a volume, a moving board and a few tags, noise in every corner.

The benchmarks and the tests of quadrig.rig share them. Truth and Views come from one seed, so that every figure can
be made again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.lens import Intrinsics, LensModel, image_middle, project
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import rotation_from_vector, vector_from_rotation
from quadrig.single.view import View

WIDTH, HEIGHT = 1280, 720
# A sheet seen flatter than this (cosine of the tilt) is not detected; nor is a board of fewer corners than these.
_FLATTEST, _FEWEST_CORNERS = 0.35, 12
# What a user would not call a recording: fewer Views of a camera than this.
FEWEST_VIEWS = 6


@dataclass(frozen=True, eq=False)
class Simulated:
    """What a calibration gets (inputs, rectangles, views) and the truth behind it.

    lenses (C, 9); world_from_camera (C,); world_from_rect: of each rectangle, a batch (F,) for moving ones.
    """

    inputs: tuple[CameraInput, ...]
    rectangles: tuple[Rectangle, ...]
    views: tuple[View, ...]
    lenses: Floats
    world_from_camera: Pose
    world_from_rect: dict[str, Pose]
    noise: float

    def index(self, name: str) -> int:
        """Where a camera stands in lenses and world_from_camera."""
        return [camera.name for camera in self.inputs].index(name)

    def rig_from_camera(self, reference: str, name: str) -> Pose:
        """The true pose of a camera in the frame of another."""
        world_from_rig = self.world_from_camera[self.index(reference)]
        return world_from_rig.inverse() @ self.world_from_camera[self.index(name)]


@dataclass(frozen=True)
class Scene:
    """What is drawn at random. noise: px a coordinate; principal: share of the width by which principal points stray;
    tags: static ones beside the moving sheet; board: False for a sheet of four corners; arc: of the cameras, rad."""

    cameras: int = 4
    framesets: int = 24
    noise: float = 0.3
    board: bool = True
    tags: int = 2
    distortion: bool = True
    principal: float = 0.02
    model: LensModel = "pinhole"
    arc: float = 2.2
    focals: tuple[float, float] = (800.0, 1200.0)


def usual_scene(rng: np.random.Generator, **given) -> Scene:
    """A scene as users make them: 3 to 6 cameras, 20 to 40 framesets, 0.1 to 0.6 px."""
    drawn = {
        "cameras": int(rng.integers(3, 7)),
        "framesets": int(rng.integers(20, 41)),
        "noise": float(rng.uniform(0.1, 0.6)),
        "tags": int(rng.integers(1, 4)),
        "arc": float(rng.uniform(1.2, 2.8)),
    }
    return Scene(**{**drawn, **given})


def simulate(seed: int | np.random.Generator, scene: Scene | None = None) -> Simulated:
    """A rig in which every camera has its six Views or more and shares some with others; drawn until it is so."""
    rng = np.random.default_rng(seed)
    scene = scene or Scene()
    while True:
        made = _draw(rng, scene)
        if _like_a_recording(made):
            return made


def views_again(
    made: Simulated,
    scene: Scene,
    seed: int,
    world_from_camera: Pose | None = None,
    path: Pose | None = None,
) -> list[View]:
    """Views of a new recording of the same room: the sheet held elsewhere, or along a path (F,); the cameras where
    given or as they were."""
    rng = np.random.default_rng(seed)
    sheet, points = _sheet(scene)
    poses = made.world_from_camera if world_from_camera is None else world_from_camera
    views = []
    for frameset in range(scene.framesets):
        place = _sheet_pose(rng, made.world_from_camera, frameset) if path is None else path[frameset]
        views += _see(rng, scene, made.lenses, poses, sheet, points, place, frameset)
    return views


def moved_poses(made: Simulated, reference: str, index: int, step: Floats) -> Pose:
    """world_from_camera with one camera moved by a step (6,) of its rig_from_camera."""
    world_from_rig = made.world_from_camera[made.index(reference)]
    poses = [made.world_from_camera[row] for row in range(len(made.inputs))]
    poses[index] = world_from_rig @ (world_from_rig.inverse() @ poses[index]).retract(step)
    return _stack(poses)


def _draw(rng: np.random.Generator, scene: Scene) -> Simulated:
    lenses = np.stack([_lens(rng, scene) for _ in range(scene.cameras)])
    poses = _stack([_camera_pose(rng, scene, i) for i in range(scene.cameras)])
    inputs = tuple(_input(f"cam{i}", scene.model) for i in range(scene.cameras))
    sheet, points = _sheet(scene)
    rectangles, places = [sheet], {"sheet": [_sheet_pose(rng, poses, f) for f in range(scene.framesets)]}
    views = []
    for frameset, place in enumerate(places["sheet"]):
        views += _see(rng, scene, lenses, poses, sheet, points, place, frameset)
    for tag in range(scene.tags):
        rectangle = Rectangle(f"tag{tag}", 0.2, 0.2)
        place = _sheet_pose(rng, poses, tag)
        rectangles.append(rectangle)
        places[rectangle.name] = [place]
        for frameset in range(0, scene.framesets, max(1, scene.framesets // 3)):
            views += _see(rng, scene, lenses, poses, rectangle, rectangle.corners, place, frameset)
    by_name = {name: _stack(found) if name == "sheet" else found[0] for name, found in places.items()}
    return Simulated(inputs, tuple(rectangles), tuple(views), lenses, poses, by_name, scene.noise)


def _lens(rng: np.random.Generator, scene: Scene) -> Floats:
    lens = np.zeros(9)
    lens[0], lens[8] = rng.uniform(*scene.focals), 1.0
    lens[1:3] = image_middle(WIDTH, HEIGHT) + rng.normal(size=2) * scene.principal * WIDTH
    if scene.distortion:
        lens[3:5] = [0.1 * rng.normal(), 0.03 * rng.normal()]
    if scene.model == "fisheye":
        lens[3:7] = [0.03 * rng.normal(), 0.01 * rng.normal(), 0, 0]
    return lens


def _input(name: str, model: LensModel) -> CameraInput:
    if model == "pinhole":
        return CameraInput(name, WIDTH, HEIGHT)
    guess = Intrinsics.centred(WIDTH, HEIGHT, 0.35 * WIDTH, "fisheye")
    return CameraInput(name, WIDTH, HEIGHT, guess, lens="fisheye")


def _camera_pose(rng: np.random.Generator, scene: Scene, index: int) -> Pose:
    angle = scene.arc * (index / max(scene.cameras - 1, 1) - 0.5)
    position = 2.5 * np.array([np.sin(angle), 0, -np.cos(angle)]) + rng.normal(size=3) * [0.2, 0.4, 0.2]
    return facing(position, rng.normal(size=3) * 0.15)


def facing(position: Floats, target: Floats) -> Pose:
    """world_from_camera of a camera that looks at a target, its y axis as near to the world's as can be."""
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross([0.0, 1.0, 0.0], z)
    x = x / np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), position)


def _sheet(scene: Scene) -> tuple[Rectangle, Floats]:
    if scene.board:
        return Rectangle("sheet", 0.54, 0.42, moving=True), board_points(9, 7, 0.06)
    sheet = Rectangle("sheet", 0.42, 0.30, moving=True)
    return sheet, sheet.corners


def _sheet_pose(rng: np.random.Generator, poses: Pose, turn: int) -> Pose:
    """Held up between a camera and its neighbour, each in turn, and tilted."""
    place = rng.uniform([-0.6, -0.4, -0.5], [0.6, 0.4, 0.5])
    count = len(poses.translation)
    first = turn % count
    second = first + 1 if first + 1 < count else max(first - 1, 0)
    share = rng.uniform(0, 0.7)
    eye = (1 - share) * poses.translation[first] + share * poses.translation[second]
    upright = facing(eye, place).rotation
    return Pose(rotation_from_vector(rng.normal(size=3) * 0.4) @ upright, place)


def _see(
    rng: np.random.Generator,
    scene: Scene,
    lenses: Floats,
    poses: Pose,
    rectangle: Rectangle,
    points: Floats,
    place: Pose,
    frameset: int,
) -> list[View]:
    views = []
    for index in range(len(lenses)):
        camera_from_rect = poses[index].inverse() @ place
        sight = camera_from_rect.translation / np.linalg.norm(camera_from_rect.translation)
        if camera_from_rect.rotation[:, 2] @ sight < _FLATTEST:
            continue
        pixels = project(lenses[index], camera_from_rect.transform(points), scene.model)
        with np.errstate(invalid="ignore"):
            inside = ((pixels > 0) & (pixels < [WIDTH - 1, HEIGHT - 1])).all(axis=1)
        whole = len(points) == 4
        if inside.sum() < (4 if whole else _FEWEST_CORNERS):
            continue
        noisy = pixels[inside] + scene.noise * rng.normal(size=(int(inside.sum()), 2))
        views.append(View(rectangle.name, points[inside], noisy, f"cam{index}", frameset))
    return views


def _stack(poses: Sequence[Pose]) -> Pose:
    return Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))


def _like_a_recording(made: Simulated) -> bool:
    seen = {camera.name: 0 for camera in made.inputs}
    keys: dict[tuple[str, int], set[str]] = {}
    for view in made.views:
        seen[view.camera] += view.rectangle == "sheet"
        keys.setdefault((view.rectangle, view.frameset), set()).add(view.camera)
    together = {(a, b) for cameras in keys.values() for a in cameras for b in cameras}
    reached, frontier = {"cam0"}, ["cam0"]
    while frontier:
        here = frontier.pop()
        new = {b for a, b in together if a == here} - reached
        reached |= new
        frontier += sorted(new)
    return len(reached) == len(seen) and min(seen.values()) >= FEWEST_VIEWS


def ring(cameras: int, framesets: int, seed: int = 0, noise: float = 0.3) -> Simulated:
    """Cameras in a closed ring that look inward; every two neighbours are shown a sheet of their own in each
    frameset, which nobody else sees."""
    rng = np.random.default_rng(seed)
    radius = max(2.0, 1.2 * cameras / (2 * np.pi))
    lenses = np.tile([900.0, *image_middle(WIDTH, HEIGHT), 0, 0, 0, 0, 0, 1.0], (cameras, 1))
    lenses[:, 0] = rng.uniform(850, 950, cameras)
    lenses[:, 1:3] += rng.normal(size=(cameras, 2)) * 0.01 * WIDTH
    angle = 2 * np.pi * np.arange(cameras) / cameras
    poses = _stack([facing(radius * np.array([np.sin(a), 0, np.cos(a)]), np.zeros(3)) for a in angle])
    points, scene = board_points(6, 5, 0.09), Scene(cameras, framesets, noise)
    views, rectangles, places = [], [], {}
    for index in range(cameras):
        pair = np.array([index, (index + 1) % cameras])
        rectangle = Rectangle(f"sheet{index}", 0.54, 0.45, moving=True)
        rectangles.append(rectangle)
        between = angle[index] + np.pi / cameras
        found = [_ring_pose(rng, radius, between) for _ in range(framesets)]
        for frameset, place in enumerate(found):
            seen = _see(rng, scene, lenses[pair], poses[pair], rectangle, points, place, frameset)
            views += [replace(v, camera=f"cam{pair[int(v.camera[3:])]}") for v in seen]
        places[rectangle.name] = _stack(found)
    inputs = tuple(_input(f"cam{i}", "pinhole") for i in range(cameras))
    return Simulated(inputs, tuple(rectangles), tuple(views), lenses, poses, places, noise)


def wall(cameras: int, framesets: int, seed: int = 0, noise: float = 0.3) -> Simulated:
    """Cameras side by side and above one another on a wall, all of which see one board in each frameset."""
    rng = np.random.default_rng(seed)
    lenses = np.tile([900.0, *image_middle(WIDTH, HEIGHT), 0, 0, 0, 0, 0, 1.0], (cameras, 1))
    lenses[:, 0] = rng.uniform(850, 950, cameras)
    rows = max(int(np.sqrt(cameras)), 1)
    places = [
        np.array([0.3 * (i // rows - cameras / rows / 2), 0.3 * (i % rows - rows / 2), 0.0]) for i in range(cameras)
    ]
    middle = np.array([0.0, 0.0, 2.5])
    poses = _stack([facing(place, middle) for place in places])
    points, scene, rectangle = (
        board_points(6, 5, 0.09),
        Scene(cameras, framesets, noise),
        Rectangle("board", 0.54, 0.45, moving=True),
    )
    views, found = [], []
    for frameset in range(framesets):
        place = middle + rng.normal(size=3) * [0.15, 0.15, 0.2]
        upright = facing(place, place + np.array([0.0, 0.0, 1.0])).rotation
        found.append(Pose(rotation_from_vector(rng.normal(size=3) * 0.3) @ upright, place))
        views += _see(rng, scene, lenses, poses, rectangle, points, found[-1], frameset)
    inputs = tuple(_input(f"cam{i}", "pinhole") for i in range(cameras))
    return Simulated(inputs, (rectangle,), tuple(views), lenses, poses, {"board": _stack(found)}, noise)


def _ring_pose(rng: np.random.Generator, radius: float, between: float) -> Pose:
    outward = np.array([np.sin(between), 0, np.cos(between)])
    place = (radius - rng.uniform(1.7, 2.3)) * outward + rng.normal(size=3) * [0.08, 0.2, 0.08]
    upright = facing(radius * outward, place).rotation
    return Pose(rotation_from_vector(rng.normal(size=3) * 0.35) @ upright, place)


@dataclass(frozen=True)
class Errors:
    """Mean errors of the cameras of a rig: focal (per cent), rotation (degrees) and place (mm)."""

    focal: float
    rotation: float
    centre: float


def errors(truth: Simulated, rig: Rig) -> Errors:
    """How far a rig is from the truth."""
    focal, rotation, centre = [], [], []
    for camera in rig.cameras:
        focal.append(abs(camera.intrinsics.focal / truth.lenses[truth.index(camera.name), 0] - 1))
        if camera.name != rig.reference:
            true = truth.rig_from_camera(rig.reference, camera.name)
            turn = vector_from_rotation(camera.rig_from_camera.rotation.T @ true.rotation)
            rotation.append(np.degrees(np.linalg.norm(turn)))
            centre.append(1000 * np.linalg.norm(camera.rig_from_camera.translation - true.translation))
    return Errors(100 * float(np.mean(focal)), float(np.mean(rotation)), float(np.mean(centre)))
