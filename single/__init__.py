"""One camera, one image: corners in; focal, pose and covariance out. Pure functions on arrays."""

from typing import TYPE_CHECKING

from quadrig.single.lazy import lazy_names

if TYPE_CHECKING:
    from quadrig.single.arrays import Floats as Floats
    from quadrig.single.arrays import Ints as Ints
    from quadrig.single.arrays import Mask as Mask
    from quadrig.single.arrays import Picture as Picture
    from quadrig.single.calibration import Calibration as Calibration
    from quadrig.single.calibration import calibrate_view as calibrate_view
    from quadrig.single.calibration import calibrate_views as calibrate_views
    from quadrig.single.detect.image_search import detect_views as detect_views
    from quadrig.single.errors import QuadrigError as QuadrigError
    from quadrig.single.lens import LENS_PARAMETERS as LENS_PARAMETERS
    from quadrig.single.lens import Intrinsics as Intrinsics
    from quadrig.single.lens import project as project
    from quadrig.single.lens import unproject as unproject
    from quadrig.single.markings.april_grid import AprilGridMarking as AprilGridMarking
    from quadrig.single.markings.blank_sheet import PlainMarking as PlainMarking
    from quadrig.single.markings.boards import board_points as board_points
    from quadrig.single.markings.charuco import CharucoMarking as CharucoMarking
    from quadrig.single.markings.chessboard import ChessboardMarking as ChessboardMarking
    from quadrig.single.markings.circle_grid import CircleGridMarking as CircleGridMarking
    from quadrig.single.markings.registry import register as register
    from quadrig.single.markings.tag import TagMarking as TagMarking
    from quadrig.single.patch import Patch as Patch
    from quadrig.single.pose import Pose as Pose
    from quadrig.single.rectangle import FoundTags as FoundTags
    from quadrig.single.rectangle import Marking as Marking
    from quadrig.single.rectangle import PointsMarking as PointsMarking
    from quadrig.single.rectangle import Rectangle as Rectangle
    from quadrig.single.rectangle import TagFamily as TagFamily
    from quadrig.single.rectangle import Tags as Tags
    from quadrig.single.rectangle import rectangle_corners as rectangle_corners
    from quadrig.single.render.capture import SRGB as SRGB
    from quadrig.single.render.capture import Capture as Capture
    from quadrig.single.render.capture import ToneCurve as ToneCurve
    from quadrig.single.render.picture import Sheet as Sheet
    from quadrig.single.render.picture import ray_grid as ray_grid
    from quadrig.single.render.picture import render_image as render_image
    from quadrig.single.rotation import angles_from_rotation as angles_from_rotation
    from quadrig.single.rotation import rotation_from_angles as rotation_from_angles
    from quadrig.single.rotation import rotation_from_vector as rotation_from_vector
    from quadrig.single.solve.closed_form import closed_form as closed_form
    from quadrig.single.solve.cramer_rao import cramer_rao as cramer_rao
    from quadrig.single.solve.cramer_rao import paper_sigmas as paper_sigmas
    from quadrig.single.solve.maximum_likelihood import solve_points as solve_points
    from quadrig.single.solve.paper_form import paper_form as paper_form
    from quadrig.single.view import View as View

_MODULE_OF = {
    "Floats": "arrays",
    "Ints": "arrays",
    "Mask": "arrays",
    "Picture": "arrays",
    "Calibration": "calibration",
    "calibrate_view": "calibration",
    "calibrate_views": "calibration",
    "detect_views": "detect.image_search",
    "QuadrigError": "errors",
    "Intrinsics": "lens",
    "LENS_PARAMETERS": "lens",
    "project": "lens",
    "unproject": "lens",
    "AprilGridMarking": "markings.april_grid",
    "PlainMarking": "markings.blank_sheet",
    "board_points": "markings.boards",
    "CharucoMarking": "markings.charuco",
    "ChessboardMarking": "markings.chessboard",
    "CircleGridMarking": "markings.circle_grid",
    "register": "markings.registry",
    "TagMarking": "markings.tag",
    "Patch": "patch",
    "Pose": "pose",
    "FoundTags": "rectangle",
    "Marking": "rectangle",
    "PointsMarking": "rectangle",
    "Rectangle": "rectangle",
    "TagFamily": "rectangle",
    "Tags": "rectangle",
    "rectangle_corners": "rectangle",
    "SRGB": "render.capture",
    "Capture": "render.capture",
    "ToneCurve": "render.capture",
    "Sheet": "render.picture",
    "ray_grid": "render.picture",
    "render_image": "render.picture",
    "angles_from_rotation": "rotation",
    "rotation_from_angles": "rotation",
    "rotation_from_vector": "rotation",
    "closed_form": "solve.closed_form",
    "cramer_rao": "solve.cramer_rao",
    "paper_sigmas": "solve.cramer_rao",
    "solve_points": "solve.maximum_likelihood",
    "paper_form": "solve.paper_form",
    "View": "view",
}

__all__ = list(_MODULE_OF)
__getattr__, __dir__ = lazy_names(__name__, _MODULE_OF)
