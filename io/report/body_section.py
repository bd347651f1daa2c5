"""What the report says of a body: where its rectangles stand on it, and of a room the path of the rig in it."""

from html import escape

from quadrig.io.drawing.tables import html_table
from quadrig.io.drawing.things import room_map
from quadrig.io.report import plots
from quadrig.io.report.figures import figures
from quadrig.rig.result import PlacedBody, Rig, body_columns, body_sentence


def body_section(rig: Rig, body: PlacedBody) -> str:
    """Words, table and, of the room that the rig is carried through, its map."""
    table = f"<p>{escape(body_sentence(body))}.</p>{html_table(body_columns(rig, body))}"
    drawn = _map(rig, body) if body is rig.room else ""
    return f"<h2>Body {escape(body.name)}</h2>{drawn}{table}"


def _map(rig: Rig, body: PlacedBody) -> str:
    room = room_map(rig, body)
    plan = plots.room_view(rig, room, (0, 1), "the room from above", ("right, m", "ahead, m"))
    side = plots.room_view(rig, room, (0, 2), "the room from one side", ("right, m", "up, m"))
    drawn = figures(("From above.", plan), ("From one side.", side))
    return (
        f'<div class="row">{drawn}</div><p>The line is the path of the rig frame, from its dot on; the cameras are '
        "drawn where it began. Ellipses are one sigma of where each rectangle hangs, drawn "
        f"{plots.room_scale(room):.0f} times larger. Up is where the pictures have it.</p>"
    )
