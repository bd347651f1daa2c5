"""The Rig as people see it: a few lines, and a table in a notebook."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from quadrig.rig import Camera, Rig
from quadrig.rig.result import camera_columns


class Table(HTMLParser):
    """The cells of a table, row by row, and every tag that occurs."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: set[str] = set()
        self._in_cell = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        assert not attrs
        if tag == "tr":
            self.rows.append([])
        self._in_cell = tag in ("td", "th")
        if self._in_cell:
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        self._in_cell &= tag not in ("td", "th")

    def handle_data(self, data):
        if self._in_cell:
            self.rows[-1][-1] += data


def renamed(rig: Rig, names: dict[str, str]) -> Rig:
    cameras = tuple(replace(camera, name=names.get(camera.name, camera.name)) for camera in rig.cameras)
    return replace(rig, cameras=cameras)


def test_a_rig_says_in_a_few_lines_what_it_is(board_rig):
    _, rig = board_rig
    lines = repr(rig).splitlines()
    assert len(lines) == 4
    assert max(map(len, lines)) < 120
    assert lines[0].startswith("Rig in the frame of cam0, working accuracy 0.")
    assert lines[1] == "  3 cameras: cam0, cam1, cam2"
    assert lines[2] == "  3 rectangles: sheet (moving, 12 framesets), tag0, tag1"
    used = sum(not fit.rejected for fit in rig.fits)
    assert lines[3] == f"  12 framesets, {used} of {len(rig.fits)} Views, RMS {rig.rms:.3f} px"


def test_hundreds_of_cameras_fit_on_a_screen(board_rig):
    _, rig = board_rig
    many = tuple(replace(rig.cameras[0], name=f"cam{index}") for index in range(300))
    found = repr(replace(rig, cameras=many, covariance=np.zeros((300 * 15,) * 2)))
    assert "300 cameras: cam0, cam1, cam2, cam3, cam4, cam5, cam6, cam7 and 292 more" in found
    assert len(found) < 500


def test_a_rig_without_views_says_so():
    lines = repr(Rig("cam0", (), (), np.zeros((0, 0)))).splitlines()
    assert lines[0] == "Rig in the frame of cam0, working accuracy unknown"
    assert "0 of 0 Views" in lines[3]


def test_a_notebook_shows_a_row_for_each_camera(board_rig):
    _, rig = board_rig
    table = Table(rig._repr_html_())
    assert table.rows[0] == [column.heading for column in camera_columns(rig)]
    assert table.rows[0][:5] == ["camera", "focal px", "position m", "position \u00b1 mm", "rotation \u00b1 deg"]
    assert [row[0] for row in table.rows[1:]] == ["cam0", "cam1", "cam2"]
    for row, camera in zip(table.rows[1:], rig.cameras, strict=True):
        focal, sigma = (float(part) for part in row[1].split(" \u00b1 "))
        assert abs(focal - camera.intrinsics.focal) <= 0.05 * rig.focal_sigma(camera.name) + 1e-6
        assert abs(sigma / rig.focal_sigma(camera.name) - 1) < 0.06
        if camera.name == rig.reference:
            assert row[2:5] == ["rig frame", "", ""]
            continue
        position, sigma = camera.rig_from_camera.translation, 1e3 * rig.position_sigma(camera.name)
        np.testing.assert_allclose([float(part) for part in row[2].split()], position, atol=6e-5)
        assert abs(float(row[3]) - sigma) <= 0.06 * sigma


def test_names_are_text_and_no_markup(board_rig):
    _, rig = board_rig
    table = Table(renamed(rig, {"cam1": "<script>x & y</script>"})._repr_html_())
    assert table.tags <= {"p", "b", "br", "table", "tr", "th", "td"}
    assert table.rows[2][0] == "<script>x & y</script>"
    assert isinstance(rig.cameras[0], Camera)
