"""Tasks over worker processes: results as they come, lost workers replaced, nothing left running behind."""

import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Generic, TypeVar

import cv2

from quadrig.single.errors import QuadrigError

Task = TypeVar("Task")
Result = TypeVar("Result")

# A worker may be killed by chance (memory, a colleague): of tasks that take a quarter of the time from kill to kill,
# one in two thousand meets that five times.
MOST_KILLS = 5
"""So many workers are ended at one task before it is given up."""
ENDED_TOO_OFTEN = f"a worker process was ended {MOST_KILLS} times at the same task"
# A worker has one task to go on with when it is done with the one before, however busy the caller is with results.
_TASKS_AHEAD = 2
# A process that is asked to end is gone in milliseconds, unless the disk holds it; Ctrl-C promises a second.
_SECONDS_TO_END = 0.3


def default_workers() -> int:
    """As many worker processes as this process may use processors."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int | None = None,
    executor: Executor | None = None,
    given_up: Callable[[Task], Result] | None = None,
) -> Generator[tuple[int, Result], None, None]:
    """Index and result of each task, in the order of completion. function and tasks must be picklable.

    workers: processes of a pool of our own, 1: none but this one. executor: used instead, where given.
    A process that is killed loses nothing: its task is done again. Where MOST_KILLS were ended at one task, given_up
    says what stands for its result; without it, raises QuadrigError. Lets through what a task raises. When the caller
    stops early, or is interrupted, the workers are ended.
    """
    workers = default_workers() if workers is None else workers
    if executor is not None:
        yield from _completed(executor, function, list(enumerate(tasks)))
    elif workers <= 1 or len(tasks) <= 1:
        for index, task in enumerate(tasks):
            yield index, function(task)
    else:
        yield from _over_lanes(function, tasks, min(workers, len(tasks)), given_up)


def _over_lanes(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    given_up: Callable[[Task], Result] | None,
) -> Iterator[tuple[int, Result]]:
    waiting, kills = deque(range(len(tasks))), Counter[int]()
    with _lanes(function, tasks, workers) as lanes:
        while True:
            for lane in lanes:
                lane.fill(waiting, spare=len(lanes))
            running = [future for lane in lanes for future, _ in lane.given]
            if not running:
                return
            wait(running, return_when=FIRST_COMPLETED)
            for lane in lanes:
                while lane.given and lane.given[0][0].done():
                    future, index = lane.given.popleft()
                    try:
                        result = future.result()
                    except BrokenProcessPool as error:
                        kills[index] += 1
                        # The tasks behind it are as they were.
                        waiting.extendleft(behind for _, behind in reversed(lane.given))
                        lane.renew()
                        if kills[index] < MOST_KILLS:
                            # Behind all others, for it may be the task that kills.
                            waiting.append(index)
                            break
                        if given_up is None:
                            raise QuadrigError(
                                f"{ENDED_TOO_OFTEN}; is there enough memory? use fewer workers"
                            ) from error
                        result = given_up(tasks[index])
                    lane.fill(waiting, spare=len(lanes))
                    yield index, result


class _Lane(Generic[Task, Result]):
    """One worker process, replaced when it is killed, and the tasks it was given, the first of which it works on.

    Pools of one each: where a worker of a larger one is killed, Python ends all of its others.
    """

    def __init__(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> None:
        self._function, self._tasks = function, tasks
        self.given: deque[tuple[Future[Result], int]] = deque()
        self.renew()

    def renew(self) -> None:
        """Begin anew without any task."""
        self.given.clear()
        # Not forked: the threads that OpenCV has by now would be missing in the child, which waits for them for ever.
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_begin_worker)

    def fill(self, waiting: deque[int], spare: int) -> None:
        """Take the next of the tasks that wait; one ahead only while there are more than `spare`."""
        while waiting and len(self.given) < (_TASKS_AHEAD if len(waiting) > spare else 1):
            try:
                with _starting_processes(with_script=self._function.__module__ == "__main__"):
                    future = self._pool.submit(_run, self._function, self._tasks[waiting[0]])
            except BrokenProcessPool:
                # It was killed while it had nothing to do, or what it had is found lost when it is looked at.
                if self.given:
                    return
                self.renew()
                continue
            self.given.append((future, waiting.popleft()))

    def close(self, finished: bool) -> None:
        """Let go of the process, which is waited for where all is done."""
        self._pool.shutdown(wait=finished, cancel_futures=True)


def _completed(
    executor: Executor, function: Callable[[Task], Result], tasks: Sequence[tuple[int, Task]]
) -> Iterator[tuple[int, Result]]:
    futures: dict[Future[Result], int] = {executor.submit(_run, function, task): index for index, task in tasks}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()


@contextmanager
def _lanes(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Iterator[list[_Lane[Task, Result]]]:
    before = set(multiprocessing.active_children())
    lanes = [_Lane(function, tasks) for _ in range(workers)]
    finished = False
    try:
        yield lanes
        finished = True
    finally:
        if not finished:
            # Their tasks would run on for seconds, and at exit Python would wait for them.
            end_processes(set(multiprocessing.active_children()) - before)
        for lane in lanes:
            lane.close(finished)


@contextmanager
def _starting_processes(with_script: bool) -> Iterator[None]:
    """While worker processes start: they inherit that Ctrl-C is the parent's business, and no script of the user's.

    A new process runs the user's script once more up to its `if __name__ == "__main__"`, and a script without that
    line without end; tasks of ours need nothing from it, with_script: this one does.
    """
    main = sys.modules["__main__"]
    names = () if with_script else ("__file__", "__spec__")
    hidden = {name: vars(main)[name] for name in names if name in vars(main)}
    blocked = (
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    )
    try:
        vars(main).update(dict.fromkeys(hidden))
        yield
    finally:
        vars(main).update(hidden)
        if blocked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _run(function: Callable[[Task], Result], task: Task) -> Result:
    try:
        return function(task)
    except SystemExit:
        # The pool would take it for a result and hand out the next task.
        os._exit(1)


def _begin_worker() -> None:
    """Ctrl-C is the parent's business, and processes beat OpenCV's own threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
    leave_with_parent()
    cv2.setNumThreads(1)


def end_processes(processes: Collection[BaseProcess]) -> None:
    """End worker processes, whatever they do."""
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(_SECONDS_TO_END)
        # One that waits for a lock that died with another worker takes the request for a failed result.
        process.kill()


def leave_with_parent() -> None:
    """Have this worker process end when the one that started it is killed: it would wait for work for ever."""
    threading.Thread(target=_watch_parent, name="parent", daemon=True).start()


def _watch_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    multiprocessing.connection.wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    # One that is searching or solving does not hear that in time.
    time.sleep(_SECONDS_TO_END)
    os._exit(1)


def _end(_number: int, _frame: FrameType | None) -> None:
    """A worker that is asked to end finishes or removes on its way out what it is writing."""
    sys.exit(1)
