"""Frames worth searching: still, sharp, and unlike one another."""

import numpy as np
import pytest

from quadrig.rig.coach.select_frames import LEAST, Looks, choose_framesets, image_quality

HEIGHT, WIDTH = 18, 32


def blob(x: float, y: float) -> np.ndarray:
    """A small bright sheet before a textured wall."""
    wall = 80 + 20 * np.sin(np.arange(HEIGHT)[:, None] * 0.7) * np.cos(np.arange(WIDTH) * 0.5)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    return wall + 120 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 8)


def carried(framesets: int = 300, holds: int = 30, cameras: int = 2, seed: int = 1):
    """A sheet that is held still at `holds` places in turn and carried between them: looks, place, speed."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([4, 4], [WIDTH - 4, HEIGHT - 4], (holds + 1, 2))
    time = np.linspace(0, holds, framesets, endpoint=False)
    leg, share = time.astype(int), time % 1
    eased = np.clip((share - 0.5) / 0.5, 0, 1)[:, None]
    path = places[leg] * (1 - eased) + places[leg + 1] * eased
    thumbnails = np.array([[blob(x, y), blob(WIDTH - x, y)][:cameras] for x, y in path])
    thumbnails += rng.normal(0, 0.5, thumbnails.shape)
    speed = np.linalg.norm(np.gradient(path, axis=0), axis=1)
    sharpness = np.repeat((10 / (1 + speed))[:, None], cameras, axis=1)
    return Looks(thumbnails.astype(np.float32), sharpness), path, speed, leg


def test_still_frames_of_every_place():
    looks, _, speed, leg = carried()
    chosen = choose_framesets(looks, 0.1)
    assert len(chosen) == 30
    assert np.all(np.diff(chosen) > 0)
    assert np.mean(speed[chosen] < 0.1) > 0.9
    # Three quarters of the places at least; some of the random ones lie beside each other.
    assert len(set(leg[chosen])) >= 22


def test_chosen_places_are_spread_wider_than_every_tenth_frame():
    looks, path, _, _ = carried(seed=3)
    chosen = choose_framesets(looks, 0.1)

    def farthest(indices):
        return np.linalg.norm(path[:, None] - path[indices], axis=2).min(axis=1).max()

    assert farthest(chosen) < farthest(np.arange(0, 300, 10)) + 2.0


def test_blurred_and_missing_images_are_not_chosen():
    looks, _, _, _ = carried(holds=1)
    thumbnails, sharpness = looks.thumbnails.copy(), looks.sharpness.copy()
    sharpness[:] = 10.0
    sharpness[::2] = 4.0
    assert np.all(choose_framesets(Looks(thumbnails, sharpness), 0.1) % 2 == 1)
    thumbnails[1::2], sharpness[1::2] = np.nan, np.nan
    assert np.all(choose_framesets(Looks(thumbnails, sharpness), 0.1) % 2 == 0)
    assert np.all(image_quality(Looks(thumbnails, sharpness))[1::2] == 0)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("framesets", [2, 5, 12, 40])
def test_any_size(share, framesets):
    looks, _, _, _ = carried(framesets, holds=3)
    chosen = choose_framesets(looks, share)
    assert len(chosen) == min(framesets, max(LEAST, round(share * framesets)))
    assert len(set(chosen.tolist())) == len(chosen)


def test_a_camera_that_never_had_an_image():
    looks, _, speed, _ = carried()
    looks.thumbnails[:, 1] = np.nan
    looks.sharpness[:, 1] = np.nan
    chosen = choose_framesets(looks, 0.1)
    assert len(chosen) == 30
    assert np.mean(speed[chosen] < 0.1) > 0.9


def test_long_recordings_are_thinned_first():
    looks, _, speed, _ = carried(4000, holds=400, cameras=1)
    chosen = choose_framesets(looks, 0.02)
    assert len(chosen) == 80
    assert np.mean(speed[chosen] < 0.1) > 0.9
