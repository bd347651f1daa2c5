"""A chosen tenth of a recording against every tenth frameset and against the whole: error and sigma of the rig.

python benchmarks/choice.py [rigs]

Simulated rigs of four cameras, each with a recording of 300 framesets in which a hand carries a board from hold to
hold. What moves is blurred: its corners are less sure, or not found. The quick look is made of small pictures of the
board. Were all images alike, the sigmas of a tenth would be sqrt(10) = 3.2 times those of the whole.
"""

import sys
from dataclasses import dataclass, replace

import cv2
import numpy as np
from simulated import HEIGHT, WIDTH, Scene, Simulated, errors, simulate, views_again

from quadrig.rig.calibration import calibrate
from quadrig.rig.coach.select_frames import Looks, choose_framesets
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.lens import project
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_vector, vector_from_rotation
from quadrig.single.view import View

FRAMESETS, HOLDS, SHARE = 300, 24, 0.1
# px: noise of a corner of a still board, the blur that doubles it, and the blur in which nothing is found.
NOISE, DOUBLING, LOST = 0.1, 3.0, 10.0
# Share of a frame's time that the shutter is open: blur is that part of a frame's motion.
OPEN = 0.25
SMALL = (32, 18)


@dataclass(frozen=True, eq=False)
class Take:
    """A simulated rig, the Views of its recording and the quick look at it."""

    made: Simulated
    views: list[View]
    looks: Looks


def take(seed: int) -> Take:
    """A rig and a recording of it, drawn at random."""
    scene = Scene(framesets=HOLDS, noise=NOISE, tags=0)
    made = simulate(seed, scene)
    path = carried(made.world_from_rect["sheet"])
    rng = np.random.default_rng(seed)
    outline = np.array([[-0.27, -0.21, 0], [0.27, -0.21, 0], [0.27, 0.21, 0], [-0.27, 0.21, 0]])
    seen = np.array([_pixels(made, path[k], outline) for k in range(FRAMESETS)])
    blur = OPEN * np.linalg.norm(np.gradient(seen, axis=0), axis=-1).mean(axis=-1)
    blurred = []
    for view in views_again(made, replace(scene, framesets=FRAMESETS), seed, path=path):
        much = blur[view.frameset, int(view.camera[3:])]
        if much < LOST:
            sigma = NOISE * (1 + much / DOUBLING)
            more = np.sqrt(sigma**2 - NOISE**2) * rng.normal(size=view.pixels.shape)
            blurred.append(replace(view, pixels=view.pixels + more, sigma=sigma))
    thumbnails = np.array([[_thumbnail(quad, rng) for quad in row] for row in seen])
    return Take(made, blurred, Looks(thumbnails, (10 + rng.normal(size=blur.shape)) / (1 + np.nan_to_num(blur))))


def carried(holds: Pose) -> Pose:
    """A path (FRAMESETS,) that rests at each of the places and goes smoothly from one to the next."""
    at = np.linspace(0, len(holds.translation) - 1, FRAMESETS)
    leg = np.minimum(at.astype(int), len(holds.translation) - 2)
    share = at - leg
    eased = np.clip((share - 0.3) / 0.4, 0, 1)
    eased = (eased * eased * (3 - 2 * eased))[:, None]
    # A hand is never quite still.
    tremor = 2e-4 * np.sin(np.arange(FRAMESETS) * 1.7)[:, None]
    place = holds.translation[leg] * (1 - eased) + holds.translation[leg + 1] * eased + tremor
    first, second = holds.rotation[leg], holds.rotation[leg + 1]
    turn = vector_from_rotation(second @ np.swapaxes(first, -1, -2))
    return Pose(rotation_from_vector(eased * turn) @ first, place)


def _pixels(made: Simulated, place: Pose, points: Floats) -> Floats:
    """(C, P, 2) where each camera sees points of the sheet."""
    cameras = range(len(made.inputs))
    return np.stack(
        [project(made.lenses[c], (made.world_from_camera[c].inverse() @ place).transform(points)) for c in cameras]
    )


def _thumbnail(quad: Floats, rng: np.random.Generator) -> Floats:
    """A small picture of a board with these corners (4, 2) px; of a bare room where it is turned away."""
    canvas = np.full((4 * SMALL[1], 4 * SMALL[0]), 90, np.uint8)
    along, down = quad[1] - quad[0], quad[3] - quad[0]
    if along[0] * down[1] - along[1] * down[0] > 0:
        board = np.kron(np.indices((7, 9)).sum(axis=0) % 2, np.ones((8, 8))).astype(np.uint8) * 200 + 30
        corners = np.array([[0, 0], [72, 0], [72, 56], [0, 56]], np.float32)
        scaled = (quad * [4 * SMALL[0] / WIDTH, 4 * SMALL[1] / HEIGHT]).astype(np.float32)
        onto = cv2.getPerspectiveTransform(corners, scaled)
        cv2.warpPerspective(board, onto, canvas.shape[::-1], canvas, borderMode=cv2.BORDER_TRANSPARENT)
    small = cv2.resize(canvas, SMALL, interpolation=cv2.INTER_AREA).astype(np.float32)
    return small + 0.3 * rng.normal(size=small.shape).astype(np.float32)


def judge(made: Simulated, rig: Rig) -> tuple[float, float, float]:
    """Error of the cameras' places and its sigma (mm, the root mean square of the cameras'), error of focals (%)."""
    found = errors(made, rig)
    others = [camera.name for camera in rig.cameras if camera.name != rig.reference]
    sigma = np.sqrt(np.mean([np.sum(np.square(rig.position_sigma(name))) for name in others]))
    return found.centre, 1000 * float(sigma), found.focal


def main() -> None:
    """Judge each share of each recording, and print medians."""
    rigs = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    table: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(rigs):
        one = take(seed)
        shares = {
            "whole": range(FRAMESETS),
            "chosen tenth": choose_framesets(one.looks, SHARE).tolist(),
            **{f"every tenth from {k}": range(k, FRAMESETS, 10) for k in (0, 3, 6)},
        }
        for name, kept in shares.items():
            views = [view for view in one.views if view.frameset in set(kept)]
            rig = calibrate(one.made.inputs, one.made.rectangles, views, "cam0")
            seen = judge(one.made, rig) if len(rig.cameras) == len(one.made.inputs) else (np.inf, np.inf, np.inf)
            table.setdefault(name.split(" from")[0], []).append(seen)
    whole = np.median(table["whole"], axis=0)
    print(f"medians of {rigs} rigs          place mm   its sigma mm   focal %   sigma over the whole's")
    for name, rows in table.items():
        place, sigma, focal = np.median(rows, axis=0)
        print(f"{name:24s} {place:10.3f} {sigma:14.3f} {focal:9.4f} {sigma / whole[1]:17.2f}")


if __name__ == "__main__":
    main()
