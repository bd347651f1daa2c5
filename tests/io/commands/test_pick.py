"""`rig pick` as a command: it says where its page is, answers there, and ends with Ctrl-C."""

import signal
import subprocess
import sys
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from quadrig.io.commands.main import run


def test_it_serves_its_page_until_ctrl_c(load_script, tmp_path):
    court = load_script("tests/io/court_room.py")
    pictures = [str(path) for path in court.write(tmp_path)]
    command = [
        sys.executable,
        "-m",
        "quadrig.io",
        "pick",
        *pictures,
        "--no-browser",
        "-c",
        str(tmp_path / "rig.toml"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        try:
            assert "Corners by hand" in urlopen(url, timeout=20).read().decode()
            with pytest.raises(HTTPError, match="404"):
                urlopen(url.rsplit("/", 2)[0] + "/", timeout=20)
        finally:
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "no corner was placed" in said
    assert "Traceback" not in said


def test_without_anything_to_point_at_it_says_so(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text('[[rectangle]]\nname = "a"\nsize = "A4"\nmarking = { kind = "plain" }\n')
    assert run(["pick", str(tmp_path), "--config", str(tmp_path / "rig.toml"), "--no-browser"]) == 1
    assert 'no rectangle has marking = { kind = "points" }' in capsys.readouterr().err
