"""A session in a viewer."""

import time

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.state import SetupState
from quadrig.io.viewer.process import Viewer
from quadrig.io.viewer.setup.screen import RerunScreen


def test_a_viewer_that_is_closed_is_said_and_the_session_goes_on(capfd, room):
    viewer = Viewer(options=("--serve-grpc",))
    screen = RerunScreen(("cam0",), (room.TAG,), viewer)
    frame = Frame("cam0", 0, 0.0, picture=room.picture(0, room.held_poses()[0]))
    screen.show(SetupState("one", frameset=0, frames={"cam0": frame}))
    viewer.close()
    until = time.monotonic() + 10
    said = ""
    while "the viewer was closed" not in said and time.monotonic() < until:
        screen.show(SetupState("two", frameset=1, frames={"cam0": frame}))
        time.sleep(0.05)
        said += capfd.readouterr().err
    screen.close()
    assert said == "rig: the viewer was closed; the session goes on here\n"
