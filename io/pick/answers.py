"""What the page of `rig pick` may ask of the session, by path."""

from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from quadrig.io.local_page import Answer, Reply, Request
from quadrig.io.pick.session import PickSession, pixel_list
from quadrig.single.errors import QuadrigError

_HERE = Path(__file__).parent
_FILES = {
    "": ("page.html", "text/html; charset=utf-8"),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
    "page.css": ("page.css", "text/css; charset=utf-8"),
}


def answers(session: PickSession) -> Answer:
    """The answers of a session; changes one at a time, in the order of the clicks."""
    lock, solving = Lock(), Lock()

    def answer(request: Request) -> Reply | None:
        values: Mapping[str, Any] = request.values
        if request.method == "GET" and request.path in _FILES:
            name, kind = _FILES[request.path]
            return Reply((_HERE / name).read_bytes(), kind)
        if (request.method, request.path) == ("GET", "picture"):
            return Reply(session.jpeg(str(values.get("camera")), _whole(values, "image")), "image/jpeg")
        if (request.method, request.path) == ("GET", "solution"):
            # Clicks do not wait for this.
            with solving:
                return Reply.of_json(session.solution(_whole(values, "frameset")))
        with lock:
            match request.method, request.path:
                case "GET", "session":
                    return Reply.of_json({**session.described(), **_state(session)})
                case "POST", "change":
                    return Reply.of_json({**_change(session, values), **_state(session)})
        return None

    return answer


def _state(session: PickSession) -> dict[str, object]:
    return {"corners": session.corners(), "can_undo": bool(session.done), "can_redo": bool(session.undone)}


def _change(session: PickSession, values: Mapping[str, Any]) -> dict[str, object]:
    wanted = values.get("do")
    if wanted in ("undo", "redo"):
        return {"changed": session.undo() if wanted == "undo" else session.redo()}
    about = str(values.get("camera")), str(values.get("rectangle")), _whole(values, "image")
    if wanted == "sigma":
        session.set_sigma(*about, _number(values, "sigma"))
        return {}
    corner = _whole(values, "corner")
    if corner not in range(4):
        raise QuadrigError(f"the page asks for corner {corner} of a rectangle, which has 0 to 3; reload it")
    if wanted == "remove":
        session.remove(*about, corner)
        return {}
    if wanted != "place":
        raise QuadrigError(f"the page asks for {wanted!r}, which is no change; reload it")
    pixel = np.array([_number(values, "x"), _number(values, "y")])
    crossing = session.place(*about, corner, pixel, snap=values.get("snap") is True)
    return {"snapped": None if crossing is None else pixel_list(crossing[None])[0]}


def _whole(values: Mapping[str, Any], key: str) -> int:
    number = _number(values, key)
    if not number.is_integer():
        raise QuadrigError(f"the page gives {number} for {key}, which is no whole number; reload it")
    return int(number)


def _number(values: Mapping[str, Any], key: str) -> float:
    """A finite number of the query or of the JSON."""
    try:
        number = float(values.get(key, ""))
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not np.isfinite(number):
        raise QuadrigError(f"the page gives {values.get(key)!r} for {key}, which is no number; reload it")
    return number
