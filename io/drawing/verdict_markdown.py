"""The verdict on a rig as a page of text."""

from quadrig.io.drawing.geometry import magnification
from quadrig.io.drawing.tables import markdown_table
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.result import Rig, body_sentence, camera_columns
from quadrig.rig.words import ONE_SIGMA

# Each is a sign of the viewer's font: without a screen it breaks off at any other.
_MARK = {"good": "✔", "with care": "▲", "not yet": "×"}


def verdict_markdown(rig: Rig) -> str:
    """Headline, the cameras as a table, what is weak and what to do, and what is good, in Markdown."""
    judged = verdict(rig)
    lines = [f"### {_MARK[judged.grade]} {judged.headline}", "", *([judged.holds, ""] if judged.holds else [])]
    # The table stands before the lists: however long they are, it is in view.
    lines += [*markdown_table(camera_columns(rig)), "", ONE_SIGMA, ""]
    for body in rig.bodies:
        lines += [body_sentence(body) + ".", ""]
    lines += _listed("What is weak, and what to do", judged.weak) if judged.weak else ["Nothing is weak.", ""]
    lines += [*_listed("Why", judged.good), *_legend(rig)]
    return "\n".join(lines)


def _listed(title: str, sentences: tuple[str, ...]) -> list[str]:
    return [f"**{title}**", "", *(f"- {sentence}" for sentence in sentences), ""] if sentences else []


def _legend(rig: Rig) -> list[str]:
    return [
        f"Rig frame: {rig.reference}.",
        "",
        f"In space: one colour per camera; ellipsoids are position sigmas, drawn {magnification(rig):.0f} times "
        "larger; grey rectangles stand, green ones move along the timeline.",
        "",
        "In pictures: green found, orange predicted, red rejected. Graph: thick lines carry more, red ones disagree.",
    ]
