"""rig.mcap: what is written comes back, other tools find what they know, and bad files are one sentence."""

import json
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from quadrig.io.rig_file.rig_mcap import RIG_TOPIC, read_rig, read_rig_file, write_rig
from quadrig.rig.result import PlacedBody
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose


def assert_same(one, other, where="rig"):
    """Equal to the last bit, nan equal to nan, through dataclasses, tuples and arrays."""
    if is_dataclass(one):
        assert type(one) is type(other), where
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, tuple):
        assert len(one) == len(other), where
        for index, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same(a, b, f"{where}[{index}]")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        assert one.shape == other.shape, where
        np.testing.assert_array_equal(one, other, err_msg=where)
    elif isinstance(one, float):
        np.testing.assert_equal(other, one, err_msg=where)
    else:
        assert one == other, where


@pytest.fixture(scope="module")
def rig_path(example_rig, example_config, tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.mcap"
    times = [5_000_000_000 + 33_000_000 * i for i in range(12)]
    write_rig(path, example_rig, example_config, times, ["/somewhere/room.mcap", "cam1.mp4"])
    return path


def test_a_rig_is_written_over_a_rig_and_never_over_a_recording(tmp_path, example_rig):
    from quadrig.io.recording.convert import image_writer

    path = tmp_path / "room.mcap"
    with path.open("wb") as stream:
        write, finish = image_writer(stream, "foxglove")
        write("cam0", 1, "jpeg", b"picture")
        finish()
    before = path.read_bytes()
    for there in (before, before[: len(before) // 2]):
        path.write_bytes(there)
        with pytest.raises(QuadrigError, match="is a recording and would be replaced by a rig"):
            write_rig(path, example_rig)
        assert path.read_bytes() == there
    for _ in range(2):
        write_rig(tmp_path / "rig.mcap", example_rig)


def test_the_record_comes_back_to_the_last_bit(rig_path, example_rig, example_config):
    held = read_rig_file(rig_path)
    assert_same(held.rig, example_rig)
    assert held.config_text == example_config
    assert held.times[1] == 5_033_000_000
    assert held.version
    assert held.recordings == ("room.mcap", "cam1.mp4")


def random_body(rng, name, count, framesets):
    """A body of so many rectangles, at so many framesets; still where none. Its doubt is partly unknown."""

    def poses(many):
        turns, places = rng.normal(size=(2, *many, 3))
        return Pose.from_vectors(turns, 1e3 ** rng.normal() * places)

    def covariance(*shape):
        root = 1e-3 * rng.normal(size=(*shape, shape[-1]))
        return root @ np.swapaxes(root, -1, -2)

    many = (framesets,) if framesets else ()
    doubt = covariance(*many, 6)
    doubt[..., rng.integers(6), :] = np.nan
    seen = np.sort(rng.choice(1000, framesets, replace=False)).astype(int)
    names = tuple(f"{name} {row}" for row in range(count))
    return PlacedBody(name, names, poses((count,)), covariance(6 * count), poses(many), doubt, seen)


@pytest.mark.parametrize(("count", "framesets"), [(1, 0), (3, 0), (1, 4), (4, 1), (2, 5)])
def test_bodies_come_back_to_the_last_bit(count, framesets, example_rig, tmp_path):
    """Layout, path and the doubt of both, of one that stands and one that moves; clocks and line times too. Whoever
    reads MCAP finds the same numbers."""
    from mcap.reader import make_reader

    rng = np.random.default_rng([count, framesets])
    bodies = random_body(rng, "box", count, framesets), random_body(rng, "wall", 2, 0)
    times = rng.normal(size=(len(example_rig.cameras), 4)) * [0.1, 1e-4, 1e-5, 1e-7]
    cameras = tuple(
        replace(camera, clock_offset=late, clock_offset_sigma=unsure, line_time=line, line_time_sigma=sigma)
        for camera, (late, unsure, line, sigma) in zip(example_rig.cameras, times.tolist(), strict=True)
    )
    rig = replace(example_rig, bodies=bodies, cameras=cameras)
    write_rig(tmp_path / "rig.mcap", rig)
    assert_same(read_rig(tmp_path / "rig.mcap"), rig)
    with (tmp_path / "rig.mcap").open("rb") as stream:
        records = [
            json.loads(message.data) for _, _, message in make_reader(stream).iter_messages(topics=[RIG_TOPIC])
        ]
    for held, body in zip(records[0]["bodies"], bodies, strict=True):
        np.testing.assert_array_equal(held["body_from_rect"], body.body_from_rect.matrix())
        np.testing.assert_array_equal(held["layout_covariance"], body.layout_covariance)
        np.testing.assert_array_equal(held["rig_from_body"], body.rig_from_body.matrix())
        np.testing.assert_array_equal(np.array(held["covariance"], float), body.covariance)


def test_nan_and_infinity_survive(example_rig, tmp_path):
    fit = example_rig.fits[0]
    broken = replace(fit, residuals=np.full_like(fit.residuals, np.nan), rejected="a mirror twin")
    rig = replace(example_rig, fits=(broken,), costs=(float("inf"), 1.0), rms=float("nan"))
    write_rig(tmp_path / "rig.mcap", rig)
    assert_same(read_rig(tmp_path / "rig.mcap"), rig)


def test_foxglove_messages_hold_the_rig(rig_path, example_rig):
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    transforms, calibrations = {}, {}
    with rig_path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, _, message, decoded in reader.iter_decoded_messages(topics=["/tf", "/cam2/camera_info"]):
            assert schema is not None
            if schema.name == "foxglove.CameraCalibration":
                calibrations[decoded.frame_id] = decoded
                continue
            for entry in decoded.transforms:
                assert entry.parent_frame_id == "cam0"
                transforms.setdefault(entry.child_frame_id, []).append((message.log_time, entry))
        assert {m.name: m.metadata for m in reader.iter_metadata()}["quadrig"]["version"]
    lens = example_rig.camera("cam2").intrinsics
    np.testing.assert_array_equal(np.reshape(calibrations["cam2"].K, (3, 3)), lens.camera_matrix)
    np.testing.assert_array_equal(calibrations["cam2"].D, lens.distortion)
    entry = transforms["cam2"][0][1]
    pose = example_rig.camera("cam2").rig_from_camera
    translation = [entry.translation.x, entry.translation.y, entry.translation.z]
    np.testing.assert_array_equal(translation, pose.translation)
    from quadrig.single.rotation import rotation_from_quaternion

    turn = entry.rotation
    rotation = rotation_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w]))
    np.testing.assert_allclose(rotation, pose.rotation, atol=1e-14)  # a quaternion rounds in the last places
    assert len(transforms["board"]) == 12
    assert len({time for time, _ in transforms["board"]}) == 12


def test_a_surveyed_reference_names_the_world(example_rig):
    from quadrig.io.rig_file.rig_mcap import rig_frame_name

    desk = next(placed for placed in example_rig.rectangles if placed.name == "desk")
    assert rig_frame_name(replace(example_rig, reference="desk")) == "world"
    at_origin = replace(desk, rig_from_rect=Pose.identity())
    assert rig_frame_name(replace(example_rig, reference="desk", rectangles=(at_origin,))) == "desk"


@pytest.mark.parametrize("content", [b"", b"nothing", b"not mcap at all", b"\x89MCAP0\r\n", None])
def test_what_is_no_rig_is_one_sentence(content, tmp_path):
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(QuadrigError, match=r"x\.mcap") as caught:
        read_rig(path)
    assert "\n" not in str(caught.value)


def test_a_broken_file_is_one_sentence(rig_path, tmp_path):
    whole = rig_path.read_bytes()
    path = tmp_path / "half.mcap"
    for cut in (len(whole) // 2, 200):
        path.write_bytes(whole[:cut])
        with pytest.raises(QuadrigError, match=r"half\.mcap") as caught:
            read_rig(path)
        assert "EndOfFile" not in str(caught.value)


def test_damage_is_one_sentence_or_harmless(rig_path, example_rig, tmp_path):
    whole, rng = rig_path.read_bytes(), np.random.default_rng(3)
    path = tmp_path / "damaged.mcap"
    said = []
    for place in rng.integers(8, len(whole), 40):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            assert_same(read_rig(path), example_rig)
        except QuadrigError as error:
            said.append(str(error))
    assert said
    assert all("damaged.mcap" in sentence for sentence in said)


def test_nothing_is_left_where_writing_fails(example_rig, tmp_path):
    with pytest.raises(QuadrigError, match="no folder"):
        write_rig(tmp_path / "absent" / "rig.mcap", example_rig)
    odd = replace(example_rig, missing={"cam9": object()})
    with pytest.raises(TypeError):
        write_rig(tmp_path / "rig.mcap", odd)
    assert list(tmp_path.iterdir()) == []


CHANGES = {
    "covariance": lambda rig: replace(rig, covariance=rig.covariance[:-1, :-1]),
    "marks": lambda rig: replace(rig, fits=(replace(rig.fits[0], used=rig.fits[0].used[1:]),)),
    "residuals": lambda rig: replace(rig, fits=(replace(rig.fits[0], residuals=rig.fits[0].residuals[1:]),)),
    "reading": lambda rig: replace(rig, fits=(replace(rig.fits[0], reading=3),)),
    "framesets": lambda rig: replace(rig, rectangles=(replace(rig.rectangles[0], framesets=np.arange(2)),)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_numbers_that_do_not_fit_together_are_one_sentence(name, example_rig, tmp_path):
    write_rig(tmp_path / "rig.mcap", CHANGES[name](example_rig))
    with pytest.raises(QuadrigError, match=r"cannot be read as a rig\.mcap"):
        read_rig(tmp_path / "rig.mcap")
