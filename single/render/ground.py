"""What sheets lie on: textures of wood and of fabric, to be stretched over a table's Sheet."""

import cv2
import numpy as np

from quadrig.single.arrays import Reals, Singles


def wood(size: tuple[int, int], rng: np.random.Generator, contrast: float = 0.25) -> Singles:
    """Boards with grain (h, w) in [0, 1], of mean 0.5: rings drawn out along the width, fine pores, joints.

    size: width and height, texels. contrast: standard deviation over the mean.
    """
    width, height = size
    y = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    drift = _smooth(rng, (height, width), (width / 3, height / 40))
    rings = np.sin(2 * np.pi * (9 * y + 1.5 * drift)) + 0.5 * np.sin(2 * np.pi * (31 * y + 4 * drift))
    pores = _smooth(rng, (height, width), (width / 25, 0.6))
    boards = np.repeat(rng.normal(0, 0.6, 5), -(-height // 5))[:height, None]
    return _toned(0.7 * rings + 0.5 * pores + boards, contrast)


def fabric(size: tuple[int, int], rng: np.random.Generator, contrast: float = 0.2, threads: int = 160) -> Singles:
    """A woven cloth (h, w) in [0, 1], of mean 0.5: threads over and under each other, uneven, with soft folds."""
    width, height = size
    x = np.linspace(0, np.pi * threads, width, dtype=np.float32)[None]
    y = np.linspace(0, np.pi * threads * height / width, height, dtype=np.float32)[:, None]
    weave = np.sin(x) * np.sin(y) + 0.4 * np.sin(2 * x) * np.cos(y)
    uneven = _smooth(rng, (height, width), (width / 80, 1.0)) + _smooth(rng, (height, width), (1.0, height / 80))
    folds = _smooth(rng, (height, width), (width / 12, height / 8))
    return _toned(0.8 * weave + 0.4 * uneven + 0.6 * folds, contrast)


def _smooth(rng: np.random.Generator, shape: tuple[int, int], scale: tuple[float, float]) -> Singles:
    """Random values of mean 0 and variance 1, alike over so many texels along x and y."""
    # Drawn coarsely where they are smooth, for a wide blur of every texel takes seconds.
    steps = [max(1, int(s / 4)) for s in scale]
    coarse = (max(4, shape[0] // steps[1]), max(4, shape[1] // steps[0]))
    values = rng.standard_normal(coarse, np.float32)
    values = cv2.GaussianBlur(values, (0, 0), max(scale[0] / steps[0], 0.1), sigmaY=max(scale[1] / steps[1], 0.1))
    values = cv2.resize(values, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return (values - values.mean()) / values.std()


def _toned(pattern: Reals, contrast: float) -> Singles:
    pattern = (pattern - pattern.mean()) / pattern.std()
    return np.clip(0.5 * (1 + contrast * pattern), 0, 1).astype(np.float32)
