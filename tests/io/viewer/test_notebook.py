"""A Rig at the end of a notebook's cell: words always, the viewer where it is there for notebooks."""

import sys
from importlib import reload
from types import ModuleType, SimpleNamespace

import pytest

import quadrig.io
from quadrig.io.drawing.verdict_markdown import verdict_markdown
from quadrig.io.viewer import notebook
from quadrig.rig.result import Rig


@pytest.fixture
def cell(monkeypatch):
    """A notebook that keeps what is displayed in its cell, and how it shows values of which class."""
    shown, ways = [], {}
    formatter = SimpleNamespace(for_type_by_name=lambda module, name, way: ways.__setitem__((module, name), way))
    shell = SimpleNamespace(kernel=None, display_formatter=SimpleNamespace(ipython_display_formatter=formatter))
    ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
    monkeypatch.setattr(ipython, "get_ipython", lambda: shell, raising=False)
    monkeypatch.setattr(display, "display", shown.append, raising=False)
    monkeypatch.setattr(display, "Markdown", str, raising=False)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return SimpleNamespace(shown=shown, ways=ways, shell=shell)


def test_a_rig_shows_its_verdict_and_its_cameras(cell, example_rig, monkeypatch):
    monkeypatch.setattr(notebook, "find_spec", lambda _name: None)
    reload(quadrig.io)
    cell.ways[Rig.__module__, Rig.__name__](example_rig)
    assert cell.shown == [verdict_markdown(example_rig)]


def test_the_viewer_stands_below_where_it_is_there(cell, example_rig, monkeypatch):
    monkeypatch.setattr(notebook, "find_spec", lambda _name: object())
    monkeypatch.setattr(notebook, "_show_space", lambda rig: cell.shown.append(rig))
    notebook.show_in_notebook(example_rig)
    assert cell.shown == [verdict_markdown(example_rig), example_rig]


def test_a_terminal_is_no_notebook(cell):
    del cell.shell.kernel
    reload(quadrig.io)
    assert not cell.ways
