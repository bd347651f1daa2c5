"""A box of tags turned by hand before cameras that never see the same face at one time, and what the box itself is.

    rig target --box --paper A3 -o box.pdf --config rig.toml      prints such a box
    python examples/09_box_of_tags.py

Three cameras stand round the box; each sees other faces of it. The faces are where somebody glued them, not where a
cube has them: their layout is found beside the cameras. Pictures are rendered, with blur, noise and a tone curve.
"""

from dataclasses import replace

import numpy as np

from quadrig.rig import CameraInput, Rig, calibrate
from quadrig.single import (
    SRGB,
    Capture,
    Floats,
    Intrinsics,
    Pose,
    Rectangle,
    Sheet,
    TagMarking,
    View,
    detect_views,
    ray_grid,
    render_image,
    rotation_from_vector,
)

SIDE = 0.12
# Glued by hand: m and rad, standard deviations.
GLUED, ASKEW = 0.001, 0.01
FRAMESETS = 16


def main() -> None:
    """Print camera and face poses beside the truth."""
    rng = np.random.default_rng(5)
    box = a_box(rng)
    lens = Intrinsics.centred(640, 480, 610.0)
    grid = ray_grid(lens)
    world_from_cameras = {f"cam{k}": around(2 * np.pi * k / 3, 0.7) for k in range(3)}
    views: list[View] = []
    for frameset in range(FRAMESETS):
        world_from_box = Pose(rotation_from_vector(rng.normal(size=3)), 0.04 * rng.normal(size=3))
        sheets = [Sheet(face, world_from_box @ box_from_face) for face, box_from_face in box.items()]
        capture = Capture(blur=0.7, noise=2.0, curve=SRGB)
        for name, pose in world_from_cameras.items():
            picture = render_image(grid, pose.inverse(), sheets, samples=2, capture=capture, colour=False, rng=rng)
            views += [replace(view, camera=name, frameset=frameset) for view in detect_views(picture, list(box))]

    rig = calibrate(
        [CameraInput(name, lens.width, lens.height) for name in world_from_cameras],
        list(box),
        views,
        reference="cam0",
    )

    shared = {(v.frameset, v.rectangle, v.camera) for v in views}
    twice = sum(len({c for f, r, c in shared if (f, r) == each}) > 1 for each in {(f, r) for f, r, _ in shared})
    print(f"{len(views)} Views, {twice} times a face was seen by two cameras at once")
    for name in ("cam1", "cam2"):
        truth = world_from_cameras["cam0"].inverse() @ world_from_cameras[name]
        off = np.linalg.norm(rig.camera(name).rig_from_camera.translation - truth.translation)
        print(
            f"{name}: position off by {1e3 * off:.2f} mm, sigma {1e3 * np.sqrt(3) * rig.position_sigma(name):.2f} mm"
        )
    print_faces(rig, box)


def print_faces(rig: Rig, box: dict[Rectangle, Pose]) -> None:
    """Where the other faces are in the frame of the first, beside the truth."""
    (body,), (first, *others) = rig.bodies, list(box)
    for face in others:
        found, covariance = body.rect_from_other(first.name, face.name)
        off = np.linalg.norm(found.translation - (box[first].inverse() @ box[face]).translation)
        sigma = np.sqrt(np.trace(covariance[3:, 3:]))
        print(f"{face.name}: on the box off by {1e3 * off:.2f} mm, sigma {1e3 * sigma:.2f} mm")


def a_box(rng: np.random.Generator) -> dict[Rectangle, Pose]:
    """The six tags of a cube, not quite where they should be, by box_from_face."""
    turns = [(0, 0, 0), (0, 1, 0), (0, 2, 0), (0, 3, 0), (1, 0, 0), (3, 0, 0)]
    box = {}
    for number, turn in enumerate(turns):
        rotation = rotation_from_vector(np.pi / 2 * np.array(turn, float))
        glued = Pose(rotation_from_vector(ASKEW * rng.normal(size=3)), GLUED * rng.normal(size=3))
        tag = TagMarking("apriltag_36h11", number)
        face = Rectangle(f"face{number}", SIDE, SIDE, tag, moving=True, body="box")
        box[face] = Pose(rotation, -0.72 * SIDE * rotation[:, 2]) @ glued
    return box


def around(angle: float, distance: float) -> Pose:
    """world_from_camera of a camera that looks at the middle, from slightly above; y points down."""
    position: Floats = distance * np.array([np.sin(angle), -0.35, -np.cos(angle)])
    z = -position / np.linalg.norm(position)
    x = np.cross([0.0, 1.0, 0.0], z) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], z))
    return Pose(np.stack([x, np.cross(z, x), z], axis=-1), position)


if __name__ == "__main__":
    main()
