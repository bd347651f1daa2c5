"""Many cameras: Views in, Rig out; how sure it is, what is weak, whether a camera moved, and what to show next."""

from typing import TYPE_CHECKING

from quadrig.single.lazy import lazy_names

if TYPE_CHECKING:
    from quadrig.rig.calibration import calibrate as calibrate
    from quadrig.rig.coach.advice import Advice as Advice
    from quadrig.rig.coach.advice import Situation as Situation
    from quadrig.rig.coach.advice import advise as advise
    from quadrig.rig.coach.conversation import Coach as Coach
    from quadrig.rig.coach.fault import Fault as Fault
    from quadrig.rig.comparison import CameraDifference as CameraDifference
    from quadrig.rig.comparison import Comparison as Comparison
    from quadrig.rig.comparison import compare as compare
    from quadrig.rig.doubt.disagreement import Disagreement as Disagreement
    from quadrig.rig.doubt.disagreement import disagreements as disagreements
    from quadrig.rig.doubt.residual_field import ResidualField as ResidualField
    from quadrig.rig.doubt.residual_field import residual_field as residual_field
    from quadrig.rig.doubt.verdict import Verdict as Verdict
    from quadrig.rig.doubt.verdict import verdict as verdict
    from quadrig.rig.doubt.working_accuracy import covered_points as covered_points
    from quadrig.rig.moved import CameraMove as CameraMove
    from quadrig.rig.moved import find_moved as find_moved
    from quadrig.rig.problem.camera_input import CameraInput as CameraInput
    from quadrig.rig.problem.camera_input import LensChoice as LensChoice
    from quadrig.rig.recalibration import recalibrate as recalibrate
    from quadrig.rig.result import Camera as Camera
    from quadrig.rig.result import PlacedRectangle as PlacedRectangle
    from quadrig.rig.result import Rig as Rig
    from quadrig.rig.result import ViewFit as ViewFit
    from quadrig.rig.result import placed_pose as placed_pose
    from quadrig.single.errors import QuadrigError as QuadrigError
    from quadrig.single.lens import Intrinsics as Intrinsics
    from quadrig.single.pose import Pose as Pose
    from quadrig.single.rectangle import Rectangle as Rectangle
    from quadrig.single.view import View as View

_MODULE_OF = {
    "calibrate": "calibration",
    "Advice": "coach.advice",
    "Situation": "coach.advice",
    "advise": "coach.advice",
    "Coach": "coach.conversation",
    "Fault": "coach.fault",
    "CameraDifference": "comparison",
    "Comparison": "comparison",
    "compare": "comparison",
    "Disagreement": "doubt.disagreement",
    "disagreements": "doubt.disagreement",
    "ResidualField": "doubt.residual_field",
    "residual_field": "doubt.residual_field",
    "Verdict": "doubt.verdict",
    "verdict": "doubt.verdict",
    "covered_points": "doubt.working_accuracy",
    "CameraMove": "moved",
    "find_moved": "moved",
    "CameraInput": "problem.camera_input",
    "LensChoice": "problem.camera_input",
    "recalibrate": "recalibration",
    "Camera": "result",
    "PlacedRectangle": "result",
    "Rig": "result",
    "ViewFit": "result",
    "placed_pose": "result",
    "QuadrigError": ".single.errors",
    "Intrinsics": ".single.lens",
    "Pose": ".single.pose",
    "Rectangle": ".single.rectangle",
    "View": ".single.view",
}

__all__ = list(_MODULE_OF)
__getattr__, __dir__ = lazy_names(__name__, _MODULE_OF)
