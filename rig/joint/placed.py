"""From the end of the joint adjustment to where bodies and rectangles stood, and how sure that is."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.adjustment.systematic_errors import sheet_rows
from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.layouts import body_of, sheets_of
from quadrig.rig.result import PlacedBody, PlacedRectangle
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose, stacked, step_by_inner_twist, step_by_left_twist
from quadrig.single.posterior.sheet_shape import SheetShape


@dataclass(frozen=True, eq=False)
class PlacedPoses:
    """rig_from_body (N,) and body_from_rect (L,) as they were found, with covariances of their twists: nodes (N, 6,
    6), layouts (L, 6, L, 6), and of nodes with layouts, across (N, 6, L, 6). alone (L, 6, L, 6): of layouts, with
    each camera's own noise. seen (N,) bool: which nodes a View shows."""

    rig_from_body: Pose
    body_from_rect: Pose
    nodes: Floats
    layouts: Floats
    across: Floats
    alone: Floats
    seen: Mask

    def of_rectangle(self, nodes: Ints, layout: int) -> tuple[Pose, Floats]:
        """rig_from_rect (N',) at some nodes, and the covariance (N', 6, 6) of its step; layout: the row of its pose
        on its body, -1 where it is the body's frame."""
        rig_from_body, own = self.rig_from_body[nodes], self.nodes[nodes]
        if layout < 0:
            by_node = step_by_left_twist(rig_from_body)
            return rig_from_body, by_node @ own @ np.swapaxes(by_node, -1, -2)
        on_body = self.body_from_rect[layout]
        rig_from_rect = rig_from_body @ on_body
        by_node = step_by_left_twist(rig_from_rect)
        position = np.broadcast_to(on_body.translation, (len(nodes), 3))
        by_layout = step_by_inner_twist(rig_from_body.rotation, position)
        crossed = by_node @ self.across[nodes, :, layout] @ np.swapaxes(by_layout, -1, -2)
        covariance = by_node @ own @ np.swapaxes(by_node, -1, -2) + crossed + np.swapaxes(crossed, -1, -2)
        covariance += by_layout @ self.layouts[layout, :, layout] @ np.swapaxes(by_layout, -1, -2)
        return rig_from_rect, covariance

    def of_layouts(self, rows: Ints) -> Floats:
        """Covariance (6 K, 6 K) of the steps of poses on a body; rows (K,): theirs, -1 for the body's frame."""
        result = np.zeros((len(rows), 6, len(rows), 6))
        known = np.flatnonzero(rows >= 0)
        by_twist = step_by_left_twist(self.body_from_rect[rows[known]])
        own = self.alone[rows[known]][:, :, rows[known]]
        result[np.ix_(known, np.arange(6), known, np.arange(6))] = np.einsum(
            "aij,ajbk,blk->aibl", by_twist, own, by_twist
        )
        return result.reshape(6 * len(rows), 6 * len(rows))


def placed_poses(problem: Problem, joint: Joint, widening: float, covariance: Floats) -> PlacedPoses:
    """All poses and their covariances; widening: what these are multiplied by. covariance (E M, E M): of the units,
    with the noise of each camera."""
    state, found, count = joint.predicted, problem.layouts.found, len(problem.layouts.names)
    seen = np.zeros(len(problem.nodes), bool)
    seen[joint.observations.node[~joint.inliers.rejected]] = True
    layouts, alone = np.zeros((2, count, 6, count, 6))
    across = np.zeros((len(seen), 6, count, 6))
    columns = _layout_columns(joint)
    if found:
        own = joint.bordered.columns(columns)
        layouts[:found, :, :found] = own[columns].reshape(found, 6, found, 6)
        alone[:found, :, :found] = covariance[np.ix_(columns, columns)].reshape(found, 6, found, 6)
        across[:, :, :found] = joint.bordered.node_columns(joint.reduced, own).reshape(len(seen), 6, found, 6)
    return PlacedPoses(
        state.rig_from_body,
        state.body_from_rect,
        widening * joint.bordered.node_covariances(joint.adjustment, joint.reduced),
        widening * layouts,
        widening * across,
        alone,
        seen,
    )


def layout_covariance(joint: Joint) -> Floats:
    """Covariance (F, 6, F, 6) of the twists of the poses on bodies that are to be found."""
    columns = _layout_columns(joint)
    found = len(columns) // 6
    return joint.bordered.columns(columns)[columns].reshape(found, 6, found, 6)


def _layout_columns(joint: Joint) -> Ints:
    """Where (6 F,) those poses stand among the units' parameters."""
    units, size = joint.reduced.free.shape
    first = np.arange(len(joint.predicted.lens), units)[:, None] * size + len(joint.adjustment.columns)
    return (first + np.arange(6)).ravel()


def rectangles_of(problem: Problem, joint: Joint, placed: PlacedPoses) -> tuple[PlacedRectangle, ...]:
    """Every rectangle that was placed, where it was seen, or once where it stands still; one whose Views were all
    rejected is not, unless its pose is given on a body that was placed."""
    names, sheet_of, result = list(problem.rectangles), sheets_of(problem.rectangles), []
    kept = problem.node[~joint.inliers.rejected], problem.rectangle[~joint.inliers.rejected]
    for number, (name, rectangle) in enumerate(problem.rectangles.items()):
        sheet, body = sheet_of[name], body_of(rectangle)
        shape = _shape(joint, names, sheet)
        nodes = np.unique(kept[0][kept[1] == names.index(sheet)])
        nodes = nodes[[problem.nodes[node].body == body for node in nodes]]
        if not rectangle.moving and rectangle.body_from_rect is not None:
            nodes = np.array([i for i in _nodes(problem, rectangle.body) if placed.seen[i]], int)
        if not len(nodes):
            continue
        pose, covariance = placed.of_rectangle(nodes, int(problem.layouts.number[number]))
        if rectangle.moving:
            framesets = np.array([problem.nodes[i].frameset for i in nodes])
            result.append(PlacedRectangle(rectangle, pose, covariance, framesets, shape))
        else:
            result.append(PlacedRectangle(rectangle, pose[0], covariance[0], shape=shape))
    return tuple(result)


def _shape(joint: Joint, names: list[str], sheet: str) -> SheetShape:
    rows = sheet_rows(names, sheet)
    return SheetShape(joint.bordered.values[rows], joint.bordered.error_covariances(rows[None])[0])


def _nodes(problem: Problem, body: str) -> list[int]:
    return [index for index, node in enumerate(problem.nodes) if node.body == body]


def bodies_of(problem: Problem, placed: PlacedPoses) -> tuple[PlacedBody, ...]:
    """The bodies of several rectangles, or of given poses, that were placed."""
    members: dict[str, list[int]] = {}
    seen, sheet_of = {list(problem.rectangles)[row] for row in problem.rectangle}, sheets_of(problem.rectangles)
    for number, (name, rectangle) in enumerate(problem.rectangles.items()):
        if rectangle.body and (rectangle.body_from_rect is not None or sheet_of[name] in seen):
            members.setdefault(body_of(rectangle), []).append(number)
    names, result = list(problem.rectangles), []
    for body, numbers in members.items():
        nodes = np.array([i for i in _nodes(problem, body) if placed.seen[i]], int)
        if not len(nodes):
            continue
        rows = problem.layouts.number[numbers]
        on_body = [placed.body_from_rect[row] if row >= 0 else Pose.identity() for row in rows]
        pose, covariance = placed.of_rectangle(nodes, -1)
        framesets = np.array([problem.nodes[i].frameset for i in nodes])
        still = bool(framesets[0] < 0)
        result.append(
            PlacedBody(
                body,
                tuple(names[number] for number in numbers),
                stacked(on_body),
                placed.of_layouts(rows),
                pose[0] if still else pose,
                covariance[0] if still else covariance,
                framesets[:0] if still else framesets,
            )
        )
    return tuple(result)
