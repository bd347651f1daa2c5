"""One progress bar for every command: on stderr, with rate and time left; nothing where stderr is no terminal."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from quadrig.io.plain_words import console
from quadrig.io.verbosity import is_quiet, timed

Advance = Callable[[int], None]
"""Called with the number of things done since the last call."""


def _say_nothing(done: int) -> None:
    """Where nobody watches."""


@contextmanager
def progress_bar(stage: str, total: int, unit: str = "frames", quiet: bool = False) -> Iterator[Advance]:
    """A bar for one stage: `with progress_bar("detect", 1200) as advance: advance(16)`.

    Draws only on a terminal. The bar stays on the screen when the stage is done, so that stages read as a list.
    """
    if quiet or is_quiet() or total <= 0 or not sys.stderr.isatty():
        with timed(f"{stage}: {total} {unit}"):
            yield _say_nothing
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    rate = _rate_column(unit)
    columns = (TextColumn("{task.description:<10}"), BarColumn(), MofNCompleteColumn(), rate, TimeRemainingColumn())
    with Progress(*columns, console=console(stderr=True)) as bar:
        task = bar.add_task(stage, total=total)
        yield lambda done: bar.advance(task, done)


def _rate_column(unit: str):
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if speed is None else f"{speed:.0f} {unit}/s", style="progress.data.speed")

    return Rate()
