"""A Rig in rerun: cameras, rectangles and their doubt in space, what was found and predicted in every picture, the
pose graph, the residuals over each picture, and the verdict in words.

Entities: space/... in the rig frame (metres), space/cameras/<name> with a Pinhole each and what lies in its picture;
room/... in the frame of the room that the rig was carried through; graph, field/<name>, histogram/<name>, verdict.
"""

from collections.abc import Iterable, Sequence

import rerun as rr

from quadrig.io.drawing.palette import rig_colours
from quadrig.io.drawing.verdict_markdown import verdict_markdown
from quadrig.io.viewer.inspect.field import log_fields
from quadrig.io.viewer.inspect.graph import log_graph
from quadrig.io.viewer.inspect.picture_marks import log_picture_marks
from quadrig.io.viewer.inspect.room import log_room
from quadrig.io.viewer.inspect.space import log_space
from quadrig.io.viewer.inspect.timeline import set_frameset
from quadrig.rig.doubt.disagreement import disagreements
from quadrig.rig.result import Rig


def log_rig(recording: rr.RecordingStream, rig: Rig, times: Sequence[int] = ()) -> None:
    """Log all of a Rig. times: ns since 1970 of each frameset, by index, where known."""
    recording.log("verdict", rr.TextDocument(verdict_markdown(rig), media_type="text/markdown"), static=True)
    colours = rig_colours(rig)
    log_space(recording, rig, colours, times)
    if rig.room is not None:
        log_room(recording, rig, rig.room, colours, times)
    log_picture_marks(recording, rig, colours, times)
    log_graph(recording, rig, disagreements(rig), colours)
    log_fields(recording, rig)


def log_pictures(
    recording: rr.RecordingStream, pictures: Iterable[tuple[int, str, bytes]], times: Sequence[int] = ()
) -> int:
    """Log JPEG pictures (frameset, camera, bytes) under their cameras; how many there were."""
    count = 0
    for frameset, camera, picture in pictures:
        set_frameset(recording, frameset, times)
        image = rr.EncodedImage(contents=picture, media_type="image/jpeg")
        recording.log(f"space/cameras/{camera}/picture", image)
        count += 1
    return count
