"""Figures of a rig that pictures share: outlines, arrows, edges, histograms."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from quadrig.io.drawing.geometry import dense_outline, round_down
from quadrig.rig.doubt.disagreement import Disagreement
from quadrig.rig.doubt.residual_field import ResidualField
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.result import Camera, Rig, ViewFit, placed_pose
from quadrig.single.arrays import Floats
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

_SIDE_POINTS = 12
# Residual arrows are drawn so much longer that a usual one is this share of the picture's width.
_ARROW = 0.025
# ... and one of a fault is cut to this share, or it would lie across everything else.
_LONGEST_ARROW = 0.15
_BINS = 24


def arrow_scale(rig: Rig) -> float:
    """How many times longer than they are residuals are drawn, a round number: one for all cameras, so that their
    pictures can be compared."""
    usual = [c.rms / c.intrinsics.width for c in rig.cameras if np.isfinite(c.rms) and c.rms > 0]
    return max(round_down(_ARROW / max(usual)), 1.0) if usual else 1.0


def residual_arrows(camera: Camera, residuals: Floats, scale: float) -> Floats:
    """Residuals (P, 2) px of a camera, as long as they are drawn: `scale` times longer than they are."""
    arrows = scale * residuals
    length = np.linalg.norm(arrows, axis=1, keepdims=True)
    return arrows * np.minimum(1.0, _LONGEST_ARROW * camera.intrinsics.width / np.maximum(length, 1e-12))


def predicted_outline(rig: Rig, camera: Camera, fit: ViewFit) -> Floats | None:
    """Where the rig says the rectangle's outline lies in the picture (P, 2) px; None where part is out of sight."""
    pose = placed_pose(rig, fit.view.rectangle, fit.view.frameset)
    rectangle = next((placed.rectangle for placed in rig.rectangles if placed.name == fit.view.rectangle), None)
    if pose is None or rectangle is None:
        return None
    ring = np.concatenate([dense_outline(rectangle.corners, _SIDE_POINTS), rectangle.corners[:1]])
    pixels = camera.intrinsics.project((camera.rig_from_camera.inverse() @ pose).transform(ring))
    return pixels if np.isfinite(pixels).all() else None


def graph_edges(views: Sequence[Disagreement]) -> list[Disagreement]:
    """One edge for each camera and rectangle: information summed, disagreements as root mean squares of its Views.

    rejected: where none of its Views took part. frameset: that of its worst View.
    """
    edges: dict[tuple[str, str], list[Disagreement]] = {}
    for one in views:
        if np.isfinite(one.sigmas):
            edges.setdefault((one.camera, one.rectangle), []).append(one)
    return [_joined(own) for own in edges.values()]


def _joined(views: list[Disagreement]) -> Disagreement:
    kept = [one for one in views if not one.rejected] or views
    figures = np.array([(one.rotation, one.translation, one.sigmas) for one in kept])
    rotation, translation, sigmas = np.sqrt(np.mean(figures**2, axis=0)).tolist()
    worst = max(kept, key=lambda one: one.sigmas)
    information = sum(one.information for one in views if not one.rejected)
    return Disagreement(
        worst.camera, worst.rectangle, worst.frameset, rotation, translation, sigmas, information, worst.rejected
    )


def edge_widths(information: Sequence[float]) -> list[float]:
    """Half widths of lines, 1 to 5, by the logarithm of what they carry."""
    if not information:
        return []
    size = np.log10(np.maximum(np.asarray(information, float), 1e-12))
    # Three decades below the strongest an edge no longer matters, and all such are thin.
    return np.clip(5 + 4 * (size - size.max()) / 3, 1, 5).tolist()


def residual_histogram(field: ResidualField, top: float) -> tuple[Floats, Floats]:
    """Counts (B,) of residual lengths and edges (B+1,) px of their bins up to `top`; longer ones share the last."""
    counts, edges = np.histogram(np.minimum(field.lengths, top), bins=_BINS, range=(0, top))
    return counts, edges


def longest_usual(fields: Iterable[ResidualField]) -> float:
    """Up to which length, px, the residuals of all cameras are worth a bin."""
    every = np.concatenate([np.zeros(0), *(field.lengths for field in fields)])
    # Beyond three times the 90th percentile are outliers: they share the last bin and do not squash the rest.
    return max(3 * float(np.percentile(every, 90)), 1e-6) if len(every) else 1.0


def shared_counts(views: Sequence[View], rectangles: Mapping[str, Rectangle]) -> dict[tuple[str, str], int]:
    """How many placed sheets, or bodies, each pair of cameras (in the order of names) has in common."""
    seen: dict[tuple[str, int], set[str]] = {}
    for view in views:
        rectangle = rectangles.get(view.rectangle)
        moving, name = rectangle is not None and rectangle.moving, body_of(rectangle) if rectangle else view.rectangle
        seen.setdefault((name, view.frameset if moving else -1), set()).add(view.camera)
    counts: dict[tuple[str, str], int] = {}
    for cameras in seen.values():
        names = sorted(cameras)
        for k, first in enumerate(names):
            for second in names[k + 1 :]:
                counts[first, second] = counts.get((first, second), 0) + 1
    return counts
