"""What the person at the rig moves: a sheet, a body of several rectangles, or the rig itself, through a room."""

from collections.abc import Sequence
from dataclasses import dataclass

from quadrig.rig.problem.layouts import body_of
from quadrig.rig.result import ROOM, Rig
from quadrig.single.rectangle import Rectangle


@dataclass(frozen=True)
class InHand:
    """body: its name, "" where it is a sheet. is_room: the body is around the rig, and the rig is what is moved."""

    body: str = ""
    is_room: bool = False

    @property
    def noun(self) -> str:
        """What it is called in a sentence."""
        if self.is_room:
            return "the rig"
        return f"'{self.body}'" if self.body else "the sheet"

    @property
    def seen(self) -> str:
        """What cameras are to see."""
        return f"a rectangle of '{self.body}'" if self.is_room else self.noun

    def so_that(self, clause: str) -> str:
        """What to do for a clause to come true."""
        verb = "carry" if self.is_room else "turn" if self.body else "hold"
        return f"{verb} {self.noun} so that {clause}"

    def for_both(self, first: str, second: str) -> str:
        """What to do for two cameras, or groups of them, to see it at one time."""
        if not self.body:
            return f"hold the sheet where {first} and {second} both see it"
        return self.so_that(
            f"{first} and {second} {'each see ' + self.seen if self.is_room else 'see it'} at one time"
        )


SHEET = InHand()
"""One sheet, or several that are moved one by one."""


def in_hand(rectangles: Sequence[Rectangle], rig: Rig | None = None) -> InHand:
    """What is moved before cameras that see these rectangles; rig: as far as it is known."""
    room = rig.room.name if rig is not None and rig.room is not None else ROOM
    bodies = dict.fromkeys(body_of(rectangle) for rectangle in rectangles if rectangle.moving)
    if room in bodies:
        return InHand(room, is_room=True)
    joined = {rectangle.body for rectangle in rectangles if rectangle.moving}
    return InHand(joined.pop()) if len(bodies) == len(joined) == 1 else SHEET
