"""A Rig in a notebook: its verdict and its cameras in words, and rerun's viewer where it is there for notebooks."""

import contextlib
import io
import os
from importlib.util import find_spec

from quadrig.io.drawing.verdict_markdown import verdict_markdown
from quadrig.rig.result import Rig

_HEIGHT = 480


def show_in_notebook(rig: Rig) -> None:
    """Display a rig in the cell that runs."""
    # It is there wherever there is a notebook, and nowhere else.
    from IPython.display import Markdown, display  # pyright: ignore[reportMissingImports]

    display(Markdown(verdict_markdown(rig)))
    # What `pip install 'rerun-sdk[notebook]'` adds.
    if find_spec("rerun_notebook") is not None:
        _show_space(rig)


def _show_space(rig: Rig) -> None:
    # The viewer's own program comes from this machine, not from its maker's, unless somebody chose.
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
    with contextlib.redirect_stdout(io.StringIO()):
        import rerun as rr
        import rerun.blueprint as rrb
        from rerun.notebook import Viewer

    from quadrig.io.drawing.palette import rig_colours
    from quadrig.io.viewer.inspect.blueprint import space_view
    from quadrig.io.viewer.inspect.space import log_space

    stream = rr.RecordingStream("quadrig")
    blueprint = rrb.Blueprint(
        space_view(rig), rrb.TimePanel(state="collapsed", timeline="frameset"), collapse_panels=True
    )
    viewer = Viewer(width="auto", height=_HEIGHT, recording=stream, blueprint=blueprint)
    log_space(stream, rig, rig_colours(rig), ())
    stream.flush()
    viewer.display()
