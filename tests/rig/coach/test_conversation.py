"""The coach keeps to what it asked for until it was obeyed or asked in vain."""

from dataclasses import replace

import numpy as np

from quadrig.rig.coach.advice import Advice
from quadrig.rig.coach.conversation import Coach
from quadrig.single.pose import Pose


def test_a_coach_waits_until_it_was_obeyed_or_in_vain():
    first, second = (Advice("connect", word, pair) for word, pair in (("one", ("a", "b")), ("two", ("b", "c"))))
    coach = Coach().hear(first, frozenset(), 0.0)
    assert coach.hear(first, frozenset("a"), 3.0) is coach
    assert coach.hear(second, frozenset(), 3.0).advice is second
    late = coach.hear(replace(first), frozenset(), 30.0)
    assert late.refused_pairs == {frozenset(("a", "b"))}
    ghosts = [replace(first, kind="share", ghost=Pose(np.eye(3), np.full(3, float(k)))) for k in range(2)]
    coach = Coach().hear(ghosts[0], frozenset(), 0.0)
    assert coach.hear(ghosts[1], frozenset("a"), 3.0).advice is ghosts[0]
    assert coach.hear(ghosts[1], frozenset("ab"), 3.0).advice is ghosts[1]
    assert coach.hear(ghosts[1], frozenset(), 30.0).refused == (ghosts[0].ghost,)
