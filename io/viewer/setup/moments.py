"""The moments of a live session in rerun: the pictures with what was found, one large sentence, the graph."""

from collections.abc import Sequence

import cv2
import numpy as np
import rerun as rr

from quadrig.io.drawing.geometry import RING
from quadrig.io.drawing.palette import DONE, SAID, WARNING, camera_colours
from quadrig.io.drawing.rig_figures import shared_counts
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.state import SetupState
from quadrig.io.viewer.setup.banner import banner
from quadrig.io.viewer.setup.space import Pictures, log_ghost, log_rig
from quadrig.rig.coach.advice import Advice
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


class MomentLog:
    """Logs of each moment what has changed since the one before."""

    def __init__(
        self, recording: rr.RecordingStream, cameras: Sequence[str], rectangles: Sequence[Rectangle]
    ) -> None:
        self._recording, self._cameras = recording, tuple(cameras)
        self._rectangles = {rectangle.name: rectangle for rectangle in rectangles}
        self._pictures = Pictures(camera_colours(cameras))
        self._sentence, self._kept = "", -1
        self._rig: Rig | None = None
        self._advice: Advice | None = None
        recording.log("/", rr.ViewCoordinates.RDF, static=True)

    def log(self, state: SetupState) -> None:
        """Log one moment."""
        if state.frameset >= 0:
            self._recording.set_time("frameset", sequence=state.frameset)
            for camera, frame in state.frames.items():
                self._log_frame(frame)
                self._log_found(camera, [view for view in state.views if view.camera == camera])
        if state.sentence + state.note != self._sentence:
            self._sentence = state.sentence + state.note
            self._log_sentence(state)
        if state.rig is not None and state.rig is not self._rig:
            self._rig = state.rig
            log_rig(self._recording, state.rig, self._pictures)
        if state.advice is not self._advice:
            self._advice = state.advice
            log_ghost(self._recording, state.advice, self._rectangles, state.rig, self._pictures)
        if state.kept != self._kept:
            self._kept = state.kept
            self._log_graph(state.kept_views)

    def _log_frame(self, frame: Frame) -> None:
        try:
            shrink = self._pictures.shrink_to_fit(frame.camera, frame.grey.shape[1])
        except QuadrigError:
            # A damaged picture is one picture that is not shown.
            return
        image = rr.EncodedImage(contents=frame.preview(shrink), media_type="image/jpeg")
        self._recording.log(f"cameras/{frame.camera}/image", image)

    def _log_found(self, camera: str, views: Sequence[View]) -> None:
        path = f"cameras/{camera}/image/found"
        if not views:
            self._recording.log(path, rr.Clear(recursive=False))
            return
        lines = [_hull(self._pictures.shown(camera, view.pixels)) for view in views]
        self._recording.log(
            path,
            rr.LineStrips2D(
                lines,
                colors=[self._pictures.colours[camera]] * len(lines),
                radii=rr.Radius.ui_points(2.5),
                labels=[view.rectangle for view in views],
            ),
        )

    def _log_sentence(self, state: SetupState) -> None:
        done = state.advice is not None and state.advice.kind == "done"
        picture = banner(state.sentence, state.note, WARNING if state.fault else DONE if done else SAID)
        self._recording.log("sentence", rr.EncodedImage(contents=picture, media_type="image/png"))

    def _log_graph(self, views: Sequence[View]) -> None:
        """Cameras as nodes; an edge where two saw a sheet at once, or one that stands still."""
        counts = shared_counts(views, self._rectangles)
        self._recording.log(
            "graph",
            rr.GraphNodes(
                node_ids=list(self._cameras),
                labels=list(self._cameras),
                colors=[self._pictures.colours[camera] for camera in self._cameras],
                radii=[14.0] * len(self._cameras),
            ),
            rr.GraphEdges(edges=list(counts), graph_type="undirected"),
        )


def _hull(pixels: Floats) -> Floats:
    """The outline of points (P, 2): the points themselves where they are four corners, else their hull."""
    if len(pixels) == 4:
        return pixels[RING]
    hull = np.asarray(cv2.convexHull(pixels.astype(np.float32))[:, 0], float)
    return np.concatenate([hull, hull[:1]])
