"""The page of `rig pick` in a real browser: corners by mouse and by keys, snapped, undone, kept, predicted."""

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.config.corners_toml import PointedCorners, keep_corners, read_corners
from quadrig.io.rig_file.rig_mcap import read_rig

# The two sides of a thin line in the distance grow together and move outward: half such a line.
SNAPPED = 1.5


class Opened:
    """A page, and where things are on it."""

    def __init__(self, browser, url, court, size=(1280, 900), width=None, scheme="light"):
        self.page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
        self.errors: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda said: said.type == "error" and self.errors.append(said.text))
        self.court, self.width = court, width or court.WIDTH
        self.page.goto(url)
        self.page.wait_for_selector('body[data-loaded="3"]', timeout=30_000)

    def at(self, camera, pixel):
        """Where on the screen a pixel of an unzoomed picture is."""
        box = self.page.locator("#pictures canvas").nth(self.court.CAMERAS.index(camera)).bounding_box()
        size = box["width"] / self.width
        return box["x"] + (pixel[0] + 0.5) * size, box["y"] + (pixel[1] + 0.5) * size

    def click(self, camera, pixel):
        self.page.mouse.click(*self.at(camera, pixel))

    def until(self, expression, argument=None):
        """Until an expression is true: playwright's own wait needs eval, which the page's policy forbids."""
        for _ in range(600):
            if self.page.evaluate(expression, argument):
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"never true: {expression} {argument or ''}; said: {self.page.inner_text('#said')}")

    def said(self, text):
        self.until("text => document.querySelector('#said').textContent.includes(text)", text)

    def idle(self):
        """Until every change is kept and solved for."""
        self.page.wait_for_timeout(300)
        self.until("!moving && !waiting && pending === 0 && Number(document.body.dataset.solved) === asked")

    def press(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)


@pytest.fixture
def opened(browser, court, session, serving):
    """The page with nothing clicked; nothing went wrong in it when the test ends."""
    with serving(session) as served:
        opened = Opened(browser, served.url, court)
        yield opened
        opened.page.close()
        assert opened.errors == []


def kept(session):
    """Corners by camera and rectangle as corners.toml has them."""
    return {(one.camera, one.rectangle.name): one.pixels for one in read_corners(session.path, session.rectangles)}


def test_a_court_clicked_with_the_mouse_goes_to_a_rig(opened, session, court, tmp_path):
    rng = np.random.default_rng(3)
    for camera in court.CAMERAS:
        for pixel in court.corners(camera, court.COURT):
            opened.click(camera, pixel + 0.5 * rng.normal(size=2))
    opened.idle()
    assert "3 of 3 cameras placed" in opened.page.inner_text("#headline")
    for camera in court.CAMERAS:
        np.testing.assert_allclose(kept(session)[camera, "court"], court.corners(camera, court.COURT), atol=SNAPPED)
    # The other rectangle of the court appears where it is before anybody clicks it, in every picture.
    predicted = opened.page.evaluate("state.predicted")
    for camera in court.CAMERAS:
        off = np.array(predicted[camera]["service"]) - court.corners(camera, court.SERVICE)
        assert np.hypot(*off.T).max() < 6
    # Beside each corner stands by how much the rig misses it.
    offs = [opened.page.locator("#corners tr").nth(row).locator("td").nth(2).inner_text() for row in range(4)]
    assert all(0 <= float(off) < 3 for off in offs)
    arguments = ["calibrate", *(str(tmp_path / f"{camera}.png") for camera in court.CAMERAS)]
    assert run([*arguments, "--config", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "rig.mcap")]) == 0
    for camera in read_rig(tmp_path / "rig.mcap").cameras:
        off = camera.rig_from_camera.step_to(court.camera_from_court(camera.name).inverse())
        assert np.linalg.norm(off[3:]) < 1.0


def test_a_rectangle_in_one_picture_predicts_the_other_there(opened, court):
    for pixel in court.corners("left", court.COURT):
        opened.click("left", pixel)
    opened.idle()
    predicted = opened.page.evaluate("state.predicted.left.service")
    off = np.array(predicted) - court.corners("left", court.SERVICE)
    assert np.hypot(*off.T).max() < 6
    # Enter takes the predicted corner as it is shown, and snaps it; what does not come so near stays as predicted.
    opened.press("r", "Enter", "Enter", "Enter", "Enter")
    opened.idle()
    off = np.array(opened.page.evaluate("pixelsOf(0)")) - court.corners("left", court.SERVICE)
    assert np.hypot(*off.T).max() < 7


def test_a_snap_is_shown_and_undone_and_done_again(opened, session, court):
    pixel = court.corners("left", court.COURT)[1]
    opened.click("left", pixel + np.array([-2.5, 1.5]))
    opened.said("snapped by")
    before = kept(session)["left", "court"][0]
    assert np.hypot(*(before - pixel)) < 0.5
    opened.press("u")
    opened.said("taken back")
    raw = kept(session)["left", "court"][0]
    # A screen pixel of this picture is three of its own.
    assert 1 < np.hypot(*(raw - pixel)) < 5
    opened.press("Shift+U")
    opened.said("done again")
    np.testing.assert_array_equal(kept(session)["left", "court"][0], before)
    opened.press("u")
    opened.idle()
    opened.press("u")
    opened.idle()
    assert kept(session) == {}


def test_where_no_edges_cross_a_click_stays(opened, session):
    opened.click("left", (640, 60))
    opened.said("no crossing of edges within 5 px")
    np.testing.assert_allclose(kept(session)["left", "court"][0], [640, 60], atol=2)


def test_corners_by_keys_alone(opened, session):
    # The cross begins in the middle of the first picture: 639.5, 359.5.
    opened.press("ArrowRight", "Shift+ArrowDown", "Control+ArrowLeft", "Alt+ArrowUp", "Enter")
    opened.said("kept where you pointed")
    np.testing.assert_allclose(kept(session)["left", "court"][0], [540.5, 369.4], atol=0.01)
    # The next corner is active; Shift+Tab goes back, and an arrow moves the corner that is there.
    opened.press("Shift+Tab", "ArrowLeft", "ArrowLeft", "Shift+ArrowUp")
    opened.said("moved")
    np.testing.assert_allclose(kept(session)["left", "court"][0], [538.5, 359.4], atol=0.01)
    opened.press("Tab", "Tab", "Enter")
    opened.idle()
    assert np.isfinite(kept(session)["left", "court"]).all(axis=1).tolist() == [True, False, True, False]
    opened.press("Delete")
    opened.idle()
    opened.press("n", "Enter", "r", "Enter", "Shift+R", "p")
    opened.idle()
    assert set(kept(session)) == {("left", "court"), ("middle", "court"), ("middle", "service")}
    active = opened.page.evaluate("state.active")
    assert (active["camera"], active["rectangle"]) == (0, 0)


def test_a_corner_is_dragged_and_snaps_where_it_is_dropped(opened, session, court):
    pixel = court.corners("left", court.COURT)[1]
    opened.click("left", (640, 60))
    opened.idle()
    opened.page.mouse.move(*opened.at("left", (640, 60)))
    opened.page.mouse.down()
    opened.page.mouse.move(*opened.at("left", (620, 400)), steps=5)
    opened.page.mouse.move(*opened.at("left", pixel), steps=5)
    opened.page.mouse.up()
    opened.said("snapped")
    assert np.hypot(*(kept(session)["left", "court"][0] - pixel)) < 0.5
    assert opened.page.evaluate("pixelsOf(0).filter(Boolean).length") == 1


def test_the_wheel_zooms_where_the_mouse_is_and_a_drag_beside_corners_moves_the_picture(opened, session, court):
    pixel = court.corners("left", court.COURT)[1]
    opened.page.mouse.move(*opened.at("left", pixel))
    opened.page.mouse.wheel(0, -1200)
    opened.until("views[0].scale > 3")
    x, y = opened.at("left", pixel)
    opened.page.mouse.down()
    opened.page.mouse.move(x + 40, y - 30, steps=4)
    opened.page.mouse.up()
    assert kept(session) == {}
    opened.page.mouse.click(x + 40, y - 30)
    opened.said("bottom right of court in left")
    assert np.hypot(*(kept(session)["left", "court"][0] - pixel)) < 0.5
    opened.press("0")
    assert opened.page.evaluate("views[0].scale") < 1


def test_sigma_and_comments_are_kept(opened, session):
    opened.click("left", (640, 60))
    opened.idle()
    session.path.write_text("# by the net\n" + session.path.read_text())
    opened.page.fill("#sigma", "2.5")
    opened.page.press("#sigma", "Enter")
    opened.idle()
    (table,) = read_corners(session.path, session.rectangles)
    assert table.sigma == 2.5
    assert session.path.read_text().startswith("# by the net\n")


def test_corners_in_the_wrong_order_are_said(opened, court):
    for pixel in court.corners("left", court.COURT)[[0, 1, 3, 2]]:
        opened.click("left", pixel)
    opened.said("sides cross each other")


def test_what_was_clicked_before_is_there_again(browser, court, session, serving):
    keep_corners(session.path, PointedCorners("left", session.rectangles[0], court.corners("left", court.COURT)))
    with serving(session) as served:
        opened = Opened(browser, served.url, court)
        opened.idle()
        # On to the first picture that still lacks corners.
        assert opened.page.evaluate("state.active.camera") == 1
        assert "4/12" in opened.page.inner_text("#rectangles")
        opened.page.close()


def test_a_file_broken_meanwhile_is_one_sentence_on_the_page(browser, court, session, serving):
    with serving(session) as served:
        opened = Opened(browser, served.url, court)
        session.path.write_text("[[corners")
        opened.click("left", (640, 60))
        opened.page.wait_for_selector("#problem:not([hidden])")
        assert "corners.toml: this is not TOML" in opened.page.inner_text("#problem")
        assert session.path.read_text() == "[[corners"
        opened.page.close()


def test_a_moving_rectangle_is_clicked_at_each_instant(browser, court, tmp_path, serving, open_session):
    folders = []
    for path in court.write(tmp_path):
        folder = tmp_path / path.stem
        folder.mkdir()
        folders.append(folder)
        for number in range(3):
            (folder / f"{number}.png").write_bytes(path.read_bytes())
    text = court.CONFIG.replace('reference = "court"', "").split("[[rectangle]]")[1].split("world_from_rect")[0]
    (tmp_path / "rig.toml").write_text(f"[[rectangle]]{text}moving = true\n")
    session = open_session(tmp_path, folders)
    with serving(session) as served:
        opened = Opened(browser, served.url, court)
        assert opened.page.inner_text("#instant-text") == "1 of 3"
        opened.click("middle", (640, 60))
        opened.idle()
        opened.press(".", ".")
        opened.until("views.every((view) => view.shown === 2 && view.picture)")
        assert opened.page.inner_text("#instant-text") == "3 of 3"
        # What was clicked at another instant is not of this one.
        assert opened.page.evaluate("pixelsOf(1).some(Boolean)") is False
        opened.click("middle", (600, 80))
        opened.idle()
        opened.press(",")
        opened.until("state.frameset === 1")
        tables = read_corners(session.path, session.rectangles)
        assert [(one.camera, one.image) for one in tables] == [("middle", 0), ("middle", 2)]
        opened.page.close()
        assert opened.errors == []


@pytest.mark.parametrize("size", [(1280, 900), (2560, 1440)])
def test_pictures_of_twelve_megapixels_fit_whatever_the_window(browser, court, tmp_path, serving, open_session, size):
    pictures, large = court.write(tmp_path), np.array([4000, 3000])
    for path in pictures:
        cv2.imwrite(str(path), cv2.resize(court.picture(path.stem), (4000, 3000), interpolation=cv2.INTER_CUBIC))
    session = open_session(tmp_path, pictures)
    with serving(session) as served:
        opened = Opened(browser, served.url, court, size=size, width=4000, scheme="dark")
        pixel = (court.corners("right", court.COURT)[0] + 0.5) * large / [court.WIDTH, court.HEIGHT] - 0.5
        opened.click("right", pixel)
        opened.idle()
        # A screen pixel is up to nine of the picture; zoomed in by the wheel it is less than one.
        assert np.hypot(*(kept(session)["right", "court"][0] - pixel)) < 15
        opened.press("Shift+Tab")
        opened.page.mouse.move(*opened.at("right", pixel))
        opened.page.mouse.wheel(0, -1600)
        opened.until("views[2].scale > 1.5")
        opened.page.mouse.click(*opened.at("right", pixel))
        opened.idle()
        assert opened.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        opened.page.close()
