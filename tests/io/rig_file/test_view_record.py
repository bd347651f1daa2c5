"""A View as JSON comes back whole, whatever it holds, and what was written before it knew all that is read."""

from dataclasses import fields

import msgspec
import numpy as np
import pytest

from quadrig.io.rig_file.view_record import ViewRecord, recorded_view, view_record
from quadrig.single.view import View

RNG = np.random.default_rng(0)
PLAIN = View("sheet", RNG.normal(size=(4, 3)), RNG.uniform(0, 600, (4, 2)))
FULL = View(
    "sheet",
    PLAIN.points,
    PLAIN.pixels,
    camera="cam1",
    frameset=7,
    alternatives=(PLAIN.points[::-1], PLAIN.points[[1, 2, 3, 0]]),
    sigma=0.1 / 3,
    time=1.7e9 + 1 / 3,
    common=RNG.normal(size=(4, 2)),
    back=True,
)


@pytest.mark.parametrize("view", [PLAIN, FULL])
def test_every_field_of_a_view_comes_back_to_the_last_bit(view):
    back = recorded_view(msgspec.json.decode(msgspec.json.encode(view_record(view)), type=ViewRecord))
    for field in fields(View):
        np.testing.assert_equal(getattr(back, field.name), getattr(view, field.name), err_msg=field.name)


def test_the_full_view_is_full():
    """So that a field that is new to View and not to its record does not go unnoticed."""
    for field in fields(View)[3:]:
        assert not np.array_equal(getattr(FULL, field.name), getattr(PLAIN, field.name)), field.name


def test_a_record_without_time_and_common_error_is_read():
    earlier = msgspec.structs.asdict(view_record(PLAIN))
    del earlier["time"], earlier["common"]
    back = recorded_view(msgspec.json.decode(msgspec.json.encode(earlier), type=ViewRecord))
    assert np.isnan(back.time)
    assert back.common is None


@pytest.mark.parametrize(
    "change", [{"points": [[0, 0, 0]]}, {"pixels": [[1, 2, 3]] * 4}, {"pixels": [["x", 1]] * 4},
               {"alternatives": [[[0, 0, 0]]]}, {"common": [[0, 0]]}, {"pixels": []}],
)  # fmt: skip
def test_points_without_pixels_are_a_value_error(change):
    record = msgspec.structs.asdict(view_record(PLAIN)) | change
    with pytest.raises(ValueError, match=r"shape|could not convert"):
        recorded_view(msgspec.convert(record, ViewRecord))
