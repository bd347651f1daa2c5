"""The verdict on a rig as a page of text."""

import numpy as np

from quadrig.io.drawing.geometry import magnification
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.result import Rig
from quadrig.rig.words import figure, length

_MARK = {"good": "✔", "with care": "▲", "not yet": "✘"}


def verdict_markdown(rig: Rig) -> str:
    """Headline, what is good, what is weak and what to do, and the cameras as a table, in Markdown."""
    judged = verdict(rig)
    lines = [f"## {_MARK[judged.grade]} {judged.headline}", ""]
    lines += [*_listed("Why", judged.good), *_listed("What is weak, and what to do", judged.weak)]
    if not judged.weak:
        lines += ["Nothing is weak.", ""]
    lines += [*camera_table(rig), "", *_legend(rig)]
    return "\n".join(lines)


def camera_table(rig: Rig) -> list[str]:
    """The cameras with their figures as lines of a Markdown table."""
    lines = ["| camera | focal px | position | rotation | RMS px | Views |", "|---|---|---|---|---|---|"]
    for camera in rig.cameras:
        name = camera.name
        lines.append(
            f"| {name} | {camera.intrinsics.focal:.2f} ± {figure(rig.focal_sigma(name), 2)} "
            f"| ± {length(rig.position_sigma(name))} | ± {figure(np.degrees(rig.rotation_sigma(name)), 3)}° "
            f"| {figure(camera.rms, 2)} | {camera.views} |"
        )
    return lines


def _listed(title: str, sentences: tuple[str, ...]) -> list[str]:
    return [f"**{title}**", "", *(f"- {sentence}" for sentence in sentences), ""] if sentences else []


def _legend(rig: Rig) -> list[str]:
    return [
        f"Rig frame: {rig.reference}. One sigma throughout.",
        "",
        f"In space: one colour per camera; ellipsoids are position sigmas, drawn {magnification(rig):.0f} times "
        "larger; grey rectangles stand, green ones move along the timeline.",
        "",
        "In pictures: green found, orange predicted, red rejected. Graph: thick lines carry more, red ones disagree.",
    ]
