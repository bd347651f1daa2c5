"""Which part of a recording each rectangle pose belongs to, where parts are held out or held against one another."""

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.single.arrays import Ints

# Five folds leave four fifths to fit: near enough to the whole that the figure speaks of the rig that is delivered.
_FOLDS = 5


def folds_of(problem: Problem) -> Ints:
    """The fold (N,) of each node: framesets in a row, about as many Views in each fold, still rectangles in turn."""
    frameset = np.array([node.frameset for node in problem.nodes], int)
    folds = np.zeros(len(frameset), int)
    moving = frameset >= 0
    if moving.any():
        order = np.unique(frameset[moving], return_inverse=True)[1]
        views = np.bincount(problem.node, minlength=len(frameset))[moving]
        total = np.bincount(order, views)
        middle = np.cumsum(total) - total / 2
        # Few framesets, or ones of many Views, may skip a fold: numbers are closed up.
        number = np.unique((_FOLDS * middle / total.sum()).astype(int), return_inverse=True)[1]
        folds[moving] = number[order]
    folds[~moving] = np.arange(int((~moving).sum())) % _FOLDS
    return folds
