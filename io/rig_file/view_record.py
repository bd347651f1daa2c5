"""A View as JSON: the one form in which detections, live sessions and rigs keep it."""

import msgspec

from quadrig.io.rig_file.json_numbers import Number, number, numbers, read_number, read_numbers
from quadrig.single.view import View


class ViewRecord(msgspec.Struct, kw_only=True):
    """A View: points (P, 3) m, pixels (P, 2), alternatives each (P, 3), sigma px, time s, common (P, 2) px, back.

    camera and frameset have defaults, for detections are kept by image and grouped into framesets later.
    """

    rectangle: str
    camera: str = ""
    frameset: int = 0
    points: list[list[Number]]
    pixels: list[list[Number]]
    alternatives: list[list[list[Number]]]
    sigma: Number
    time: Number = None
    common: list[list[Number]] | None = None
    back: bool = False


def view_record(view: View) -> ViewRecord:
    """The record of a View."""
    return ViewRecord(
        rectangle=view.rectangle,
        camera=view.camera,
        frameset=int(view.frameset),
        points=numbers(view.points),
        pixels=numbers(view.pixels),
        alternatives=[numbers(points) for points in view.alternatives],
        sigma=number(view.sigma),
        time=number(view.time),
        common=None if view.common is None else numbers(view.common),
        back=view.back,
    )


def recorded_view(held: ViewRecord) -> View:
    """The View of a record. Raises ValueError where its points and pixels are not as many."""
    count = len(held.pixels)
    return View(
        rectangle=held.rectangle,
        points=read_numbers(held.points, count, 3),
        pixels=read_numbers(held.pixels, -1, 2),
        camera=held.camera,
        frameset=held.frameset,
        alternatives=tuple(read_numbers(points, count, 3) for points in held.alternatives),
        sigma=read_number(held.sigma),
        time=read_number(held.time),
        common=None if held.common is None else read_numbers(held.common, count, 2),
        back=held.back,
    )
