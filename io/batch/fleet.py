"""Many recordings, one rig each, over processes or the machines of a Dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic

from quadrig.io.recording.image_folder import folder_images
from quadrig.io.recording.messages.ros_bag import is_bag
from quadrig.io.recording.recorded_cameras import is_result
from quadrig.io.recording.video import VIDEO_SUFFIXES
from quadrig.io.workers import ENDED_TOO_OFTEN, run_tasks
from quadrig.single.errors import QuadrigError

# A task whose worker is killed is run again by the cluster; more often than this, and it is the task that kills.
_RETRIES = 3
# A scheduler on another continent answers in one.
SECONDS_TO_ANSWER = 10.0
"""How long a Dask scheduler is waited for."""


@dataclass(frozen=True)
class FleetJob:
    """One recording to be calibrated and where its result goes."""

    recording: tuple[Path, ...]
    output: Path

    def absolute(self) -> "FleetJob":
        """The same with absolute paths: a worker on a cluster stands in a folder of its own."""
        return FleetJob(tuple(path.absolute() for path in self.recording), self.output.absolute())


@dataclass(frozen=True)
class Outcome:
    """What became of a job. message: the result in words, or why it failed, in one sentence.

    kept: the result was there already and is newer than the recording.
    """

    job: FleetJob
    message: str
    failed: bool = False
    kept: bool = False
    seconds: float = 0.0


Calibrate = Callable[[FleetJob], str]
"""Calibrates one recording in its own process, writes the output whole, and returns the result in words.

It must be picklable, and must raise QuadrigError where a person can mend what is wrong.
"""


@dataclass(frozen=True)
class _Task:
    calibrate: Calibrate
    job: FleetJob


def find_jobs(paths: Sequence[Path], output: Path) -> list[FleetJob]:
    """A job for each recording: each MCAP file, each folder of one recording, each in a folder of such.

    output: the folder of the results, NAME.rig.mcap. Raises QuadrigError where there is no recording or two have
    one name.
    """
    jobs: dict[str, FleetJob] = {}
    for recording in (part for path in paths for part in _recordings(Path(path))):
        name = recording.stem if recording.is_file() else recording.name
        if name in jobs:
            raise QuadrigError(
                f"{recording} and {jobs[name].recording[0]} would both be written to {jobs[name].output}; rename one"
            )
        jobs[name] = FleetJob((recording,), output / f"{name}.rig.mcap")
    if not jobs:
        raise QuadrigError(f"{', '.join(map(str, paths))}: no recordings here; give MCAP files or folders of them")
    return list(jobs.values())


def run_fleet(
    calibrate: Calibrate,
    jobs: Sequence[FleetJob],
    workers: int | None = None,
    executor: Executor | None = None,
    again: bool = False,
) -> Iterator[Outcome]:
    """The outcome of each job as it comes; one that fails does not hold up the others.

    Results that are newer than their recording are kept, so that a fleet that was stopped goes on where it was;
    again: calibrate all. executor: a cluster's, else a process pool of `workers`.
    """
    todo = []
    for job in jobs:
        if not again and is_done(job):
            yield Outcome(job, "kept", kept=True)
        else:
            todo.append(job)
    tasks = [_Task(calibrate, job.absolute()) for job in todo]
    for index, outcome in run_tasks(_run, tasks, workers, executor, _given_up):
        yield replace(outcome, job=todo[index])


@contextmanager
def dask_executor(address: str, patience: float = SECONDS_TO_ANSWER) -> Iterator[Executor]:
    """The workers of a Dask cluster (tcp://scheduler:8786) as an Executor.

    They need quadrig installed and the recordings under the same paths. A task whose worker dies is run again by
    another. Raises QuadrigError where Dask is not installed or the scheduler does not answer.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise QuadrigError("a cluster needs Dask; install it with: pip install 'quadrig[dask]'") from error
    try:
        client = Client(address, timeout=patience, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise QuadrigError(
            f"{address}: no Dask scheduler answers there; give its address, tcp://HOST:8786"
        ) from error
    try:
        # pure: Dask would take two runs of one job for the same and hand out the first result.
        yield client.get_executor(pure=False, retries=_RETRIES)
    finally:
        client.close()


def _given_up(task: _Task) -> Outcome:
    what = f"{ENDED_TOO_OFTEN}; is there enough memory? use fewer workers, or leave {task.job.recording[0]} out"
    return Outcome(task.job, what, failed=True)


def _run(task: _Task) -> Outcome:
    began = monotonic()
    try:
        message = task.calibrate(task.job)
    except QuadrigError as error:
        return Outcome(task.job, str(error), failed=True, seconds=monotonic() - began)
    except Exception as error:
        what = f"{task.job.recording[0]}: unexpected error ({type(error).__name__}: {error})"
        return Outcome(task.job, what, failed=True, seconds=monotonic() - began)
    return Outcome(task.job, message, seconds=monotonic() - began)


def is_done(job: FleetJob) -> bool:
    """Whether its result is there and newer than its recording."""
    if not job.output.is_file():
        return False
    newest = max(path.stat().st_mtime_ns for path in job.recording)
    return job.output.stat().st_mtime_ns >= newest


def _recordings(path: Path) -> list[Path]:
    if not path.exists():
        raise QuadrigError(f"{path}: no such file or folder; give MCAP files or folders of recordings")
    if path.is_file():
        return [path]
    # What is hidden is not whole: a file that is being written, or was when its process was killed.
    inside = sorted(one for one in path.iterdir() if not one.name.startswith("."))
    if (path / "metadata.yaml").is_file() or any(p.suffix.lower() in VIDEO_SUFFIXES for p in inside):
        return [path]
    if any(p.is_dir() and folder_images(p) for p in inside):
        return [path]
    mcaps = [p for p in inside if (p.suffix.lower() == ".mcap" and not is_result(p)) or (p.is_file() and is_bag(p))]
    return mcaps + [part for p in inside if p.is_dir() for part in _recordings(p)]
