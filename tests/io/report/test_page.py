"""The report: one page, no network, opened in a browser; its plots hold what the Rig holds."""

import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from html import escape
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.drawing.palette import camera_colours
from quadrig.io.drawing.svg import LETTER, Plot, round_values
from quadrig.io.report.page import report_html
from quadrig.io.rig_file.rig_mcap import RigFile, write_rig
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.result import Rig
from quadrig.single.lens import DISTORTION_NAMES


@pytest.fixture(scope="module")
def page(example_rig, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write_rig(folder / "rig.mcap", example_rig)
    assert run(["report", str(folder / "rig.mcap"), "-o", str(folder / "report.html")]) == 0
    return folder / "report.html"


def test_the_page_is_small_and_needs_no_network(page):
    text = page.read_text()
    assert page.stat().st_size < 3_000_000
    assert not re.search(r"(src|href)\s*=|url\(|@import|<script|https?:", text)


def test_the_verdict_is_at_the_top(page, example_rig):
    text = page.read_text()
    judged = verdict(example_rig)
    assert text.index(judged.headline) < text.index("<table")
    for name in ("cam0", "cam1", "cam2", "cam3"):
        assert f"<h3>{name}</h3>" in text


def test_every_plot_is_sound_and_named(page):
    plots = re.findall(r"<svg.*?</svg>", page.read_text(), re.S)
    assert len(plots) == 5 + 2 * 4
    for text in plots:
        root = ElementTree.fromstring(text)
        assert root.get("aria-label")
        assert "nan" not in text


def test_it_says_where_it_comes_from(example_rig, example_config):
    noon = 1_764_504_000 * 10**9
    held = RigFile(example_rig, example_config, (noon, noon + 10**10), "0.1.0", ("room.mcap", "hall.mcap"))
    text = report_html(held, "monday.mcap")
    for words in ("monday.mcap", "room.mcap, hall.mcap", "2025-11-30 12:00:00 to 12:00:10 UTC", "quadrig 0.1.0"):
        assert words in text
    assert escape(example_config.strip()) in text
    counted = report_html(replace(held, times=(0, 10**9)))
    assert "UTC" not in counted


def test_every_lens_term_has_its_name_and_sigma(example_rig):
    text = report_html(RigFile(example_rig))
    for camera in example_rig.cameras:
        section = text[text.index(f"<h3>{camera.name}</h3>") :].partition("</section>")[0]
        sigmas = np.sqrt(np.diag(example_rig.lens_covariance(camera.name)))
        for name, value, sigma in zip(
            DISTORTION_NAMES["pinhole"], camera.intrinsics.distortion, sigmas[3:], strict=False
        ):
            row = re.search(rf">{name}</td><td[^>]*>([^<]*)</td><td[^>]*>([^<]*)<", section)
            assert row, name
            assert float(row[1]) == pytest.approx(value, abs=0.06 * sigma + 1e-6)


def test_names_are_not_markup(example_rig):
    odd = replace(example_rig.cameras[0], name="<b>&cam")
    rig = replace(example_rig, cameras=(odd, *example_rig.cameras[1:]), reference="<b>&cam", fits=())
    assert "<b>" not in report_html(RigFile(rig))


def test_a_rig_of_which_little_is_known_has_a_report_too(example_rig):
    lone = example_rig.cameras[0]
    rig = Rig("cam0", (lone,), (), np.zeros((15, 15)))
    text = report_html(RigFile(rig))
    assert "Not to be used yet" in text


def test_a_browser_draws_it(page, tmp_path):
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("there is no Chromium here to open the report in")
    shot, base = tmp_path / "shot.png", [browser, "--headless", "--no-sandbox", "--disable-gpu"]
    base += [f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=2000"]
    options = [*base, "--window-size=1100,1400", f"--screenshot={shot}", page.as_uri()]
    subprocess.run(options, check=True, capture_output=True, timeout=120)
    picture = cv2.imread(str(shot))
    assert picture is not None
    # The first two cameras are drawn in their colours; the page is not blank.
    for colour in camera_colours(["cam0", "cam1"]).values():
        assert (np.abs(picture.astype(int) - colour[::-1]).max(axis=-1) < 12).sum() > 50
    dom = subprocess.run([*base, "--dump-dom", page.as_uri()], check=True, capture_output=True, timeout=120)
    assert dom.stdout.decode().count("<svg") == 13


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-3.2, 7.9), (0, 0.00031), (1e5, 1.0001e5), (-1, 1e6)])
def test_ticks_are_round_and_inside(low, high):
    values = round_values(low, high)
    assert 2 <= len(values) <= 8
    assert all(low - 1e-9 * abs(high) <= value <= high * (1 + 1e-9) for value in values)
    np.testing.assert_allclose(np.diff(values), np.diff(values)[0], rtol=1e-6)


def test_points_land_where_their_coordinates_say():
    plot = Plot((0, 10), (0, 5), 200, 100)
    low, high = plot.to_picture(np.array([[0, 0], [10, 5]]))
    assert low[0] < high[0]
    assert low[1] > high[1]
    down = Plot((0, 10), (0, 5), 200, 100, down=True)
    assert down.to_picture(np.array([0, 0]))[1] < down.to_picture(np.array([0, 5]))[1]
    equal = Plot((0, 10), (0, 1), 300, 300, equal=True)
    right, up = equal.to_picture(np.array([[1, 0], [0, 1]])) - equal.to_picture(np.array([0, 0]))
    assert abs(right[0]) == pytest.approx(abs(up[1]), rel=0.05)


def words_of(svg: str) -> dict[str, tuple[float, float]]:
    return {
        str(one.text): (float(one.attrib["x"]), float(one.attrib["y"]))
        for one in ElementTree.fromstring(svg).iter("text")
        if one.get("class") == "name"
    }


def test_words_lie_neither_on_one_another_nor_on_what_is_drawn():
    plot = Plot((0, 1), (0, 1))
    plot.line(np.array([[0.3, 0.4], [0.7, 0.4], [0.7, 0.6], [0.3, 0.6]]), "red", closed=True)
    plot.line(np.array([[0.3, 0.55], [0.7, 0.55]]), "red")
    for name in ("left", "right", "middle"):
        plot.text((0.5, 0.5), name)
    places = words_of(plot.svg("words"))
    for name, (x, y) in places.items():
        half = LETTER * len(name) / 2
        for other, (x2, y2) in places.items():
            beside = abs(x - x2) >= half + LETTER * len(other) / 2 - 1
            assert other == name or beside or abs(y - y2) > 10
        drawn = np.concatenate(plot.marks)
        assert not ((np.abs(drawn[:, 0] - x) < half) & (drawn[:, 1] < y + 1) & (drawn[:, 1] > y - 10)).any()


def part(text: str, heading: str) -> str:
    found = re.search(f"<h2>{heading}</h2>.*?<h2>", text, re.S)
    assert found is not None
    return found[0]


def test_a_room_has_a_map_with_the_path_of_the_rig(carried_rig):
    text = report_html(RigFile(carried_rig))
    section = part(text, "Body hall")
    plan, side = (ElementTree.fromstring(plot) for plot in re.findall(r"<svg.*?</svg>", section, re.S))
    assert (plan.get("aria-label"), side.get("aria-label")) == ("the room from above", "the room from one side")
    assert {"north", "east", "south", "west"} <= set(plan.itertext())
    assert "past which the rig was carried in 12 framesets, within 2.00 m" in section
    # What hangs in the room is no part of the rig: in its own plots the cameras alone are drawn.
    assert "north" not in part(text, "The rig")
    assert "cam3" in part(text, "The rig")
