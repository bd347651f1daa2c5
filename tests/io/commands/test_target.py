"""`rig target`: what it draws is rendered by another program and found again, at its size."""

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.config.known_sizes import PAPER_SIZES
from quadrig.io.config.rig_toml import parse_config, read_config
from quadrig.io.sheet.layout import paper_named, parse_ids, parse_measured
from quadrig.single.arrays import Picture
from quadrig.single.detect.image_search import detect_views
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.rectangle import Rectangle

DPI = 150


def rendered(pdf: Path) -> list[Picture]:
    # pdftoppm of the same package moves edges to whole pixels; pdftocairo leaves them where they are.
    if shutil.which("pdftocairo") is None:
        pytest.skip("pdftocairo (poppler-utils), which renders the PDF, is not installed")
    subprocess.run(["pdftocairo", "-png", "-gray", "-r", str(DPI), str(pdf), str(pdf.with_suffix(""))], check=True)
    pages = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in sorted(pdf.parent.glob(f"{pdf.stem}-*.png"))]
    return [np.asarray(page, np.uint8) for page in pages if page is not None]


def drawn(tmp_path: Path, capsys, *arguments: str) -> tuple[tuple[Rectangle, ...], list[Picture]]:
    """The rectangles of the printed rig.toml lines, and the pages."""
    pdf = tmp_path / "sheet.pdf"
    assert run(["target", *arguments, "-o", str(pdf)]) == 0
    return parse_config(capsys.readouterr().out).rectangles, rendered(pdf)


def assert_true_size(rectangles, pages) -> None:
    """Every rectangle is found once, upright, and its points lie as many millimetres apart as rig.toml says."""
    views = {view.rectangle: view for page in pages for view in detect_views(page, rectangles)}
    assert set(views) == {r.name for r in rectangles}
    for view in views.values():
        metres = view.pixels * 0.0254 / DPI
        gap = (metres - metres.mean(axis=0)) - (view.points - view.points.mean(axis=0))[:, :2]
        # A tenth of a pixel at this resolution is 0.02 mm; paper shrinks more than that in a dry room.
        assert np.abs(gap).max() < 2e-5


@pytest.mark.parametrize("paper", ["A4", "A3", "letter"])
@pytest.mark.parametrize("kind", ["tag", "charuco", "aprilgrid", "chessboard", "circles", "acircles"])
def test_sheet_is_found_at_its_true_size(tmp_path, capsys, kind, paper):
    rectangles, pages = drawn(tmp_path, capsys, "--kind", kind, "--paper", paper)
    assert len(pages) == 1
    long, short = (round(side * 1e3 / 25.4 * DPI) for side in PAPER_SIZES[paper])
    assert sorted(pages[0].shape) == pytest.approx([short, long], abs=1)
    assert_true_size(rectangles, pages)


def test_each_tag_has_a_page_unless_several_are_asked_for(tmp_path, capsys):
    rectangles, pages = drawn(tmp_path, capsys, "--kind", "tag", "--ids", "0-3", "--paper", "A4")
    assert [r.name for r in rectangles] == ["tag0", "tag1", "tag2", "tag3"]
    assert len(pages) == 4
    assert_true_size(rectangles, pages)


def test_several_tags_on_a_page(tmp_path, capsys):
    rectangles, pages = drawn(tmp_path, capsys, "--ids", "3,5-9", "--per-page", "6", "--dictionary", "DICT_5X5_100")
    assert len(pages) == 1
    assert len(rectangles) == 6
    assert_true_size(rectangles, pages)


def test_size_and_squares_are_what_was_asked_for(tmp_path, capsys):
    rectangles, pages = drawn(
        tmp_path, capsys, "--kind", "chessboard", "--size", "18.5mm", "--columns", "6", "--rows", "9"
    )
    assert rectangles[0].marking == ChessboardMarking(6, 9, 0.0185)
    assert_true_size(rectangles, pages)


def test_measured_ruler_scales_the_lines_and_not_the_drawing(tmp_path, capsys):
    plain, pages = drawn(tmp_path, capsys, "--size", "100mm")
    scaled, again = drawn(tmp_path, capsys, "--size", "100mm", "--measured", "148.5mm/150mm")
    assert scaled[0].width == pytest.approx(plain[0].width * 0.99, abs=1e-6)
    np.testing.assert_array_equal(pages[0], again[0])


def test_ruler_is_150_mm_long(tmp_path, capsys):
    _, pages = drawn(tmp_path, capsys)
    foot = pages[0][-round(40 / 25.4 * DPI) :]
    # The ruler's line is 0.15 mm thick, nearly a pixel here; nothing else in the foot is that wide.
    longest = max(np.ptp(np.flatnonzero(row < 200)) for row in foot if np.count_nonzero(row < 200) > 600)
    assert longest == pytest.approx(150 / 25.4 * DPI, abs=2)


def test_config_takes_the_rectangles_and_keeps_the_rest(tmp_path):
    path = tmp_path / "rig.toml"
    assert run(["target", "--ids", "0-1", "--size", "80mm", "--config", str(path)]) == 0
    path.write_text("# my room\n" + path.read_text())
    assert run(["target", "--kind", "charuco", "--dictionary", "4x4_50", "--config", str(path)]) == 0
    assert path.read_text().startswith("# my room\n")
    assert [r.name for r in read_config(path).rectangles] == ["tag0", "tag1", "board"]
    arguments = ["target", "--ids", "0-1", "--size", "80mm", "--measured", "15.2cm/150mm", "--config", str(path)]
    assert run(arguments) == 0
    config = read_config(path)
    assert [r.name for r in config.rectangles] == ["tag0", "tag1", "board"]
    assert config.rectangles[0].width == pytest.approx(0.08 * 152 / 150, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--paper", "A9"], "A4"),
        (["--ids", "3-1"], "0-3"),
        (["--ids", "1,1"], "twice"),
        (["--ids", "600"], "0 to 586"),
        (["--dictionary", "tag99"], "apriltag_36h11"),
        (["--size", "-3mm"], "80mm"),
        (["--size", "80"], "80mm or 80m"),
        (["--size", "400mm"], "do not fit"),
        (["--measured", "15/150mm"], "148.5mm/150mm|ruler"),
        (["--measured", "150"], "148.5mm/150mm"),
        (["--kind", "chessboard", "--dictionary", "4x4_50"], "charuco"),
        (["--kind", "charuco", "--columns", "40", "--rows", "40"], "tag"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_no_file(tmp_path, capsys, arguments, word):
    pdf = tmp_path / "sheet.pdf"
    assert run(["target", *arguments, "-o", str(pdf)]) == 1
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert any(part in said for part in word.split("|"))
    assert list(tmp_path.iterdir()) == []


def test_folder_that_is_not_there_is_said(tmp_path, capsys):
    assert run(["target", "-o", str(tmp_path / "no" / "sheet.pdf")]) == 1
    assert "no folder" in capsys.readouterr().err


def test_ids_rulers_and_papers_are_read():
    assert parse_ids("0-3") == [0, 1, 2, 3]
    assert parse_ids("1, 4,9-11") == [1, 4, 9, 10, 11]
    assert parse_measured("148.5mm/150mm") == pytest.approx(0.99)
    assert paper_named("a4", across=True).width == pytest.approx(297)
    for text in ("", "x", "1-", "-1"):
        with pytest.raises(QuadrigError):
            parse_ids(text)


def test_a_box_is_a_body_whose_lines_can_be_put_in_again(tmp_path, capsys):
    config = tmp_path / "rig.toml"
    assert run(["target", "--box", "--paper", "A3", "--config", str(config)]) == 0
    first = read_config(config).rectangles
    assert {(r.body, r.moving) for r in first} == {("box", True)}
    assert len(first) == 6
    assert run(["target", "--box", "--paper", "A3", "--measured", "149mm/150mm", "--config", str(config)]) == 0
    before, after = (r[1].body_from_rect for r in (first, read_config(config).rectangles))
    assert before is not None
    assert after is not None
    assert after.translation[0] == pytest.approx(before.translation[0] * 149 / 150, abs=1e-6)
    assert run(["target", "--box", "--ids", "3-5"]) == 1
    assert "a box has 6 faces" in capsys.readouterr().err


def test_the_tags_of_a_box_are_printed_at_their_size(tmp_path, capsys):
    rectangles, (page,) = drawn(tmp_path, capsys, "--box", "--ids", "6-11")
    sides = [np.ptp(view.pixels, axis=0) for view in detect_views(page, rectangles)]
    assert len(sides) == 6
    np.testing.assert_allclose(np.array(sides) / DPI * 0.0254, rectangles[0].width, atol=5e-5)
