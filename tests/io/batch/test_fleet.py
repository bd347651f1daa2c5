"""Many recordings: over processes and over a Dask cluster of real workers, one of which is killed."""

import importlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.batch.fleet import FleetJob, dask_executor, find_jobs, run_fleet
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

CALIBRATE = """
import os, time
from pathlib import Path
from quadrig.single.errors import QuadrigError

def calibrate(job):
    text = job.recording[0].read_text()
    if text == "bad":
        raise QuadrigError(f"{job.recording[0]}: no images in this recording; record some")
    if text == "worse":
        raise ZeroDivisionError("by nothing")
    if text == "deadly":
        os.kill(os.getpid(), 9)
    time.sleep(0.2)
    with (job.output.parent / "log").open("a") as log:
        log.write(f"{job.recording[0].name} {os.getpid()}\\n")
    job.output.write_text(text)
    return f"rig of {text}"
"""


RIG = Path(sys.executable).with_name("rig")
DESK = Rectangle("desk", 0.20, 0.20, TagMarking("apriltag_36h11", 1))
ROOM = """
[[rectangle]]
name = "desk"
width = 0.2
height = 0.2
moving = true
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 1 }
"""


def record_desk(folder: Path, recording: Path) -> None:
    """Two cameras that see one tag in six attitudes."""
    lens, rng = Intrinsics.centred(320, 240, 300.0), np.random.default_rng(5)
    right_from_left = Pose.from_vectors(np.array([0.0, 0.3, 0.0]), np.array([-0.3, 0.0, 0.05]))
    for frameset in range(6):
        pose = Pose.from_vectors(rng.uniform(-0.7, 0.7, 3), np.array([*rng.uniform(-0.1, 0.1, 2), 0.9]))
        for name, camera_from_world in (("left", Pose.identity()), ("right", right_from_left)):
            image = render_image(
                ray_grid(lens), camera_from_world, [Sheet(DESK, pose)], capture=Capture(blur=0.6, noise=1.5), rng=rng
            )
            (folder / name).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / name / f"{frameset:03}.png"), image)
    arguments = [f"--camera={side}={folder / side}" for side in ("left", "right")]
    subprocess.run([RIG, "record", *arguments, "-o", recording], check=True, capture_output=True)


@pytest.fixture
def calibrate(tmp_path, monkeypatch):
    """A stand-in for a calibration, in a module that worker processes can import."""
    (tmp_path / "calibrate_of_this_test.py").write_text(CALIBRATE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    return importlib.reload(importlib.import_module("calibrate_of_this_test")).calibrate


@pytest.fixture
def takes(tmp_path):
    """Twelve takes and a folder for their rigs."""
    folder = tmp_path / "takes"
    (folder / "rigs").mkdir(parents=True)
    for k in range(12):
        (folder / f"take{k}.mcap").write_text(str(k))
    return folder


def test_one_rig_each_and_what_is_done_stays(takes, calibrate):
    jobs = find_jobs([takes], takes / "rigs")
    assert [job.output.name for job in jobs][:2] == ["take0.rig.mcap", "take1.rig.mcap"]
    (takes / "take3.mcap").write_text("bad")
    (takes / "take4.mcap").write_text("worse")
    outcomes = {outcome.job.recording[0].name: outcome for outcome in run_fleet(calibrate, jobs, workers=2)}
    assert len(outcomes) == 12
    assert {name for name, outcome in outcomes.items() if outcome.failed} == {"take3.mcap", "take4.mcap"}
    assert "no images" in outcomes["take3.mcap"].message
    assert "ZeroDivisionError" in outcomes["take4.mcap"].message
    assert (takes / "rigs" / "take5.rig.mcap").read_text() == "5"
    (takes / "take3.mcap").write_text("mended")
    again = list(run_fleet(calibrate, jobs, workers=2))
    assert sum(outcome.kept for outcome in again) == 10
    assert (takes / "rigs" / "take3.rig.mcap").read_text() == "mended"


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_recording_that_kills_its_workers_is_given_up_and_no_other_is_begun_again(takes, calibrate):
    (takes / "take3.mcap").write_text("deadly")
    outcomes = list(run_fleet(calibrate, find_jobs([takes], takes / "rigs"), workers=2))
    assert [outcome.job.recording[0].name for outcome in outcomes if outcome.failed] == ["take3.mcap"]
    assert any("a worker process was ended 5 times" in outcome.message for outcome in outcomes)
    done = [line.split()[0] for line in (takes / "rigs" / "log").read_text().splitlines()]
    assert sorted(done) == sorted(f"take{k}.mcap" for k in range(12) if k != 3)


def test_a_worker_of_a_cluster_is_killed_and_nothing_is_lost(tmp_path):
    """As in the README: a scheduler and real worker processes, and the command."""
    distributed = pytest.importorskip("distributed")
    (tmp_path / "rig.toml").write_text(ROOM)
    (tmp_path / "takes").mkdir()
    record_desk(tmp_path, tmp_path / "takes" / "take0.mcap")
    for k in range(1, 4):
        shutil.copy(tmp_path / "takes" / "take0.mcap", tmp_path / "takes" / f"take{k}.mcap")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        command = [RIG, "calibrate", "takes/", "--each", "--dask", cluster.scheduler_address, "-o", "rigs/"]
        running = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        address, nanny = next((one.worker_address, one) for one in cluster.workers.values())
        until = time.monotonic() + 60
        while not client.processing().get(address) and time.monotonic() < until:
            time.sleep(0.02)
        os.kill(nanny.pid, signal.SIGKILL)
        said, complaint = running.communicate(timeout=120)
    assert running.returncode == 0, complaint
    assert sorted(line.split(":")[0] for line in said.splitlines()) == [f"rigs/take{k}.rig.mcap" for k in range(4)]
    # The same images make the same rig, whichever worker made it.
    assert len({tuple(read_rig(tmp_path / "rigs" / f"take{k}.rig.mcap").covariance.ravel()) for k in range(4)}) == 1


def test_no_scheduler_is_one_sentence():
    pytest.importorskip("distributed")
    began = time.monotonic()
    with (
        pytest.raises(QuadrigError, match="no Dask scheduler answers"),
        dask_executor("tcp://127.0.0.1:9", patience=1.0),
    ):
        pass
    assert time.monotonic() - began < 30


def test_jobs_of_folders(tmp_path, takes):
    nested = tmp_path / "fleet"
    (nested / "robot1" / "bag").mkdir(parents=True)
    (nested / "robot1" / "bag" / "metadata.yaml").write_text("")
    (nested / "robot2").mkdir()
    (nested / "robot2" / "b.mcap").write_text("")
    (nested / "robot2" / "b.rig.mcap").write_text("")
    (nested / "robot2" / "b.detections.mcap").write_text("")
    jobs = find_jobs([nested], Path("out"))
    assert [(job.recording[0].name, job.output.name) for job in jobs] == [
        ("bag", "bag.rig.mcap"),
        ("b.mcap", "b.rig.mcap"),
    ]
    with pytest.raises(QuadrigError, match="both be written"):
        find_jobs([takes, takes / "take0.mcap"], Path("out"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(QuadrigError, match="no recordings"):
        find_jobs([tmp_path / "empty"], Path("out"))
    assert FleetJob((takes,), Path("x")).output == Path("x")
