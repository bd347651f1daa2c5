"""Cameras that never see the same thing: what they see is fixed to one room, and the rig is carried through it.

    python examples/10_no_overlap.py

Four cameras look away from each other; a person carries them past twelve A4 sheets in places that nobody measured.
Then two cameras back to back: each has a board of its own, and never sees the other's. Simulated Views, 0.2 px.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig import CameraInput, Rig, calibrate
from quadrig.single import ChessboardMarking, Floats, Intrinsics, Pose, Rectangle, View, rotation_from_vector

NOISE = 0.2
WIDTH, HEIGHT = 1280, 800


@dataclass(frozen=True, eq=False)
class Carried:
    """rig_from_camera of each camera, world_from_rect of each rectangle, world_from_rig at each frameset."""

    cameras: tuple[Pose, ...]
    room: dict[Rectangle, Pose]
    walk: tuple[Pose, ...]
    own_alone: bool = False


def main() -> None:
    """Print, for both rigs, how far each camera is from where it is, beside its sigma."""
    for words, make in (("four outward, twelve sheets", four_outward), ("two back to back", two_back_to_back)):
        world = make(np.random.default_rng(2))
        lenses = [Intrinsics.centred(WIDTH, HEIGHT, 640.0 + 40 * k) for k in range(len(world.cameras))]
        views = seen(world, lenses, np.random.default_rng(3))
        inputs = [CameraInput(f"cam{k}", WIDTH, HEIGHT) for k in range(len(lenses))]
        print_errors(words, world, calibrate(inputs, list(world.room), views, reference="cam0"))


def print_errors(words: str, world: Carried, rig: Rig) -> None:
    """A line for each camera but the first, in whose frame the rig is."""
    for k, pose in enumerate(world.cameras[1:], start=1):
        truth, found = world.cameras[0].inverse() @ pose, rig.camera(f"cam{k}").rig_from_camera
        step = found.step_to(truth)
        turned, moved = np.degrees(np.linalg.norm(step[:3])), 1e3 * np.linalg.norm(step[3:])
        turn_sigma = np.degrees(np.sqrt(3) * rig.rotation_sigma(f"cam{k}"))
        move_sigma = 1e3 * np.sqrt(3) * rig.position_sigma(f"cam{k}")
        sigmas = f"sigmas {turn_sigma:.3f} deg, {move_sigma:.2f} mm"
        print(f"{words}, cam{k}: off by {turned:.3f} deg and {moved:.2f} mm, {sigmas}")


def seen(world: Carried, lenses: list[Intrinsics], rng: np.random.Generator) -> list[View]:
    """The Views of all cameras, whole rectangles alone."""
    views = []
    for frameset, world_from_rig in enumerate(world.walk):
        for k, (lens, rig_from_camera) in enumerate(zip(lenses, world.cameras, strict=True)):
            camera_from_world = (world_from_rig @ rig_from_camera).inverse()
            for n, (rectangle, world_from_rect) in enumerate(world.room.items()):
                points = rectangle.marking.points(rectangle)
                there = (camera_from_world @ world_from_rect).transform(points)
                facing = camera_from_world.rotation @ world_from_rect.rotation[:, 2]
                if (world.own_alone and n != k) or there[:, 2].min() < 0.2 or facing @ there.mean(axis=0) <= 0:
                    continue
                pixels = lens.project(there)
                if ((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all():
                    pixels = pixels + rng.normal(0, NOISE, pixels.shape)
                    views.append(
                        View(rectangle.name, points, pixels, camera=f"cam{k}", frameset=frameset, sigma=NOISE)
                    )
    return views


def four_outward(rng: np.random.Generator) -> Carried:
    """Cameras to all four sides, and a walk round the room for half a minute."""
    room = {}
    for n in range(12):
        angle = 2 * np.pi * n / 12
        place = np.array([2.2 * np.sin(angle), rng.uniform(-0.5, 0.5), 2.0 * np.cos(angle)])
        askew = rotation_from_vector(0.1 * rng.normal(size=3))
        room[Rectangle(f"sheet{n}", 0.297, 0.210, moving=True, body="room")] = Pose(
            askew @ looking(-place, place).rotation, place
        )
    cameras = [looking(np.zeros(3), np.array([np.sin(a), 0.0, np.cos(a)])) for a in np.pi / 2 * np.arange(4)]
    cameras = [Pose(each.rotation, 0.15 * each.rotation[:, 2]) for each in cameras]
    walk = carried(rng, 240, reach=np.array([0.7, 0.2, 0.6]), turn=np.array([0.25, np.pi, 0.2]))
    return Carried(tuple(cameras), room, walk)


def two_back_to_back(rng: np.random.Generator) -> Carried:
    """One camera looks ahead and one behind; a board stands before each."""
    board = ChessboardMarking(9, 6, 0.06)
    room = {}
    for n, side in enumerate((1.0, -1.0)):
        place = np.array([0.0, 0.0, 1.1 * side])
        rectangle = Rectangle(f"board{n}", 0.54, 0.36, board, moving=True, body="room")
        room[rectangle] = Pose(
            rotation_from_vector(0.2 * rng.normal(size=3)) @ looking(-place, place).rotation, place
        )
    ahead = Pose.identity()
    behind = Pose(rotation_from_vector(np.array([0.0, np.pi, 0.0])), np.array([0.02, 0.0, -0.08]))
    walk = carried(rng, 80, reach=np.array([0.25, 0.2, 0.25]), turn=np.array([0.3, 0.3, 0.5]))
    return Carried((ahead, behind), room, walk, own_alone=True)


def carried(rng: np.random.Generator, framesets: int, reach: Floats, turn: Floats) -> tuple[Pose, ...]:
    """world_from_rig of a slow, swaying walk: at most `reach` (3,) m and `turn` (3,) rad from the middle."""
    time = np.linspace(0, 1, framesets)[:, None]
    sway = [np.sin(2 * np.pi * (rng.uniform(0.7, 2.5, 3) * time + rng.uniform(0, 1, 3))) for _ in range(2)]
    steps = zip(turn * sway[0], reach * sway[1], strict=True)
    return tuple(Pose(rotation_from_vector(by), place) for by, place in steps)


def looking(position: Floats, target: Floats) -> Pose:
    """world_from_a of what stands at a position and looks at a target, y down."""
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross([0.0, 1.0, 0.0], z) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], z))
    return Pose(np.stack([x, np.cross(z, x), z], axis=-1), position)


if __name__ == "__main__":
    main()
