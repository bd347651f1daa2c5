"""Worlds that real rigs come from, simulated: lenses as people have them, sheets as printers make them (too large or
too small, longer in one direction, bent).

rich: a board waved through 20 to 40 framesets, a few tags. few Views: cameras that look inward or outward, two to
five tags each, one frameset. one sheet: one moving sheet or board, two to seven framesets. clicked: rectangles of a
court, corners pointed at by hand, the noise given. court: the three rectangles of a tennis court, whole, from each of
three cameras, corners pointed at with the noise given. imperfect: rich, half of them waved with frames out of step
and a rolling shutter.
"""

import csv
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from simulated import HEIGHT, WIDTH, Simulated, facing

from quadrig.io.config.known_sizes import known_size
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single import Intrinsics, Rectangle, View
from quadrig.single.arrays import Floats
from quadrig.single.lens import image_middle, project
from quadrig.single.lens_prior import lens_classes
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_vector

# A sheet seen flatter than this (cosine of the tilt) is not detected; nor is a board of fewer corners than these.
_FLATTEST, _FEWEST_CORNERS = 0.3, 12
# Sheets of paper on a board: how far the middle stands off over 0.36 m, and what a printer adds to lengths.
_BEND, _STRETCH, _SCALE = 0.0007, 0.0015, 0.001
# Walls and floors are no bent sheets: from this many times 0.36 m on, they stand off no further.
_STIFF = 3.0
# How fast a hand moves a board (m/s), rows of a picture after one another (s), stamps of one instant (s).
_SPEED, _SHUTTER, _OUT_OF_STEP = 0.3, 0.02, 0.005

# Pixels of sensors are square to far less than this share.
_SQUARE = 0.004

Lens = Callable[[np.random.Generator], Floats]


def table_lens(rng: np.random.Generator) -> Floats:
    """A lens (9,) drawn from the classes of single/lens_table.py."""
    focal = np.exp(np.clip(rng.normal(-0.23, 0.35), -0.9, 0.5)) * WIDTH
    every = np.array([focal])
    _, classes = lens_classes([(WIDTH, HEIGHT)], every, ["pinhole"], own_focals=True).at_focals(every)
    while True:
        row = rng.choice(classes.weight.shape[1], p=classes.weight[0])
        spread = np.linalg.cholesky(classes.covariance[0, row])
        lens = classes.offset[0] + classes.unit[0] * (classes.mean[0, row] + spread @ rng.normal(size=9))
        lens[0] = focal
        if is_a_lens(lens):
            return lens


def lenses_of(path: Path) -> Lens:
    """Lenses as a table of published calibrations has them, one vote a repository; of those that found a camera's
    pixels square, as sensors have them: what misses that missed the rest of the lens too."""
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["model"] == "pinhole_k3" and "wild" not in row["note"]]
    rows = [row for row in rows if abs(float(row["fy"]) / float(row["fx"]) - 1) < _SQUARE]
    votes = Counter(row["source_repo"] for row in rows)
    weight = np.array([1 / votes[row["source_repo"]] for row in rows])

    def draw(rng: np.random.Generator) -> Floats:
        while True:
            row = rows[rng.choice(len(rows), p=weight / weight.sum())]
            width, height, fx, fy = (float(row[key]) for key in ("width", "height", "fx", "fy"))
            scale = WIDTH / max(width, height)
            off = scale * (np.array([float(row["cx"]), float(row["cy"])]) - image_middle(int(width), int(height)))
            bends = [float(row[key] or 0) for key in ("k1", "k2", "p1", "p2", "k3")]
            lens = np.array([fx * scale, *(image_middle(WIDTH, HEIGHT) + off), *bends, fy / fx])
            if is_a_lens(lens):
                return lens

    return draw


def is_a_lens(lens: Floats) -> bool:
    """Whether the radial polynomial reaches the corners of the picture before it folds."""
    r = fold(lens)
    reach = r * (1 + lens[3] * r**2 + lens[4] * r**4 + lens[7] * r**6)
    return 0.3 * WIDTH < lens[0] < 3 * WIDTH and reach * lens[0] > np.hypot(WIDTH, HEIGHT) / 2


def radii(points: Floats) -> Floats:
    """Tangents (P,) of the angles of points (P, 3) of the camera frame from the axis; infinite behind it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(points[:, 2] > 0, np.hypot(points[:, 0], points[:, 1]) / points[:, 2], np.inf)


def fold(lens: Floats) -> float:
    """The tangent from the axis at which a lens's radial polynomial turns back, up to 80 degrees."""
    r = np.linspace(0, 5.7, 2000)
    slope = 1 + 3 * lens[3] * r**2 + 5 * lens[4] * r**4 + 7 * lens[7] * r**6
    return float(r[np.argmax(slope <= 0)]) if (slope <= 0).any() else float(r[-1])


class Room:
    """Cameras and what they see, gathered into a Simulated."""

    def __init__(self, rng: np.random.Generator, lens: Lens, poses: list[Pose], noise: float, given: bool = False):
        self.rng, self.noise, self.sigma = rng, noise, noise if given else float("nan")
        self.lenses = np.stack([lens(rng) for _ in poses])
        self.folds = [fold(one) for one in self.lenses]
        self.poses, self.views, self.rectangles = poses, [], []
        self.places: dict[str, list[Pose]] = {}
        self.true: dict[str, Floats] = {}

    def add(self, rectangle: Rectangle, points: Floats | None = None) -> None:
        """A rectangle, with the points that it bears where these are not its corners, printed as sheets are."""
        self.rectangles.append(rectangle)
        self.places[rectangle.name] = []
        self.true[rectangle.name] = printed(self.rng, rectangle.corners if points is None else points)

    def pixels(self, camera: int, place: Pose, points: Floats) -> Floats:
        """Pixels (P, 2) where a camera sees points of a sheet, nan where it does not."""
        camera_from_rect = self.poses[camera].inverse() @ place
        sight = camera_from_rect.translation / np.linalg.norm(camera_from_rect.translation)
        if camera_from_rect.rotation[:, 2] @ sight < _FLATTEST:
            return np.full((len(points), 2), np.nan)
        pixels = project(self.lenses[camera], camera_from_rect.transform(points))
        with np.errstate(invalid="ignore"):
            inside = ((pixels > 0) & (pixels < [WIDTH - 1, HEIGHT - 1])).all(axis=1)
        # Past its fold a polynomial sends far rays back into the picture.
        sees = inside & (radii(camera_from_rect.transform(points)) < self.folds[camera])
        return np.where(sees[:, None], pixels, np.nan)

    def see(self, rectangle: Rectangle, place: Pose, frameset: int) -> None:
        """Views of all cameras of the corners of a rectangle at a place."""
        self.places[rectangle.name].append(place)
        for camera in range(len(self.poses)):
            self.look(camera, rectangle, rectangle.corners, place, frameset, self.true[rectangle.name])

    def look(
        self,
        camera: int,
        rectangle: Rectangle,
        points: Floats,
        place: Pose,
        frameset: int,
        true: Floats,
        stamp: float = float("nan"),
    ) -> None:
        """The View of one camera, if there is one; true (P, 3): where the points really are on the sheet."""
        pixels = self.pixels(camera, place, true)
        seen = np.isfinite(pixels).all(axis=1)
        if seen.sum() < (4 if len(points) == 4 else _FEWEST_CORNERS):
            return
        noisy = pixels[seen] + self.noise * self.rng.normal(size=(int(seen.sum()), 2))
        name = f"cam{camera}"
        self.views.append(View(rectangle.name, points[seen], noisy, name, frameset, sigma=self.sigma, time=stamp))

    def made(self) -> Simulated:
        inputs = tuple(CameraInput(f"cam{i}", WIDTH, HEIGHT) for i in range(len(self.poses)))
        moving = {r.name for r in self.rectangles if r.moving}
        places = {n: stack(p) if n in moving else p[0] for n, p in self.places.items() if p}
        return Simulated(
            inputs, tuple(self.rectangles), tuple(self.views), self.lenses, stack(self.poses), places, self.noise
        )


def stack(poses: list[Pose]) -> Pose:
    return Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))


def _inward(rng: np.random.Generator, count: int, arc: float) -> list[Pose]:
    angles = arc * (np.arange(count) / max(count - 1, 1) - 0.5)
    at = [2.5 * np.array([np.sin(a), 0, -np.cos(a)]) + rng.normal(size=3) * [0.2, 0.4, 0.2] for a in angles]
    return [facing(place, rng.normal(size=3) * 0.15) for place in at]


def _outward(rng: np.random.Generator, count: int) -> list[Pose]:
    angles = rng.uniform(0.5, 0.75) * np.arange(count)
    out = [np.array([np.sin(a), 0, np.cos(a)]) for a in angles]
    return [facing(0.3 * o + 0.03 * rng.normal(size=3), 3 * o + 0.3 * rng.normal(size=3)) for o in out]


def _held(rng: np.random.Generator, poses: list[Pose], place: Floats, tilt: float) -> Pose:
    """world_from_rect of a sheet held at a place towards one of the cameras, tilted."""
    eye = poses[rng.integers(len(poses))].translation
    return Pose(rotation_from_vector(rng.normal(size=3) * tilt) @ facing(eye, place).rotation, place)


def rich(rng: np.random.Generator, lens: Lens) -> Simulated:
    """A board waved through a volume that cameras look into, and a few tags that stand still."""
    return _waved(rng, lens, int(rng.integers(20, 41)), board=True)


def one_sheet(rng: np.random.Generator, lens: Lens) -> Simulated:
    """One sheet or board, in a few framesets."""
    return _waved(rng, lens, int(rng.integers(2, 8)), board=bool(rng.integers(2)), tags=0)


def imperfect(rng: np.random.Generator, lens: Lens) -> Simulated:
    """Half of the boards are held still for every picture, half are waved, out of step and with a rolling shutter."""
    return _waved(rng, lens, int(rng.integers(20, 41)), board=True, speed=_SPEED * int(rng.integers(2)))


def _waved(
    rng: np.random.Generator,
    lens: Lens,
    framesets: int,
    board: bool,
    tags: int | None = None,
    speed: float = 0.0,
) -> Simulated:
    poses = _inward(rng, int(rng.integers(3, 7)), rng.uniform(1.2, 2.8))
    room = Room(rng, lens, poses, float(rng.uniform(0.1, 0.6)))
    sheet = Rectangle("sheet", 0.54, 0.42, moving=True) if board else Rectangle("sheet", 0.297, 0.21, moving=True)
    points = board_points(9, 7, 0.06) if board else sheet.corners
    room.add(sheet, points)
    true = room.true[sheet.name]
    for frameset in range(framesets):
        place = _held(rng, poses, rng.uniform([-0.6, -0.4, -0.5], [0.6, 0.4, 0.5]), 0.4)
        room.places["sheet"].append(place)
        velocity = speed * rng.normal(size=3) / np.sqrt(3)
        for camera in range(len(poses)):
            late = _OUT_OF_STEP * rng.normal() * (speed > 0)
            at = Pose(place.rotation, place.translation + late * velocity)
            moved = true
            if speed > 0:
                # Rows of the picture are taken after one another: points move on with their row.
                row = room.pixels(camera, at, true)[:, 1] / HEIGHT
                moved = true + np.nan_to_num(_SHUTTER * row)[:, None] * (at.rotation.T @ velocity)
            room.look(camera, sheet, points, at, frameset, moved)
    for tag in range(int(rng.integers(1, 4)) if tags is None else tags):
        rectangle = Rectangle(f"tag{tag}", 0.2, 0.2)
        room.add(rectangle)
        place = _held(rng, poses, rng.uniform([-0.6, -0.4, -0.5], [0.6, 0.4, 0.5]), 0.4)
        for frameset in range(0, framesets, max(1, framesets // 3)):
            room.see(rectangle, place, frameset)
    return room.made()


def printed(rng: np.random.Generator, points: Floats) -> Floats:
    """Points (P, 3) of a sheet as printer and paper make them: too large, longer in one direction, and bent."""
    scale = 1 + _SCALE * rng.normal() + _STRETCH / 2 * rng.normal() * np.array([1, -1, 0])
    half = np.ptp(points, axis=0).max() / 2
    u, v = points[:, 0] / half, points[:, 1] / half
    bends = _BEND * min(2 * half / 0.36, _STIFF) * rng.normal(size=3) / np.sqrt(3)
    result = points * scale
    result[:, 2] += bends @ np.stack([u * u, 2 * u * v, v * v])
    return result


def few_views(rng: np.random.Generator, lens: Lens) -> Simulated:
    """Cameras that look inward or outward, two to five tags each, one frameset."""
    count, wanted, size = int(rng.integers(3, 9)), int(rng.integers(2, 6)), 0.2
    poses = _inward(rng, count, rng.uniform(1.2, 2.8)) if rng.integers(2) else _outward(rng, count)
    room, inward = Room(rng, lens, poses, float(rng.uniform(0.1, 0.4))), poses[0].translation[2] < -1
    seen = np.zeros(count, int)
    for tag in range(400):
        if (seen >= wanted).all():
            break
        place = rng.uniform([-0.7, -0.5, -0.6], [0.7, 0.5, 0.6])
        if not inward:
            direction = poses[rng.integers(count)].rotation @ np.array([*rng.uniform(-0.6, 0.6, 2), 1])
            place = direction / np.linalg.norm(direction) * rng.uniform(1.2, 2.5)
        rectangle = Rectangle(f"tag{tag}", size, size)
        pose = _held(rng, poses, place, 0.5)
        who = [np.isfinite(room.pixels(c, pose, rectangle.corners)).all() for c in range(count)]
        if sum(who) >= 2 and any(seen[c] < wanted for c in np.flatnonzero(who)):
            room.add(rectangle)
            room.see(rectangle, pose, 0)
            seen += np.array(who)
    return room.made()


def clicked(rng: np.random.Generator, lens: Lens) -> Simulated:
    """Rectangles of a court, seen from its sides, corners pointed at with a noise of 2 px that is given."""
    count = int(rng.integers(3, 5))
    angles = rng.uniform(0, 2 * np.pi) + np.arange(count) * rng.uniform(0.6, 1.5)
    far = rng.uniform(12, 18)
    stands = [np.array([far * np.sin(a), -rng.uniform(5, 9), far * np.cos(a)]) for a in angles]
    poses = [facing(stand, rng.normal(size=3) * [0.5, 0.1, 0.5]) for stand in stands]
    room = Room(rng, lens, poses, 2.0, given=True)
    floor = rotation_from_vector(np.array([-np.pi / 2, 0.0, 0.0]))
    boxes = [(6.1, 13.4, 0.0), (5.18, 13.4, 0.0), (6.1, 3.96, 0.0), (5.18, 4.72, 4.34), (5.18, 4.72, -4.34)]
    for index in range(int(rng.integers(2, len(boxes) + 1))):
        width, height, along = boxes[index]
        rectangle = Rectangle(f"box{index}", width, height)
        room.add(rectangle)
        room.see(rectangle, Pose(floor, np.array([0.0, 0.0, along])), 0)
    return room.made()


def court(rng: np.random.Generator, lens: Lens) -> Simulated:
    """A tennis court that fills the pictures of three cameras, every corner clicked with a noise of 2 px."""
    floor = Pose(rotation_from_vector(np.array([-np.pi / 2, 0.0, 0.0])), np.zeros(3))
    rectangles = [Rectangle(name, known_size(name).width, known_size(name).height) for name in COURT]
    angles = rng.uniform(0, 2 * np.pi) + np.array([0, 1, 2]) * rng.uniform(0.8, 1.6)
    room = Room(rng, lens, [facing(np.array([0.0, -1.0, 1.0]), np.zeros(3))] * 3, 2.0, given=True)
    for camera, angle in enumerate(angles):
        rise, aim = rng.uniform(0.35, 0.7), rng.normal(size=3) * [1, 0.1, 1]
        way = np.array([np.cos(rise) * np.sin(angle), -np.sin(rise), np.cos(rise) * np.cos(angle)])
        for distance in np.geomspace(10, 120, 60) * rng.uniform(1.0, 1.1):
            room.poses[camera] = facing(distance * way, aim)
            if np.isfinite(room.pixels(camera, floor, rectangles[0].corners)).all():
                break
    for rectangle in rectangles:
        room.add(rectangle)
        room.see(rectangle, floor, 0)
    return room.made()


WORLDS = {
    "rich": rich,
    "few Views": few_views,
    "one sheet": one_sheet,
    "clicked": clicked,
    "imperfect": imperfect,
    "court": court,
}
COURT = ("tennis court", "tennis singles court", "tennis service area")


def draw(name: str, seed: int, lens: Lens = table_lens) -> Simulated:
    """A rig of a world in which every two cameras are joined; drawn until it is so."""
    rng = np.random.default_rng([seed, list(WORLDS).index(name)])
    while True:
        made = WORLDS[name](rng, lens)
        if joined(made):
            return made


def joined(made: Simulated) -> bool:
    """Whether shared rectangles join all cameras."""
    keys: dict[tuple[str, int], set[str]] = {}
    moving = {rectangle.name: rectangle.moving for rectangle in made.rectangles}
    for view in made.views:
        keys.setdefault((view.rectangle, view.frameset if moving[view.rectangle] else 0), set()).add(view.camera)
    reached, grown = {made.inputs[0].name}, True
    while grown:
        more = {c for cameras in keys.values() if cameras & reached for c in cameras} - reached
        reached, grown = reached | more, bool(more)
    return len(reached) == len(made.inputs)


def given_lens(made: Simulated, camera: int, factor: float = 1.0) -> Simulated:
    """The same with the lens of a camera given, its focal times a factor."""
    lens = made.lenses[camera] * np.array([factor, *np.ones(8)])
    known = Intrinsics.centred(WIDTH, HEIGHT, 1.0).with_parameters(lens)
    inputs = [replace(i, intrinsics=known) if n == camera else i for n, i in enumerate(made.inputs)]
    return replace(made, inputs=tuple(inputs))
