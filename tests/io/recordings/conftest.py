"""Pictures that say their number, and what every recording test asks of an opened recording."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

WIDTH, HEIGHT = 96, 64
# B, G and R differ, so that exchanged channels show.
BACKGROUND = (60, 120, 200)


def _picture(number: int) -> np.ndarray:
    """BGR, with a white square whose place says the number (0 to 11)."""
    image = np.full((HEIGHT, WIDTH, 3), BACKGROUND, np.uint8)
    image[20:36, 4 + 6 * number : 20 + 6 * number] = 255
    return image


def _number(image: np.ndarray) -> int:
    """The number that a picture, grey or BGR, shows."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    columns = np.flatnonzero(gray[20:36].mean(axis=0) > 190)
    return round((columns.mean() - 11.5) / 6)


def _colour_error(image: np.ndarray) -> float:
    """How far the background's colour is from what it was."""
    return float(np.abs(image[50:60, 8:-8].reshape(-1, 3).mean(axis=0) - BACKGROUND).max())


@pytest.fixture(scope="session")
def pictures() -> SimpleNamespace:
    """picture(k), number(image), colour_error(image), width, height."""
    return SimpleNamespace(picture=_picture, number=_number, colour_error=_colour_error, width=WIDTH, height=HEIGHT)
