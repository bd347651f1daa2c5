"""Words that come from files, on their way to a terminal: control characters are shown and not obeyed."""

import hashlib
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

# C0 and C1 but for newline and tab; what turns the direction of writing; halves of surrogate pairs, which no encoding
# has and names of files may hold.
_UNSAFE = re.compile("[\0-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_BREAK = re.compile(r"\s*[\n\r\v\f\x1c-\x1e\x85\u2028\u2029]\s*")
# Four times the longest name of a file: no name that a person reads.
_LONG_WORD = re.compile(r"\S{1000,}")
_SHOWN = 100
# The names of two hundred cameras; and what is to be done stands at the end.
_LONGEST_SENTENCE = 2000
LONGEST_NAME = 200
"""Letters of a name that a file can be called by, with room for an ending."""


def plain(text: str) -> str:
    r"""The text with each control character as JSON and YAML write it, \u001b."""
    return _UNSAFE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def plain_name(name: str) -> str:
    """A name out of a file, plain and of a length that names of files have too; the same for the same name."""
    shown = plain(name).replace("\n", "\\n").replace("\t", "\\t")
    if len(shown) <= LONGEST_NAME:
        return shown
    mark = hashlib.blake2b(shown.encode(), digest_size=6).hexdigest()
    return f"{shown[: LONGEST_NAME - 1 - len(mark)]}-{mark}"


def one_line(sentence: str) -> str:
    """A sentence in one line that a person can read, whatever names are in it."""
    line = _BREAK.sub(" ", sentence)
    line = _LONG_WORD.sub(lambda word: f"{word[0][:_SHOWN]}... ({len(word[0])} letters)", line)
    if len(line) > _LONGEST_SENTENCE:
        half = _LONGEST_SENTENCE // 2
        line = f"{line[:half]} ... {line[-half:]}"
    return plain(line)


@contextmanager
def plain_output() -> Iterator[None]:
    """Meanwhile what is written to stdout and stderr is plain; consoles of this module write past it."""
    before: Any = (sys.stdout, sys.stderr)
    sys.stdout, sys.stderr = (_PlainStream(stream) for stream in before)  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def silence_libraries() -> None:
    """From here on stderr is this process's own: what libraries in C print of damaged pictures is said in words."""
    if sys.stderr is None or sys.stderr is not sys.__stderr__:
        return
    own, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    sys.stderr = open(own, "w", 1, sys.stderr.encoding, "backslashreplace")  # noqa: SIM115 - to the process's end


def console(stderr: bool = False) -> "Console":
    """Rich's console on stdout or stderr, as wide as the terminal, in a file or pipe as wide as COLUMNS says, else
    80: it styles, what it prints does not."""
    from rich.console import Console, ConsoleOptions
    from rich.segment import Segment

    class PlainConsole(Console):
        def render(self, renderable: Any, options: ConsoleOptions | None = None) -> Iterator[Segment]:
            for text, style, control in super().render(renderable, options):
                yield Segment(text if control else plain(text), style, control)

    stream = sys.stderr if stderr else sys.stdout
    return PlainConsole(file=getattr(stream, "rich_proxied_file", stream), stderr=stderr, highlight=False)


class _PlainStream:
    """A text stream that is written to in plain words. rich_proxied_file: the stream itself, as rich calls it."""

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        self.rich_proxied_file.write(plain(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)
