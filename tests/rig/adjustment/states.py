"""States of the joint adjustment made from simulated rigs, and its normal equations laid out as one matrix."""

from dataclasses import replace

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import FreeParameters
from quadrig.rig.adjustment.motion import Motion
from quadrig.rig.adjustment.normal_equations import linearise
from quadrig.rig.adjustment.state import State
from quadrig.rig.problem.build import build_problem
from quadrig.single.pose import Pose

EVERY_LENS = np.arange(9)
# As clocks differ and shutters roll, s and s a row.
CLOCK = np.array([0.02, 20e-6])


def problem_of(made):
    return build_problem(made.inputs, made.rectangles, made.views)


def true_state(made, problem):
    """The truth, the world being the rig frame."""
    order = [made.index(camera.name) for camera in problem.cameras]
    poses = [
        made.world_from_rect[node.body] if node.frameset < 0 else made.world_from_rect[node.body][node.frameset]
        for node in problem.nodes
    ]
    nodes = Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))
    return State(made.lenses[order], made.world_from_camera.inverse()[np.array(order)], nodes)


def shaken(state, rng, size=1e-3):
    cameras, nodes = len(state.lens), len(state.rig_from_body.translation)
    lens = rng.normal(size=(cameras, 9)) * [5, 2, 2, 0.01, 0.005, 1e-3, 1e-3, 0.002, 1e-3]
    return state.moved(lens, size * rng.normal(size=(cameras, 6)), size * rng.normal(size=(nodes, 6)))


def with_clocks(observations, state, rng, speed):
    """The state with rectangles that move between framesets, clocks that differ and shutters that roll."""
    views, cameras = len(observations.camera), len(state.lens)
    rate, bend = speed * rng.normal(size=(2, views, 6))
    row = np.zeros(views)
    for group in observations.groups:
        row[group.view] = group.pixels[..., 1].mean(axis=1)
    every = np.ones((cameras, 2), bool)
    moves = Motion(rate, bend, 0.01 * rng.normal(size=views), row, np.full(views, 359.5), every[:, 0], every)
    return replace(state, motion=moves, clocks=CLOCK * rng.normal(size=(cameras, 2)))


def full_system(normal, tables):
    """The normal equations before any elimination."""
    cameras, size = normal.unit_gradient.shape
    nodes = len(normal.node_gradient)
    total = cameras * size + 6 * nodes
    matrix = np.zeros((total, total))
    for c in range(cameras):
        matrix[c * size : (c + 1) * size, c * size : (c + 1) * size] = normal.units[c]
    for n in range(nodes):
        place = cameras * size + 6 * n
        matrix[place : place + 6, place : place + 6] = normal.nodes[n]
    for pair, (n, c) in enumerate(zip(tables.pair_node, tables.pair_unit, strict=True)):
        rows, columns = slice(c * size, (c + 1) * size), slice(cameras * size + 6 * n, cameras * size + 6 * n + 6)
        matrix[rows, columns] = normal.pairs[pair]
        matrix[columns, rows] = normal.pairs[pair].T
    return matrix, np.concatenate([normal.unit_gradient.ravel(), normal.node_gradient.ravel()])


def open_freedom(observations, state, slack=None):
    cameras = len(state.lens)
    lens = np.zeros((cameras, 9), bool)
    lens[:, :5] = True
    # A principal point known to 20 px, and radial terms that belong together.
    information = np.zeros((cameras, 9, 9))
    information[:, [1, 2], [1, 2]] = 1 / 20.0**2
    information[:, 3:5, 3:5] = [[40.0, 30.0], [30.0, 50.0]]
    return FreeParameters(
        lens, np.arange(cameras) > 0, np.ones(observations.nodes, bool), state.lens.copy(), information,
        slack=slack,
    )  # fmt: skip


def whole_cost(observations, state, free, noise):
    cost = linearise(observations, state, EVERY_LENS, noise).cost
    away = (state.lens - free.prior_mean) * free.lens
    cost += np.einsum("ci,cij,cj->", away, free.prior_information, away)
    if state.slack is not None:
        held = np.where(free.slack.loose[:, None], free.slack.information, 0)
        cost += (held * state.slack**2).sum()
    return cost
