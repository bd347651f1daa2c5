"""Cameras, rectangles, topics and files by names that nobody expects: safe in every file, and readable again."""

import json
import os
import re
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from xml.etree import ElementTree

import cv2
import msgspec
import numpy as np
import pytest
import yaml

from quadrig.io.commands.main import run
from quadrig.io.config.rig_toml import parse_config
from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.formats.maps import ideal_rig
from quadrig.io.formats.registry import FORMATS
from quadrig.io.rig_file.rig_mcap import read_rig, write_rig
from quadrig.io.topic_writer import TopicWriter
from quadrig.single.errors import QuadrigError

NAMES = (
    "a/b/../../../up", "..", "x\ny\r\nrig: all is well", "nul\0 \x1b[31mred\x9b1m \x07", "x" * 10_000, "-rf",
    "名前 \u202ecba",
    "quo\"te's <b>&amp;</b> ]]> --> {x} %s $(touch x) `x` \\", "C:\\a|?*:", "/tf", " ", "",
)  # fmt: skip
UNSAFE = re.compile("[\0-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


@pytest.fixture(scope="module")
def hostile(example_rig, tmp_path_factory):
    """Three rig.mcap of four such cameras and three such rectangles each."""
    folder, files = tmp_path_factory.mktemp("hostile"), []
    for first in range(0, len(NAMES), 4):
        cameras = dict(zip((c.name for c in example_rig.cameras), NAMES[first : first + 4], strict=True))
        sheets = dict(zip((r.name for r in example_rig.rectangles), NAMES[first - 3 :], strict=False))
        rig = replace(
            example_rig,
            reference=NAMES[first],
            cameras=tuple(replace(one, name=cameras[one.name]) for one in example_rig.cameras),
            rectangles=tuple(
                replace(one, rectangle=replace(one.rectangle, name=sheets[one.name]))
                for one in example_rig.rectangles
            ),
            fits=tuple(
                replace(f, view=replace(f.view, camera=cameras[f.view.camera], rectangle=sheets[f.view.rectangle]))
                for f in example_rig.fits
            ),
        )
        files.append(folder / f"{first}.rig.mcap")
        write_rig(files[-1], ideal_rig(rig))
    return files


def assert_plain(capfd):
    out, err = capfd.readouterr()
    assert not UNSAFE.search(out + err)
    assert "unexpected error" not in err
    assert not any(line.startswith("rig: all is well") for line in (out + err).splitlines())


def test_names_come_back_from_a_rig_file(hostile):
    assert [camera.name for file in hostile for camera in read_rig(file).cameras] == list(NAMES)


@pytest.mark.parametrize("name", [n for n, form in FORMATS.items() if form.write and n not in ("maps", "ffmpeg")])
def test_every_export_stays_in_its_folder_and_is_well_formed(name, hostile, tmp_path, capfd):
    for file in hostile:
        place = tmp_path / file.stem
        place.mkdir()
        assert run(["export", str(file), "--format", name, "-o", str(place)]) == 0
        written = [path for path in tmp_path.rglob("*") if path.is_file()]
        assert all(path.parent == place or path.parent.parent == place for path in place.rglob("*") if path.is_file())
        for path in (path for path in written if place in path.parents):
            assert len(path.name) < 256
            data = path.read_bytes()
            if path.suffix in (".xml", ".urdf"):
                ElementTree.fromstring(data)
            elif path.suffix == ".json":
                json.loads(data)
            elif path.suffix in (".yaml", ".yml") and name != "opencv":
                yaml.safe_load(data)
            if path.suffix not in (".bin", ".tiff", ".pgm", ".usda"):
                assert not UNSAFE.search(data.decode())
        if FORMATS[name].read and name not in ("ros", "urdf", "tf"):
            target = place if len(list(place.iterdir())) > 1 else next(place.iterdir())
            assert len(read_any_rig(target, unit=1.0).cameras) == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(file.stem for file in hostile)
    assert_plain(capfd)


@pytest.mark.parametrize(
    "words", [["info", "{}"], ["info", "{}", "--json"], ["compare", "{}", "{}"], ["export", "{}"]]
)
def test_what_is_printed_is_plain(words, hostile, capfd):
    for file in hostile:
        assert run([word.format(file) for word in words]) == 0
        out = capfd.readouterr().out
        assert not UNSAFE.search(out)
        if words[-1] != "{}" or words[0] == "export":
            assert json.loads(out)


def test_a_page_shows_names_as_text(hostile, tmp_path, capfd):
    for file in hostile:
        assert run(["report", str(file), "-o", str(tmp_path / "page.html")]) == 0
        page = (tmp_path / "page.html").read_text(encoding="utf-8")
        assert not UNSAFE.search(page)
        assert "<b>&amp;" not in page
        assert "--> {x}" not in page
    assert_plain(capfd)


def test_topics_and_files_by_such_names_become_cameras_that_can_be_read(tmp_path, pictures, capfd):
    path = tmp_path / "a.mcap"
    data = cv2.imencode(".png", pictures.picture(3))[1].tobytes()
    with path.open("wb") as stream:
        writer = TopicWriter(stream)
        for number, name in enumerate(NAMES):
            writer.declare_json(f"/{number}{name}/image", "foxglove.CompressedImage")
            image = {"timestamp": {"sec": 1, "nsec": 0}, "format": "png", "data": data}
            writer.write_json(f"/{number}{name}/image", msgspec.json.encode(image), 10**9)
        writer.finish()
    folder = tmp_path / os.fsdecode(b"cam\xff\x1b[31m")
    folder.mkdir()
    (folder / "1.png").write_bytes(data)
    shown = StringIO()
    with redirect_stdout(shown):
        assert run(["info", str(path), "--json"]) == 0
    names = list(json.loads(shown.getvalue())["cameras"])
    assert len(names) == len(NAMES)
    assert max(map(len, names)) <= 200
    with redirect_stdout(shown):
        assert run(["info", str(folder)]) == 0
    assert "cam\\udcff\\u001b[31m" in shown.getvalue()
    assert run(["record", str(folder), "-o", str(tmp_path / "room.mcap")]) == 0
    assert_plain(capfd)


def test_a_name_in_rig_toml_that_cannot_be_read_is_refused():
    text = '[[rectangle]]\nname = "{}"\nwidth = 0.1\nheight = 0.1\n'
    marking = 'marking = { kind = "points" }\n'
    for name in ("a\\u001b[31m", "a\\nb", "x" * 10_000):
        with pytest.raises(QuadrigError, match=r"line 2: a rectangle is called .* give it a name that can be read"):
            parse_config(text.format(name) + marking)
    assert parse_config(text.format("the left one/名前 <b>") + marking).rectangles[0].name == "the left one/名前 <b>"


@pytest.mark.parametrize(("form", "most"), [("foxglove", 0), ("ros2", 2**31)])
def test_times_before_zero_and_after_2038_are_recorded_or_refused(tmp_path, pictures, form, most):
    folder = tmp_path / "cam0"
    folder.mkdir()
    for k in range(2):
        cv2.imwrite(str(folder / f"{k}.png"), np.asarray(pictures.picture(k)))
    (tmp_path / "times.csv").write_text(f"frame,time_s\n0,{most - 1}\n1,{most + 1}\n")
    words = ["record", str(folder), "-o", str(tmp_path / "a.mcap"), "--timestamps", str(tmp_path / "times.csv")]
    assert run([*words, "--format", form]) == (1 if most else 0)
    assert (tmp_path / "a.mcap").exists() == (not most)
