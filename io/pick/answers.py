"""What the page of `rig pick` may ask of the session, by path."""

from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from quadrig.io.local_page import Answer, Reply, Request
from quadrig.io.pick.session import PickSession, pixel_list

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
            return Reply(session.jpeg(values["camera"], int(values["image"])), "image/jpeg")
        if (request.method, request.path) == ("GET", "solution"):
            # Clicks do not wait for this.
            with solving:
                return Reply.of_json(session.solution(int(values["frameset"])))
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
    if values["do"] in ("undo", "redo"):
        return {"changed": session.undo() if values["do"] == "undo" else session.redo()}
    about = str(values["camera"]), str(values["rectangle"]), int(values["image"])
    if values["do"] == "sigma":
        session.set_sigma(*about, float(values["sigma"]))
        return {}
    corner = int(values["corner"])
    if corner not in range(4):
        raise ValueError(corner)
    if values["do"] == "remove":
        session.remove(*about, corner)
        return {}
    if values["do"] != "place":
        raise ValueError(values["do"])
    pixel = np.array([float(values["x"]), float(values["y"])])
    if not np.isfinite(pixel).all():
        raise ValueError(pixel)
    crossing = session.place(*about, corner, pixel, snap=bool(values["snap"]))
    return {"snapped": None if crossing is None else pixel_list(crossing[None])[0]}
