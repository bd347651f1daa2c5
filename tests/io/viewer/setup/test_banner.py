"""The large sentence."""

import cv2
import numpy as np
import pytest

from quadrig.io.viewer.setup.banner import banner


@pytest.mark.parametrize("sentence", ["cam1: tilt the sheet more", "a sentence of many words " * 8, "", "x" * 150])
def test_the_large_sentence_fits_into_its_picture(sentence):
    drawn = cv2.imdecode(np.frombuffer(banner(sentence, "", (235, 235, 235)), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert drawn is not None
    rows, columns = np.nonzero(drawn > 100)
    assert bool(len(rows)) == bool(sentence)
    if sentence:
        assert rows.min() > 0
        assert rows.max() < drawn.shape[0] - 1
        assert columns.min() > 0
        assert columns.max() < drawn.shape[1] - 1
