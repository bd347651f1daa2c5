"""From one advice to the next: what was said stays until it was followed or given up, so that it can be obeyed."""

from dataclasses import dataclass, replace

from quadrig.rig.coach.advice import Advice
from quadrig.single.pose import Pose

# A person needs about five seconds to read, walk and hold; after twice that the place cannot be reached.
_PATIENCE = 10.0
# Nobody keeps more refusals in mind, and a place that could not be reached early may be wanted again later.
_REMEMBERED = 6


@dataclass(frozen=True, eq=False)
class Coach:
    """What is being said, since when (s, of the caller's clock), and what was given up."""

    advice: Advice | None = None
    since: float = 0.0
    refused: tuple[Pose, ...] = ()
    refused_pairs: frozenset[frozenset[str]] = frozenset()

    def hear(self, proposal: Advice, shown: frozenset[str], now: float) -> "Coach":
        """The coach after a new proposal: it says that where the old one was tried, is done or cannot be done.

        shown: the cameras that have seen the sheet, where it is new, since the last proposal was heard.
        """
        said = self.advice
        if (
            said is None
            or said.kind == "done"
            or proposal.kind == "done"
            or (said.ghost is None) != (proposal.ghost is None)
        ):
            return replace(self, advice=proposal, since=now)
        if said.ghost is None and said.sentence != proposal.sentence:
            return replace(self, advice=proposal, since=now)
        if shown and shown >= set(said.cameras):
            return replace(self, advice=proposal, since=now)
        if now - self.since < _PATIENCE:
            return self
        if said.ghost is not None:
            return replace(self, advice=proposal, since=now, refused=(*self.refused, said.ghost)[-_REMEMBERED:])
        pairs = self.refused_pairs | {frozenset(said.cameras)}
        return replace(self, advice=proposal, since=now, refused_pairs=pairs)
