"""How many framesets a person needs who obeys the coach, against one who waves the sheet about.

Four cameras stand round a room; every frameset is rendered, searched and solved as `rig setup` does. Both people hold
the same sheet in the same room, with the same trembling hand, until the rig is good for 1 mm.

    python examples/06_coached_setup.py --rigs 6
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.rig import Advice, CameraInput, Coach, Rig, Situation, advise, calibrate, covered_points
from quadrig.single import (
    Capture,
    Floats,
    Intrinsics,
    Pose,
    QuadrigError,
    Rectangle,
    Sheet,
    TagMarking,
    View,
    detect_views,
    ray_grid,
    render_image,
    rotation_from_vector,
)

TARGET = 0.001
MOST_FRAMESETS = 60
SHEET = Rectangle("sheet", 0.17, 0.17, TagMarking("apriltag_36h11", 0), moving=True)
# What a hand misses a place by: metres and radians, standard deviations.
HAND, WRIST = 0.06, 0.12
# Seconds from one hold to the next, for the coach's patience.
SECONDS_A_HOLD = 4.0


@dataclass(frozen=True, eq=False)
class Room:
    """The cameras as they truly are; world: the middle of the room, x right, y down, z forward."""

    lenses: tuple[Intrinsics, ...]
    world_from_cameras: tuple[Pose, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """cam0, cam1, ..."""
        return tuple(f"cam{k}" for k in range(len(self.lenses)))


Person = Callable[[np.random.Generator, Room, Advice, Rig | None], Pose]
"""Where somebody holds the sheet next, world_from_rect, having heard the advice."""


def main() -> None:
    """Print, for each rig, the framesets that each person needed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--target", type=float, default=TARGET, help="metres")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    totals = np.zeros(2)
    print("rig  obeying: framesets  accuracy  true error | waving: framesets  accuracy  true error")
    for seed in range(options.rigs):
        row = f"{seed:3d}"
        for index, person in enumerate((obeys, waves)):
            room = a_room(np.random.default_rng(seed))
            count, rig = framesets_until(options.target, person, room, np.random.default_rng(1000 + seed))
            totals[index] += count
            accuracy = 1000 * rig.working_accuracy if rig else float("nan")
            error = 1000 * true_error(room, rig) if rig else float("nan")
            row += f"{count:20d} {accuracy:6.2f} mm {error:8.2f} mm" + (" |" if index == 0 else "")
        print(row, flush=True)
    print(f"together {int(totals[0])} framesets obeying, {int(totals[1])} waving: ratio {totals[0] / totals[1]:.2f}")


def a_room(rng: np.random.Generator) -> Room:
    """Four cameras in the corners of a room of about four metres, looking into it, no two alike."""
    lenses, poses = [], []
    for corner in np.deg2rad([45, 135, 225, 315]):
        angle, distance = corner + rng.uniform(-0.25, 0.25), rng.uniform(1.9, 2.5)
        position = np.array([distance * np.sin(angle), rng.uniform(-0.9, -0.3), -distance * np.cos(angle)])
        poses.append(looking_at(position, np.array([rng.uniform(-0.3, 0.3), 0.0, rng.uniform(-0.3, 0.3)])))
        lenses.append(Intrinsics.centred(960, 540, rng.uniform(650, 850)))
    return Room(tuple(lenses), tuple(poses))


def looking_at(position: Floats, target: Floats) -> Pose:
    """world_from_camera, upright, the world's y axis pointing down."""
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=-1), position)


def framesets_until(target: float, person: Person, room: Room, rng: np.random.Generator) -> tuple[int, Rig | None]:
    """How many framesets it took until every camera is in a rig of that accuracy, and the rig."""
    inputs = [CameraInput(name, lens.width, lens.height) for name, lens in zip(room.names, room.lenses, strict=True)]
    grids = [ray_grid(lens) for lens in room.lenses]
    views: list[View] = []
    coach, rig = Coach(), None
    shown: frozenset[str] = frozenset()
    for frameset in range(MOST_FRAMESETS):
        proposal = advise(
            Situation(room.names, (SHEET,), tuple(views), rig, None, coach.refused, coach.refused_pairs)
        )
        coach = coach.hear(proposal, shown, SECONDS_A_HOLD * frameset)
        assert coach.advice is not None
        world_from_rect = person(rng, room, coach.advice, rig)
        for name, grid, pose in zip(room.names, grids, room.world_from_cameras, strict=True):
            picture = render_image(
                grid,
                pose.inverse(),
                [Sheet(SHEET, world_from_rect)],
                samples=2,
                capture=Capture(blur=0.8, noise=3.0),
                colour=False,
                rng=rng,
            )
            views += [
                View(v.rectangle, v.points, v.pixels, name, frameset, v.alternatives, v.sigma)
                for v in detect_views(picture, [SHEET])
            ]
        shown = frozenset(view.camera for view in views if view.frameset == frameset)
        try:
            rig = calibrate(inputs, [SHEET], views)
        except (QuadrigError, np.linalg.LinAlgError):
            rig = None
        if rig is not None and len(rig.cameras) == len(room.names) and rig.working_accuracy <= target:
            return frameset + 1, rig
    return MOST_FRAMESETS, rig


def waves(rng: np.random.Generator, room: Room, _advice: Advice, _rig: Rig | None) -> Pose:
    """Somebody who hears nothing: anywhere in the middle of the room, facing one camera or another, tilted."""
    position = rng.uniform([-0.7, -0.5, -0.7], [0.7, 0.4, 0.7])
    camera = room.world_from_cameras[rng.integers(len(room.names))]
    facing = looking_at(camera.translation, position).rotation
    return Pose(facing @ rotation_from_vector(rng.uniform(-0.7, 0.7, 3)), position)


def obeys(rng: np.random.Generator, room: Room, advice: Advice, rig: Rig | None) -> Pose:
    """Somebody who does what is said, as well as a hand can."""
    if advice.ghost is not None and rig is not None:
        world_from_rig = room.world_from_cameras[room.names.index(rig.reference)]
        return trembled(rng, world_from_rig @ advice.ghost)
    groups = advice.groups or (advice.cameras, room.names)
    cameras = next_to_each_other(room, groups[0], groups[1])
    viewpoint = np.mean([camera.translation for camera in cameras], axis=0)
    # In the middle of the room, before the two cameras, and turned to half way between them.
    position = 0.15 * viewpoint + rng.uniform(-0.2, 0.2, 3)
    return trembled(rng, Pose(looking_at(viewpoint, position).rotation, position))


def next_to_each_other(room: Room, first: tuple[str, ...], second: tuple[str, ...]) -> tuple[Pose, Pose]:
    """The cameras, one of each group, that somebody in the room sees next to each other."""
    position = dict(zip(room.names, room.world_from_cameras, strict=True))
    pairs = [(position[a], position[b]) for a in first for b in second if a != b]
    return min(pairs, key=lambda pair: float(np.linalg.norm(pair[0].translation - pair[1].translation)))


def trembled(rng: np.random.Generator, pose: Pose) -> Pose:
    """A pose as a hand holds it."""
    turn = rotation_from_vector(WRIST * rng.standard_normal(3))
    return Pose(turn @ pose.rotation, pose.translation + HAND * rng.standard_normal(3))


def true_error(room: Room, rig: Rig) -> float:
    """Root mean square distance, m, of points triangulated by the rig from where they are, the frame fitted; where
    sheets were seen, which is what the rig's accuracy speaks of."""
    seen = covered_points(rig.rectangles)
    chosen = np.random.default_rng(0).choice(len(seen), min(60, len(seen)), replace=False)
    world = room.world_from_cameras[room.names.index(rig.reference)].transform(seen[chosen])
    found, truth = [], []
    for point in world:
        position = triangulated(room, rig, point)
        if position is not None:
            found.append(position)
            truth.append(point)
    a, b = np.array(found), np.array(truth)
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    rotation = (u * [1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.sqrt((((a - a.mean(0)) @ rotation - (b - b.mean(0))) ** 2).sum(1).mean()))


def triangulated(room: Room, rig: Rig, point: Floats) -> Floats | None:
    """Where the rig sees a point of the world that two cameras have in their pictures: nearest to all of its rays."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    count = 0
    for name, lens, pose in zip(room.names, room.lenses, room.world_from_cameras, strict=True):
        pixel = lens.project(pose.inverse().transform(point))
        if not (np.isfinite(pixel).all() and (pixel > 0).all() and (pixel < [lens.width, lens.height]).all()):
            continue
        camera = rig.camera(name)
        ray = camera.rig_from_camera.rotation @ camera.intrinsics.unproject(pixel)
        across = np.eye(3) - np.outer(ray, ray)
        normal += across
        right += across @ camera.rig_from_camera.translation
        count += 1
    return np.asarray(np.linalg.solve(normal, right), float) if count >= 2 else None


if __name__ == "__main__":
    main()
