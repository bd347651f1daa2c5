"""Pictures as people have them: turned by EXIF, 16 bits and floats, with alpha, of one tone, of one pixel."""

from io import BytesIO

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from quadrig.io.commands.main import run
from quadrig.io.recording.decode_image import decode_file
from quadrig.io.recording.picture_header import read_header

ORIENTATION, EXIF, TAKEN, FRACTION, ZONE = 0x0112, 0x8769, 0x9003, 0x9291, 0x9011


def coded(picture, kind, **tags) -> bytes:
    """The file that Pillow writes of a BGR picture, with EXIF tags by name."""
    exif = Image.Exif()
    if "orientation" in tags:
        exif[ORIENTATION] = tags["orientation"]
    names = {"taken": TAKEN, "fraction": FRACTION, "zone": ZONE}
    inner = {names[name]: value for name, value in tags.items() if name in names}
    if inner:
        exif[EXIF] = inner
    stream = BytesIO()
    lossless = {"quality": 100} if kind == "JPEG" else {"lossless": True} if kind == "WEBP" else {}
    Image.fromarray(np.ascontiguousarray(picture[..., ::-1])).save(stream, kind, exif=exif, **lossless)
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "TIFF"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_turns_as_pillow_does(pictures, kind, orientation):
    data = coded(pictures.picture(2), kind, orientation=orientation)
    expected = np.asarray(ImageOps.exif_transpose(Image.open(BytesIO(data))).convert("RGB"))[..., ::-1]
    image, gray = decode_file(data, gray=False), decode_file(data)
    assert image.shape == expected.shape
    assert np.abs(image.astype(int) - expected).max() <= 3
    assert gray.shape == expected.shape[:2] == read_header(data).size[::-1]
    assert bool(read_header(data).turned) == (orientation > 1)
    assert decode_file(data, shrink=2).shape == (-(-gray.shape[0] // 2), -(-gray.shape[1] // 2))


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_when_it_was_taken(pictures, kind):
    local = coded(pictures.picture(0), kind, taken="2024:05:01 12:00:07", fraction="25")
    zoned = coded(pictures.picture(0), kind, taken="2024:05:01 14:00:07", fraction="25", zone="+02:00")
    assert read_header(local).taken == read_header(zoned).taken == 1_714_564_807_250_000_000
    assert read_header(coded(pictures.picture(0), kind, taken="0000:00:00 00:00:00")).taken is None
    assert read_header(coded(pictures.picture(0), kind)).taken is None


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".jp2"])
@pytest.mark.parametrize("bits", [10, 12, 16])
@pytest.mark.parametrize("gray", [True, False])
def test_sixteen_bits(pictures, suffix, bits, gray):
    picture = pictures.picture(4)
    picture = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if gray else picture
    data = cv2.imencode(suffix, picture.astype(np.uint16) << (bits - 8))[1].tobytes()
    assert pictures.number(decode_file(data)) == 4
    assert decode_file(data, gray=False).shape == (pictures.HEIGHT, pictures.WIDTH, 3)
    if gray:
        assert np.array_equal(decode_file(data), picture)
    else:
        assert pictures.colour_error(decode_file(data, gray=False)) <= 1


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
@pytest.mark.parametrize("scale", [1 / 255, 1.0, 1000.0])
@pytest.mark.parametrize("gray", [True, False])
def test_floats_and_whole_numbers(pictures, dtype, scale, gray):
    if dtype == np.int32 and (scale < 1 or not gray):
        pytest.skip("TIFF of OpenCV has these in grey alone, and whole")
    picture = cv2.cvtColor(pictures.picture(5), cv2.COLOR_BGR2GRAY) if gray else pictures.picture(5)
    samples = (picture * scale).astype(dtype)
    if dtype != np.int32:
        samples[0, 0], samples[1, 1], samples[2, 2] = np.nan, np.inf, -5
    data = cv2.imencode(".tiff", samples)[1].tobytes()
    image = decode_file(data)
    assert pictures.number(image) == 5
    assert image[20, 40] == 255
    if dtype != np.int32:
        assert image[0, 0] == image[1, 1] == image[2, 2] == 0
    assert decode_file(data, gray=False).shape == (pictures.HEIGHT, pictures.WIDTH, 3)


@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_alpha_is_seen_on_paper(pictures, kind):
    picture = pictures.picture(6)[..., ::-1]
    alpha = np.full(picture.shape[:2], 255, np.uint8)
    alpha[:10], alpha[50:] = 0, 128
    stream = BytesIO()
    options = {"lossless": True, "exact": True} if kind == "WEBP" else {}
    Image.fromarray(np.dstack([picture, alpha])).save(stream, kind, **options)
    image = decode_file(stream.getvalue(), gray=False)
    assert (image[:10] == 255).all()
    assert np.array_equal(image[10:50], picture[10:50, :, ::-1])
    assert np.abs(image[50:] - (picture[50:, :, ::-1] * (128 / 255) + 127)).max() <= 1
    assert pictures.number(decode_file(stream.getvalue())) == 6


@pytest.mark.parametrize("shape", [(1, 1), (1, 900), (3, 2), (600, 800)])
@pytest.mark.parametrize("tone", [0, 127, 255])
@pytest.mark.parametrize(
    "how",
    [
        ["--paper", "A4"],
        ["--tag", "apriltag_36h11:7", "--width", "0.1"],
        ["--chessboard", "9x6:0.025"],
        ["--charuco", "5x7:0.03:0.022:aruco_4x4_50"],
    ],
)
def test_one_tone_and_one_pixel_are_said_in_one_sentence(tmp_path, capsys, shape, tone, how):
    path = tmp_path / "plain.png"
    cv2.imwrite(str(path), np.full(shape, tone, np.uint8))
    assert run(["single", str(path), *how]) == 1
    said = capsys.readouterr().err
    assert "was not found" in said or "no " in said
    assert said.count("\n") == 1
    assert "unexpected" not in said


def test_single_says_that_it_turned(tmp_path, capsys, room):
    picture = room.picture(0, room.held_poses()[0])
    picture = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    lying = cv2.rotate(picture, cv2.ROTATE_90_COUNTERCLOCKWISE)
    path = tmp_path / "phone.jpg"
    path.write_bytes(coded(lying, "JPEG", orientation=6))
    marking = room.TAG.marking
    tag = ["--tag", f"{marking.dictionary}:{marking.id}", "--width", str(room.TAG.width)]
    assert run(["single", str(path), *tag]) == 0
    assert "the picture was turned by 90 degrees, as its EXIF says" in capsys.readouterr().out
