"""Names out of files on their way to a terminal: shown, in one line, and never obeyed."""

import io
import json
import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

from quadrig.io.commands.main import run
from quadrig.io.plain_words import console, one_line, plain, plain_output

HOSTILE = "\x1b]0;owned\x07\x1b[2J red\x9b31m \u202eback \ud800 \0 \r"


@given(st.text(st.characters(codec=None)))
def test_plain_text_has_nothing_that_a_terminal_obeys_and_is_the_same_string_in_json(text):
    shown = plain(text)
    assert all(letter.isprintable() or ord(letter) >= 0xA0 or letter in "\n\t" for letter in shown)
    assert plain(shown) == shown
    whole = json.dumps(text, ensure_ascii=False)
    assert json.loads(plain(whole)) == text
    assert "\n" not in one_line(text)


def test_a_name_of_ten_thousand_letters_is_cut_and_paths_are_not():
    path = "/" + "/".join(["folder" * 20] * 5)
    assert one_line(f"{path}: no") == f"{path}: no"
    assert one_line("words " * 10_000 + "; mend it").endswith("words ; mend it")
    assert len(one_line("words " * 10_000)) < 2100
    assert one_line("x" * 10_000 + ": no") == "x" * 100 + "... (10001 letters) no"


@pytest.mark.parametrize("terminal", [True, False])
def test_streams_and_consoles_let_nothing_through(monkeypatch, terminal):
    stream = io.StringIO()
    stream.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    with plain_output():
        print(HOSTILE)
        table = Table("camera")
        table.add_row(HOSTILE)
        console().print(table)
        console().print(HOSTILE, style="bold", markup=False)
    shown = stream.getvalue()
    # Styles are our own.
    assert ("\x1b[1m" in shown) == terminal
    assert not any(bad in shown for bad in ("\x1b]", "\x07", "\x1b[2J", "\x9b", "\u202e", "\ud800", "\0", "\r"))
    assert sys.stdout is stream


def test_a_file_that_is_named_so_is_one_plain_line(tmp_path, capsys):
    assert run(["info", str(tmp_path / "a\x1b[31m\nrig: all is well\udcff.mcap")]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "\\u001b[31m rig: all is well\\udcff.mcap: no such file" in said


def test_what_libraries_print_of_a_damaged_picture_is_not_let_through(tmp_path, pictures):
    import cv2

    data = cv2.imencode(".png", pictures.picture(3))[1].tobytes()
    (tmp_path / "a.png").write_bytes(data[:-60] + bytes(40) + data[-20:])
    rig = os.path.join(os.path.dirname(sys.executable), "rig")
    done = subprocess.run([rig, "info", str(tmp_path / "a.png")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.startswith("rig: ")
    assert done.stderr.count("\n") == 1
