"""Many recordings: over processes and over a Dask cluster of real workers, one of which is killed."""

import importlib
import os
import signal
import time
from pathlib import Path

import pytest

from quadrig.io.fleet import Job, dask_executor, find_jobs, run_fleet
from quadrig.single.errors import QuadrigError

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
    time.sleep(0.2)
    with (job.output.parent / "log").open("a") as log:
        log.write(f"{job.recording[0].name} {os.getpid()}\\n")
    job.output.write_text(text)
    return f"rig of {text}"
"""


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


def test_a_cluster_of_workers_and_one_is_killed(takes, calibrate):
    distributed = pytest.importorskip("distributed")
    jobs = find_jobs([takes], takes / "rigs")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        outcomes, killed = [], 0
        with dask_executor(cluster.scheduler_address) as executor:
            for outcome in run_fleet(calibrate, jobs, executor=executor):
                outcomes.append(outcome)
                if len(outcomes) == 3:
                    killed = int((takes / "rigs" / "log").read_text().split()[-1])
                    os.kill(killed, signal.SIGKILL)
    assert sorted(outcome.message for outcome in outcomes) == sorted(f"rig of {k}" for k in range(12))
    workers = {int(line.split()[1]) for line in (takes / "rigs" / "log").read_text().splitlines()}
    assert killed in workers
    assert len(workers) >= 2
    assert os.getpid() not in workers


def test_no_scheduler_is_one_sentence(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("quadrig.io.fleet._SECONDS_TO_ANSWER", 1)
    began = time.monotonic()
    with pytest.raises(QuadrigError, match="no Dask scheduler answers"), dask_executor("tcp://127.0.0.1:9"):
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
    assert Job((takes,), Path("x")).output == Path("x")
