"""What the corners clicked so far say: lenses and poses, and so where every corner should appear."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.calibration import calibrate_views
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# A frame: of a camera, of a rectangle at a frameset (-1 where it stands still), of the rig or of the world.
Frame = tuple[str, str, int]
_RIG: Frame = ("rig", "", -1)


@dataclass(frozen=True, eq=False)
class Placed:
    """Lenses by camera, and how frames lie to each other. rig: None where the corners do not make one yet.

    steps: for each frame its neighbours with here_from_neighbour. reason: why there is no rig, or "".
    """

    lenses: dict[str, Intrinsics]
    steps: dict[Frame, dict[Frame, Pose]]
    rig: Rig | None
    reason: str

    def predicted(self, camera: str, rectangle: Rectangle, frameset: int) -> Floats | None:
        """Pixels (4, 2) where the corners of a rectangle should appear; None where that is not known.

        nan where the camera cannot see a corner.
        """
        camera_from_rect = self._pose(("camera", camera, -1), _frame(rectangle, frameset))
        if camera_from_rect is None or camera not in self.lenses:
            return None
        return self.lenses[camera].project(camera_from_rect.transform(rectangle.corners))

    def _pose(self, here: Frame, there: Frame) -> Pose | None:
        """here_from_there by the fewest steps."""
        reached, queue = {here: Pose.identity()}, deque([here])
        while queue and there not in reached:
            at = queue.popleft()
            for after, pose in self.steps.get(at, {}).items():
                if after not in reached:
                    reached[after] = reached[at] @ pose
                    queue.append(after)
        return reached.get(there)


def place(
    cameras: Sequence[CameraInput], rectangles: Sequence[Rectangle], views: Sequence[View], reference: str | None
) -> Placed:
    """The rig of these Views, and beside it each camera that is not in it from its own pictures alone."""
    rig, reason = None, "click all four corners of a rectangle"
    if views:
        try:
            rig, reason = calibrate(cameras, rectangles, views, reference), ""
        except QuadrigError as error:
            reason = str(error)
    lenses: dict[str, Intrinsics] = {}
    steps: dict[Frame, dict[Frame, Pose]] = {}

    def join(here: Frame, there: Frame, here_from_there: Pose) -> None:
        steps.setdefault(here, {})[there] = here_from_there
        steps.setdefault(there, {})[here] = here_from_there.inverse()

    if rig is not None:
        for camera in rig.cameras:
            lenses[camera.name] = camera.intrinsics
            join(_RIG, ("camera", camera.name, -1), camera.rig_from_camera)
        for placed in rig.rectangles:
            many = placed.rectangle.moving
            for row, frameset in enumerate(placed.framesets.tolist() if many else [-1]):
                pose = placed.rig_from_rect[row] if many else placed.rig_from_rect
                join(_RIG, _frame(placed.rectangle, frameset), pose)
    for rectangle in rectangles:
        if rectangle.body_from_rect is not None and not rectangle.moving:
            join(("body", rectangle.body, -1), _frame(rectangle, -1), rectangle.body_from_rect)
    known = {rectangle.name: rectangle for rectangle in rectangles}
    for camera in cameras:
        own = [view for view in views if view.camera == camera.name]
        if camera.name in lenses or not own:
            continue
        alone = _alone(camera, own)
        if alone is None:
            continue
        lenses[camera.name], poses = alone
        for view, pose in zip(own, poses, strict=True):
            join(("camera", camera.name, -1), _frame(known[view.rectangle], view.frameset), pose)
    return Placed(lenses, steps, rig, reason)


def _frame(rectangle: Rectangle, frameset: int) -> Frame:
    return "rectangle", rectangle.name, frameset if rectangle.moving else -1


def _alone(camera: CameraInput, views: Sequence[View]) -> tuple[Intrinsics, list[Pose]] | None:
    """Lens and camera_from_rect of each View by this camera's pictures alone; None where no camera fits them."""
    known = camera.intrinsics
    try:
        found = calibrate_views(
            views,
            (camera.width, camera.height),
            focal=None if known is None else known.focal,
            principal_point=None if known is None else known.principal_point,
        )
    except (QuadrigError, np.linalg.LinAlgError):
        return None
    return found.intrinsics, [found.camera_from_rects[row] for row in range(len(views))]
