"""A live session in rerun: the pictures with what was found, the cameras in space, the graph, one large sentence."""

import os
import queue
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from quadrig.io.drawing.geometry import RING, ellipsoid, extent, outlines
from quadrig.io.drawing.palette import camera_colours
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.state import SetupState
from quadrig.io.viewer.banner import banner
from quadrig.io.viewer.process import Viewer
from quadrig.rig.result import Camera, Rig
from quadrig.rig.words import length
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

_GHOST, _SHEET = (90, 220, 120), (200, 190, 150)
_SAID, _FAULT, _DONE = (235, 235, 235), (255, 180, 60), _GHOST
# Ellipsoids of one sigma are drawn so many times as large, at most as this part of the rig's extent: millimetres
# in a room are seen, and seen to shrink.
_MAGNIFIED, _LARGEST = 50.0, 0.1
# What is shown is about this wide (px): four of them fill a screen, and a viewer decodes them in no time.
_PICTURE_WIDTH = 640
# Seconds from moment to moment in a viewer at least, and that it may take to accept one.
_SHORTEST, _SLOWEST = 1 / 15, 2.0


class RerunScreen:
    """Logs a session to a rerun viewer, or to a file.

    Exactly one of `viewer` and `file` (.rrd) is given. A viewer that is slower than the session misses moments and
    holds nobody up; one whose window was closed is said on stderr, and the session goes on without it.
    """

    def __init__(
        self,
        cameras: Sequence[str],
        rectangles: Sequence[Rectangle],
        viewer: "Viewer | None" = None,
        file: Path | None = None,
    ) -> None:
        # A viewer that was closed is said by ourselves, once.
        os.environ.setdefault("RUST_LOG", "off")
        import rerun as rr

        self._rr: Any = rr
        self._cameras, self._rectangles = tuple(cameras), {r.name: r for r in rectangles}
        self._colours = camera_colours(cameras)
        self._shrinks: dict[str, int] = {}
        self._recording = rr.RecordingStream("quadrig setup")
        self._sentence, self._rig, self._advice, self._kept = "", None, None, -1
        self._viewer, self._waiting = viewer, queue.Queue[SetupState | None](1)
        blueprint = layout(cameras)
        if viewer is None:
            self._recording.save(str(file), default_blueprint=blueprint)
        else:
            self._recording.connect_grpc(viewer.address, default_blueprint=blueprint)
            self._recording.send_blueprint(blueprint)
        self._recording.log("/", rr.ViewCoordinates.RDF, static=True)
        self._thread = threading.Thread(target=self._log_newest, name="viewer", daemon=True)
        self._thread.start()

    def show(self, state: SetupState) -> None:
        """Log what has changed: in a file at once, in a viewer when it has taken what came before."""
        if self._viewer is None:
            self.log(state)
        else:
            self._hand_over(state)

    def _hand_over(self, state: SetupState | None) -> None:
        with suppress(queue.Empty):
            self._waiting.get_nowait()
        self._waiting.put(state)

    def _log_newest(self) -> None:
        while (state := self._waiting.get()) is not None:
            began = time.monotonic()
            self.log(state)
            # Without this a slow viewer would fall behind by all that waits for it.
            with suppress(RuntimeError):
                self._recording.flush(timeout_sec=_SLOWEST)
            if self._viewer is not None and not self._viewer.open:
                print("rig: the viewer was closed; the session goes on here", file=sys.stderr, flush=True)
                return
            time.sleep(max(0.0, began + _SHORTEST - time.monotonic()))

    def log(self, state: SetupState) -> None:
        """Log what has changed since the state before."""
        if state.frameset >= 0:
            self._recording.set_time("frameset", sequence=state.frameset)
            for frame in state.frames.values():
                self._log_frame(frame)
            for camera in state.frames:
                self._log_found(camera, [view for view in state.views if view.camera == camera])
        if state.sentence + state.note != self._sentence:
            self._sentence = state.sentence + state.note
            self._log_sentence(state)
        if state.rig is not None and state.rig is not self._rig:
            self._rig = state.rig
            self._log_rig(state.rig)
        if state.advice is not self._advice:
            self._advice = state.advice
            self._log_ghost(state)
        if state.kept != self._kept:
            self._kept = state.kept
            self._log_graph(state)

    def close(self) -> None:
        """Send what waits."""
        self._hand_over(None)
        self._thread.join(_SLOWEST)
        # A viewer that was closed takes nothing any more.
        with suppress(RuntimeError):
            self._recording.flush(timeout_sec=_SLOWEST)
        self._recording.disconnect()

    def _log_frame(self, frame: Frame) -> None:
        try:
            self._shrinks[frame.camera] = shrink = max(1, round(frame.grey.shape[1] / _PICTURE_WIDTH))
        except QuadrigError:
            # A damaged picture is one picture that is not shown.
            return
        image = self._rr.EncodedImage(contents=frame.preview(shrink), media_type="image/jpeg")
        self._recording.log(f"cameras/{frame.camera}/image", image)

    def _shown(self, camera: str, pixels: Floats) -> Floats:
        """Where pixels of the camera's picture are in the smaller one that is shown."""
        return (pixels + 0.5) / self._shrinks.get(camera, 1) - 0.5

    def _log_found(self, camera: str, views: Sequence[View]) -> None:
        rr, path = self._rr, f"cameras/{camera}/image/found"
        if not views:
            self._recording.log(path, rr.Clear(recursive=False))
            return
        lines = [_hull(self._shown(camera, view.pixels)) for view in views]
        self._recording.log(
            path,
            rr.LineStrips2D(
                lines,
                colors=[self._colours[camera]] * len(lines),
                radii=rr.Radius.ui_points(2.5),
                labels=[view.rectangle for view in views],
            ),
        )

    def _log_sentence(self, state: SetupState) -> None:
        done = state.advice is not None and state.advice.kind == "done"
        picture = banner(state.sentence, state.note, _FAULT if state.fault else _DONE if done else _SAID)
        self._recording.log("sentence", self._rr.EncodedImage(contents=picture, media_type="image/png"))

    def _log_rig(self, rig: Rig) -> None:
        rr = self._rr
        for camera in rig.cameras:
            path, colour = f"cameras/{camera.name}", self._colours[camera.name]
            pose, lens = camera.rig_from_camera, camera.intrinsics
            shrink = self._shrinks.get(camera.name, 1)
            self._recording.log(path, rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation))
            self._recording.log(
                f"{path}/image",
                rr.Pinhole(
                    focal_length=[lens.camera_matrix[0, 0] / shrink, lens.camera_matrix[1, 1] / shrink],
                    principal_point=self._shown(camera.name, lens.principal_point),
                    resolution=[-(-lens.width // shrink), -(-lens.height // shrink)],
                    camera_xyz=rr.ViewCoordinates.RDF,
                    image_plane_distance=0.08 * extent(rig),
                    color=colour,
                    line_width=rr.Radius.ui_points(2.0),
                ),
            )
            self._log_doubt(rig, camera)
        names = rr.Points3D(
            [camera.rig_from_camera.translation for camera in rig.cameras],
            colors=[self._colours[camera.name] for camera in rig.cameras],
            labels=[_label(rig, camera.name) for camera in rig.cameras],
            radii=rr.Radius.ui_points(2.0),
            show_labels=True,
        )
        self._recording.log("names", names)
        placed = [outlines(p) for p in rig.rectangles]
        rings = np.concatenate(placed) if placed else np.zeros((0, 5, 3))
        self._recording.log("sheets", rr.LineStrips3D(list(rings), colors=_SHEET, radii=rr.Radius.ui_points(1.0)))

    def _log_doubt(self, rig: Rig, camera: Camera) -> None:
        rr = self._rr
        sigmas, axes = ellipsoid(rig.pose_covariance(camera.name)[3:, 3:])
        if not sigmas.max() > 0:
            return
        factor = min(_MAGNIFIED, _LARGEST * extent(rig) / sigmas.max())
        drawn = rr.Ellipsoids3D(
            # A sigma far below the others' would be drawn as a sheet of no thickness, which flickers.
            half_sizes=[factor * np.maximum(sigmas, 0.03 * sigmas.max())],
            centers=[camera.rig_from_camera.translation],
            quaternions=[rr.Quaternion(xyzw=Pose(axes, np.zeros(3)).quaternion())],
            colors=[self._colours[camera.name]],
            fill_mode="majorwireframe",
        )
        self._recording.log(f"doubt/{camera.name}", drawn)

    def _log_ghost(self, state: SetupState) -> None:
        rr, advice = self._rr, state.advice
        if advice is None or advice.ghost is None or advice.rectangle not in self._rectangles:
            self._recording.log("ghost", rr.Clear(recursive=True))
            for camera in self._cameras:
                self._recording.log(f"cameras/{camera}/image/ghost", rr.Clear(recursive=False))
            return
        corners = advice.ghost.transform(self._rectangles[advice.rectangle].corners)
        self._recording.log(
            "ghost",
            rr.Mesh3D(
                vertex_positions=corners,
                triangle_indices=[[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]],
                albedo_factor=[*_GHOST, 110],
            ),
        )
        self._recording.log(
            "ghost/outline",
            rr.LineStrips3D(
                [corners[RING]], colors=[_GHOST], radii=rr.Radius.ui_points(3.0), labels=["hold it here"]
            ),
        )
        self._log_ghost_in_pictures(state, corners)

    def _log_ghost_in_pictures(self, state: SetupState, corners: Floats) -> None:
        rr = self._rr
        placed = {camera.name: camera for camera in state.rig.cameras} if state.rig else {}
        for name in self._cameras:
            path = f"cameras/{name}/image/ghost"
            pixels = np.full((4, 2), np.nan)
            if name in placed:
                in_camera = placed[name].rig_from_camera.inverse().transform(corners)
                pixels = placed[name].intrinsics.project(in_camera)
            if np.isfinite(pixels).all():
                # Without a label: it would lie on the sheet's own whenever the sheet is nearly there.
                line = rr.LineStrips2D(
                    [self._shown(name, pixels[RING])], colors=[_GHOST], radii=rr.Radius.ui_points(3.0)
                )
                self._recording.log(path, line)
            else:
                self._recording.log(path, rr.Clear(recursive=False))

    def _log_graph(self, state: SetupState) -> None:
        """Cameras as nodes; an edge where two saw a sheet at once, or one that stands still."""
        rr, counts = self._rr, shared_counts(state.kept_views, self._rectangles)
        self._recording.log(
            "graph",
            rr.GraphNodes(
                node_ids=list(self._cameras),
                labels=list(self._cameras),
                colors=[self._colours[camera] for camera in self._cameras],
                radii=[14.0] * len(self._cameras),
            ),
            rr.GraphEdges(edges=list(counts), graph_type="undirected"),
        )


def shared_counts(views: Sequence[View], rectangles: dict[str, Rectangle]) -> dict[tuple[str, str], int]:
    """How many placed sheets each pair of cameras (in the order of names) has in common."""
    seen: dict[tuple[str, int], set[str]] = {}
    for view in views:
        moving = view.rectangle in rectangles and rectangles[view.rectangle].moving
        seen.setdefault((view.rectangle, view.frameset if moving else -1), set()).add(view.camera)
    counts: dict[tuple[str, str], int] = {}
    for cameras in seen.values():
        names = sorted(cameras)
        for k, first in enumerate(names):
            for second in names[k + 1 :]:
                counts[first, second] = counts.get((first, second), 0) + 1
    return counts


def layout(cameras: Sequence[str]) -> Any:
    """The blueprint: the sentence across the top, the pictures beside the rig in space, the graph below it."""
    import rerun.blueprint as rrb

    pictures = [rrb.Spatial2DView(origin=f"cameras/{name}/image", name=name) for name in cameras]
    space = rrb.Spatial3DView(
        origin="/",
        name=f"rig (doubts {_MAGNIFIED:.0f} times as large)",
        contents=["+ $origin/**", "- $origin/cameras/*/image/ghost", "- $origin/sentence"],
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial2DView(origin="sentence", name="do this", background=[13, 13, 13]),
            rrb.Horizontal(
                rrb.Grid(*pictures, grid_columns=1 if len(cameras) < 2 else 2),
                rrb.Vertical(space, rrb.GraphView(origin="graph", name="who shares sheets"), row_shares=[3, 1]),
                column_shares=[3, 2],
            ),
            row_shares=[1, 6],
        ),
        collapse_panels=True,
    )


def _hull(pixels: Floats) -> Floats:
    """The outline of points: the points themselves where they are four corners, else their hull."""
    import cv2

    if len(pixels) == 4:
        return pixels[RING]
    hull = np.asarray(cv2.convexHull(pixels.astype(np.float32))[:, 0], float)
    return np.concatenate([hull, hull[:1]])


def _label(rig: Rig, name: str) -> str:
    """A camera's name and how sure its place is; the reference's is so by definition."""
    sigma = rig.position_sigma(name)
    return f"{name} ± {length(sigma)}" if sigma > 0 else name
