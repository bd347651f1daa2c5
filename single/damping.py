"""How far Levenberg and Marquardt's method trusts its quadratic model: one rule for all loops (Marquardt 1963).

Layouts differ, and so do the damping to begin with and the fall below which a step is the last; what a step's success
means for the next damping does not.
"""

from typing import NamedTuple

import numpy as np

from quadrig.single.arrays import Floats, Mask

# Shares of the promised fall: below the poor one the model bends within the step, and undamped steps would leap to
# and fro across a weak view's valley for ever.
_POOR_GAIN, _GOOD_GAIN = 0.3, 0.7
# Of each diagonal element: where so little is too little, the next that is worth a trial is ten times this.
_NEGLIGIBLE = 1e-6
MOST_DAMPING = 1e12
"""Past this damping a step is shorter than rounding: the minimum is reached, or cannot be."""
UNSOLVABLE = np.array(-1.0)
"""The gain of a step that could not be had, since its equations were singular."""


class Damping(NamedTuple):
    """value (...): share of each diagonal element that is added to it. raised (...): it was just too little."""

    value: Floats
    raised: Mask

    @staticmethod
    def of(value: Floats | float) -> "Damping":
        """To begin with."""
        return Damping(np.asarray(value, float), np.zeros(np.shape(value), bool))

    def after(self, gained: Floats) -> "Damping":
        """Less after a good step, more after a poor one, and more by far after one that was not taken."""
        good, poor = gained > _GOOD_GAIN, ~(gained > _POOR_GAIN)
        # What was just too little damping would be so again.
        less = np.where(good & ~self.raised, 0.1 * self.value, self.value)
        more = 10 * np.where(gained > 0, self.value, np.maximum(self.value, _NEGLIGIBLE))
        return Damping(np.where(poor, more, less), poor)


def gain(before: Floats | float, after: Floats | float, promised: Floats | float) -> Floats:
    """Share (...) of the promised fall of the cost that came; below zero where it rose, or no fall was promised.

    The step is to be taken where it is above zero. nan where the cost after it is no number.
    """
    with np.errstate(all="ignore"):
        return np.where(np.asarray(promised) > 0, np.subtract(before, after) / promised, -1.0)
