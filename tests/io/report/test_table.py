"""The table of a rig on a terminal of 80 columns: nothing is cut off, and who has only a lens is shown as that."""

import io
from dataclasses import replace
from html import escape

import numpy as np
import pytest
from rich.console import Console

from quadrig.io.drawing.verdict_markdown import verdict_markdown
from quadrig.io.formats.any_file import read_any_lenses, read_any_rig
from quadrig.io.formats.rig_json import json_text, rig_values
from quadrig.io.report.page import report_html
from quadrig.io.report.table import print_rig
from quadrig.io.rig_file.rig_mcap import RigFile, read_rig, write_rig
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.words import with_sigma


@pytest.fixture
def lens_only_rig(example_rig):
    """The example without its last camera, and that camera apart."""
    *kept, lost = example_rig.cameras
    rows = slice(15 * len(kept), None)
    fits = [fit for fit in example_rig.fits if fit.view.camera == lost.name]
    alone = replace(
        example_rig,
        reference=lost.name,
        cameras=(lost,),
        covariance=example_rig.covariance[rows, rows],
        fits=tuple(fits),
        missing={},
    )
    return replace(
        example_rig,
        cameras=tuple(kept),
        covariance=example_rig.covariance[: 15 * len(kept), : 15 * len(kept)],
        fits=tuple(fit for fit in example_rig.fits if fit.view.camera != lost.name),
        missing={lost.name: f"{lost.name} shares no rectangle with the others"},
        apart=(alone,),
    )


def printed(rig, width=80):
    out = io.StringIO()
    print_rig(rig, Console(file=out, width=width, highlight=False))
    return out.getvalue()


def test_nothing_is_cut_off_at_80_columns(example_rig, lens_only_rig):
    for rig in (example_rig, lens_only_rig, lens_only_rig.apart[0]):
        text = printed(rig)
        assert "…" not in text
        for camera in rig.cameras:
            assert with_sigma(camera.intrinsics.focal, rig.focal_sigma(camera.name)) in text


def test_what_the_working_accuracy_holds_stands_beside_it(example_rig):
    # A scale of 0.1 % is 3 mm of 3 m, far beyond the 0.2 mm of a point: the headline alone would promise too much.
    rig = replace(example_rig, working_accuracy=2e-4, point_accuracy=3e-4, scale_sigma=1e-3)
    holds = verdict(rig).holds
    for words in ("0.20 mm", "0.30 mm", "0.1 %", "scale_sigma"):
        assert words in holds
    assert "scale_sigma" not in verdict(replace(rig, scale_sigma=1e-6)).holds
    assert verdict(replace(rig, scale_sigma=float("nan"))).holds == ""


def test_a_camera_that_has_only_a_lens_is_shown_as_that(lens_only_rig):
    text = printed(lens_only_rig)
    below = text[text.index("lens only") :]
    assert lens_only_rig.apart[0].cameras[0].name in below
    assert lens_only_rig.cameras[0].name not in below.split("what is weak")[0]


def test_one_camera_is_headed_by_its_lens(lens_only_rig):
    text = printed(lens_only_rig.apart[0])
    assert text.startswith("Good for directions to")
    assert "unknown" not in text
    assert "lens only" not in text


def test_the_report_and_json_have_it_too(lens_only_rig):
    name = lens_only_rig.apart[0].cameras[0].name
    page = report_html(RigFile(lens_only_rig))
    assert f"<h3>{name}</h3>" in page[page.index("<h2>Lens only</h2>") :]
    values = rig_values(lens_only_rig)
    assert name not in values["cameras"]
    assert "rig_from_camera" not in values["lens_only"][name]
    assert values["lens_only"][name]["sigma"]["focal_px"] == lens_only_rig.apart[0].focal_sigma(name)


def test_what_another_program_does_not_say_is_said_once_and_without_a_unit(example_rig):
    nothing = {"rms": float("nan"), "held_out_rms": float("nan")}
    cameras = tuple(replace(camera, **nothing) for camera in example_rig.cameras)
    bare = replace(example_rig, cameras=cameras, covariance=np.full_like(example_rig.covariance, np.nan), fits=())
    bare = replace(bare, rectangles=(), weak=(), working_accuracy=float("nan"), **nothing)
    page = report_html(RigFile(bare))
    for text in (printed(bare), page):
        assert "RMS not known" in text
        assert "unknown px" not in text
    assert "too little moved" not in page


def test_it_comes_back_from_its_file(lens_only_rig, tmp_path):
    write_rig(tmp_path / "rig.mcap", lens_only_rig)
    (back,) = read_rig(tmp_path / "rig.mcap").apart
    (alone,) = lens_only_rig.apart
    np.testing.assert_array_equal(back.covariance, alone.covariance)
    assert back.cameras[0].intrinsics.focal == alone.cameras[0].intrinsics.focal
    assert len(back.fits) == len(alone.fits) > 0


def test_it_comes_back_from_json_too(lens_only_rig, tmp_path):
    (tmp_path / "rig.json").write_text(json_text(rig_values(lens_only_rig)))
    name = lens_only_rig.apart[0].cameras[0].name
    ((back, camera),) = read_any_rig(tmp_path / "rig.json").lens_only
    assert camera.name == name
    assert back.focal_sigma(name) == pytest.approx(lens_only_rig.apart[0].focal_sigma(name))
    assert read_any_lenses(tmp_path / "rig.json").keys() == {c.name for c in lens_only_rig.cameras} | {name}


def test_terminal_report_and_viewer_say_one_list(example_rig, lens_only_rig):
    for rig in (example_rig, lens_only_rig):
        said = verdict(rig)
        page, words = report_html(RigFile(rig)), verdict_markdown(rig)
        for sentence in (said.headline, said.holds, *said.weak):
            assert sentence in printed(rig, width=1000)
            assert escape(sentence) in page
            assert sentence in words
