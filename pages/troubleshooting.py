"""Which entry of docs/troubleshooting.md explains which sentence of the code.

Under a heading stands a comment, not shown: `<!-- says: FILE; FILE: words | words -->`. It takes the sentences of
those files, or of a file those alone that hold one of the words; a heading with words goes before one without.
"""

import html
import re
from dataclasses import dataclass
from functools import cache

from sentences import ROOT, Sentence, errors, remarks

PAGE = ROOT / "docs" / "troubleshooting.md"

REMARKS = (
    "rig/doubt/weaknesses.py",
    "rig/doubt/verdict.py",
    "rig/doubt/misfit.py",
    "rig/culprits/bodies.py",
    "rig/culprits/cameras.py",
    "rig/culprits/carried.py",
    "rig/culprits/lenses.py",
    "rig/culprits/pictures.py",
    "rig/culprits/sheets.py",
    "rig/coach/advice.py",
    "rig/coach/capture_faults.py",
    "rig/coach/printed_scale.py",
    "rig/problem/connectivity.py",
    "rig/joint/assemble.py",
    "rig/joint/refocused.py",
    "rig/joint/stages.py",
    "rig/moved.py",
    "single/solve/corners.py",
    "single/solve/focal_advice.py",
    "io/search/plain_sights.py",
    "io/search/whole_recording.py",
    "io/live/capture/same_camera.py",
    "io/recording/image_folder.py",
    "io/recording/limits.py",
    "io/recording/messages/mcap_reader.py",
    "io/recording/picture_times.py",
    "io/recording/recorded_cameras.py",
    "io/recording/topic_cameras.py",
)
"""Files whose sentences are no errors: what is weak, what was left out, what to show next."""

_COMMENT = re.compile(r"<!-- says: (.*?) -->", re.S)


@dataclass(frozen=True)
class Claim:
    """That a heading explains a file's sentences: all, or with words those that hold one of them."""

    comment: str
    module: str
    words: tuple[str, ...]

    def takes(self, sentence: Sentence) -> bool:
        holds = not self.words or any(word in sentence.text for word in self.words)
        return self.module == sentence.module and holds


@cache
def all_sentences() -> tuple[Sentence, ...]:
    """Everything that is to be explained, each text of a file once."""
    return tuple(dict.fromkeys([*errors(), *remarks(*REMARKS)]))


def claims(markdown: str) -> list[Claim]:
    """What the headings of the page say that they explain."""
    found = []
    for comment in _COMMENT.finditer(markdown):
        for part in comment[1].split(";"):
            module, _, words = part.strip().partition(": ")
            found.append(Claim(comment[0], module, tuple(w.strip() for w in words.split("|") if w.strip())))
    return found


def taker(sentence: Sentence, every: list[Claim]) -> Claim | None:
    """The heading that explains a sentence: one that names its words before one that takes its file."""
    taking = [claim for claim in every if claim.takes(sentence)]
    return next((claim for claim in taking if claim.words), next(iter(taking), None))


def filled(markdown: str) -> str:
    """The page with the sentences under their headings."""
    every = claims(markdown)
    under: dict[str, list[str]] = {claim.comment: [] for claim in every}
    for sentence in all_sentences():
        claim = taker(sentence, every)
        if claim is not None:
            under[claim.comment].append(sentence.text)
    return _COMMENT.sub(lambda comment: _listed(under[comment[0]]), markdown)


def _listed(texts: list[str]) -> str:
    if not texts:
        return ""
    items = "".join(f"<li>{html.escape(text)}</li>" for text in dict.fromkeys(texts))
    count = len(dict.fromkeys(texts))
    word = "What it says" if count == 1 else f"What it says ({count} sentences)"
    return f'<details class="quote"><summary>{word}</summary><ul>{items}</ul></details>'
