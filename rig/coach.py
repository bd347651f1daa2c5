"""From one advice to the next: what was said stays until it was followed or given up, so that it can be obeyed."""

from dataclasses import dataclass, replace

from quadrig.single.pose import Pose

from .advice import Advice, reached
from .result import Rig

# A person needs about five seconds to read, walk and hold; after three times that the place cannot be reached.
_PATIENCE = 15.0
# Nobody keeps more refusals in mind, and a place that could not be reached early may be wanted again later.
_REMEMBERED = 6


@dataclass(frozen=True, eq=False)
class Coach:
    """What is being said, since when (s, of the caller's clock), and what was given up."""

    advice: Advice | None = None
    since: float = 0.0
    refused: tuple[Pose, ...] = ()
    refused_pairs: frozenset[frozenset[str]] = frozenset()

    def hear(self, proposal: Advice, rig: Rig | None, now: float) -> "Coach":
        """The coach after a new proposal: it changes what it says where that is done, impossible or overtaken."""
        if self.advice is None or self.advice.kind != proposal.kind or proposal.ghost is None:
            return self._hear_plain(proposal, now)
        if self._followed(rig) or proposal.rectangle != self.advice.rectangle:
            return replace(self, advice=proposal, since=now)
        if now - self.since > _PATIENCE and self.advice.ghost is not None:
            refused = (*self.refused, self.advice.ghost)[-_REMEMBERED:]
            return replace(self, advice=proposal, since=now, refused=refused)
        return self

    def _hear_plain(self, proposal: Advice, now: float) -> "Coach":
        said = self.advice
        if (
            said is not None
            and said.ghost is not None
            and proposal.ghost is not None
            and now - self.since < _PATIENCE / 3
        ):
            return self
        if said is None or said.sentence != proposal.sentence:
            return replace(self, advice=proposal, since=now)
        if said.kind == "connect" and now - self.since > _PATIENCE:
            pairs = self.refused_pairs | {frozenset(said.cameras)}
            return replace(self, since=now, refused_pairs=pairs)
        return self

    def _followed(self, rig: Rig | None) -> bool:
        """Whether the sheet has stood where the ghost is."""
        if rig is None or self.advice is None or self.advice.ghost is None:
            return False
        placed = next((p for p in rig.rectangles if p.name == self.advice.rectangle), None)
        if placed is None or placed.rig_from_rect.translation.ndim == 1:
            return False
        # Places from before the advice are told apart by the ghost itself: it is never where the sheet has been.
        last = placed.rig_from_rect[-1]
        return reached(self.advice.ghost, last)
