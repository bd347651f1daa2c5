"""What cameras that found nothing have in plain sight, in sentences: a mirrored sheet, another board, other tags."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.io.config.marking_tables import marking_keys
from quadrig.io.config.toml_lines import toml_line
from quadrig.io.recording.framesets import Framesets
from quadrig.io.recording.image_source import ImageSource
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.search.effort import Effort
from quadrig.io.workers import run_tasks
from quadrig.single.arrays import Picture
from quadrig.single.detect.plain_sight import PlainSight, plain_sight
from quadrig.single.rectangle import Marking, Rectangle, TagFamily
from quadrig.single.view import View

# Images of a camera that are looked at again: what is shown for long is in one of them.
_SAMPLES = 5
# What is in plain sight is so in this many pixels as well, and five pictures of a hundred megapixels need gigabytes.
_PIXELS = 8_000_000


@dataclass(frozen=True, eq=False)
class _Task:
    camera: str
    source: ImageSource
    rectangles: tuple[Rectangle, ...]
    size: tuple[int, int]


def plain_sights(
    recording: Recording, framesets: Framesets, views: Sequence[View], rectangles: Sequence[Rectangle], effort: Effort
) -> dict[str, str]:
    """A sentence for each camera without Views in whose images something else stands out, by camera."""
    seeing = {view.camera for view in views}
    looked_for = tuple(rectangle for rectangle in rectangles if rectangle.marking.marks)
    tasks = []
    for camera in recording.cameras:
        images = framesets.of_camera(camera.name)[1]
        if looked_for and len(images) and camera.name not in seeing:
            sample = images[np.linspace(0, len(images) - 1, min(_SAMPLES, len(images))).round().astype(int)]
            tasks.append(_Task(camera.name, camera.source.part(sample), looked_for, (camera.width, camera.height)))
    return {
        tasks[index].camera: sentence
        for index, sentence in run_tasks(_look, tasks, effort.workers, effort.executor)
        if sentence is not None
    }


def _look(task: _Task) -> str | None:
    width, height = task.size
    shrink = next((times for times in (1, 2, 4) if width * height <= _PIXELS * times**2), 8)
    size = -(-width // shrink), -(-height // shrink)
    # Those of another size were not searched: what they show is no reason.
    images = task.source.images(shrink=shrink)
    searched = [image for image in images if image is not None and image.shape[1::-1] == size]
    return sight_sentence(task.camera, searched, task.rectangles)


def sight_sentence(who: str, pictures: Sequence[Picture], rectangles: Sequence[Rectangle]) -> str | None:
    """What grey pictures, in which nothing was found, show instead, in a sentence; None where nothing stands out.

    who: the camera, or whatever sees.
    """
    sight = plain_sight(pictures, rectangles)
    return None if sight is None else sight_words(who, sight, rectangles)


def sight_words(who: str, sight: PlainSight, rectangles: Sequence[Rectangle]) -> str:
    """What somebody sees in the place of the rectangles, in a sentence."""
    if sight.mirrored:
        return (
            f"{who} sees {sight.rectangle!r} mirrored: in a mirror, or from behind; show it the front, or set "
            "back = true in its [[rectangle]] where it is printed through or lies on glass"
        )
    if sight.marking is not None:
        given = next(rectangle.marking for rectangle in rectangles if rectangle.name == sight.rectangle)
        line = toml_line("marking", marking_keys(sight.marking))
        return (
            f"{who} does not see {sight.rectangle!r} as it is described, but {_words(sight.marking)}"
            f"{_counted(given, sight.marking)}; if that is the one, write in rig.toml: {line}"
        )
    listed = ", ".join(map(str, sight.ids[:6])) + (" and more" if len(sight.ids) > 6 else "")
    expected = ", ".join(rectangle.marking.description for rectangle in rectangles)
    if sight.family is None:
        seen = "a chessboard of {} x {} squares, which is".format(*sight.squares)
    else:
        seen = f"tag {listed} of {_family_words(sight.family)}, which {'is' if len(sight.ids) == 1 else 'are'}"
    return f"{who} sees {seen} not looked for ({expected} is); take the right sheet or correct its description"


def _words(marking: Marking) -> str:
    """The marking with what distinguishes it from others of its kind."""
    keys = marking_keys(marking)
    sides = f" of {keys['columns']} x {keys['rows']}" if {"columns", "rows"} <= keys.keys() else ""
    switched = [str(key) for key, value in keys.items() if value is True]
    also = f" ({', '.join(switched)})" if switched else ""
    return f"{marking.description}{'' if sides.removeprefix(' of ') in marking.description else sides}{also}"


def _counted(given: Marking, seen: Marking) -> str:
    """Why one may have been written for the other, where that is a matter of counting."""
    sides = [(getattr(one, "columns", 0), getattr(one, "rows", 0)) for one in (given, seen)]
    if sides[1] == (sides[0][0] + 1, sides[0][1] + 1):
        return f": {sides[0][0]} x {sides[0][1]} are its inner corners, and columns and rows count squares"
    return ""


def _family_words(family: TagFamily) -> str:
    border = f" with a border of {family.border} cells, as in an AprilGrid" if family.border > 1 else ""
    return f"{family.dictionary}{', white on black' if family.inverted else ''}{border}"
