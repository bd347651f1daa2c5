"""Tasks over worker processes: results as they come, lost workers replaced, nothing left running behind."""

import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

import cv2

from quadrig.single.errors import QuadrigError

Task = TypeVar("Task")
Result = TypeVar("Result")

# A worker may be killed by chance (memory, a colleague); a task that kills three in a row is itself the cause.
_ROUNDS_WITHOUT_PROGRESS = 3
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
) -> Generator[tuple[int, Result], None, None]:
    """Index and result of each task, in the order of completion. function and tasks must be picklable.

    workers: processes of a pool of our own, 1: none but this one. executor: used instead, where given.
    A process that is killed loses nothing: its tasks are done again. Raises QuadrigError where that does not help,
    and lets through what a task raises. When the caller stops early, or is interrupted, the workers are ended.
    """
    workers = default_workers() if workers is None else workers
    if executor is not None:
        yield from _completed(executor, function, list(enumerate(tasks)))
    elif workers <= 1 or len(tasks) <= 1:
        for index, task in enumerate(tasks):
            yield index, function(task)
    else:
        yield from _over_pool(function, tasks, min(workers, len(tasks)))


def _over_pool(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Iterator[tuple[int, Result]]:
    left = dict(enumerate(tasks))
    failures = 0
    while left:
        try:
            with _pool(workers) as pool:
                for index, result in _completed(pool, function, list(left.items())):
                    del left[index]
                    failures = 0
                    yield index, result
        except BrokenProcessPool as error:
            failures += 1
            if failures == _ROUNDS_WITHOUT_PROGRESS:
                raise QuadrigError(
                    f"a worker process was ended {failures} times in a row, {len(left)} tasks are left; "
                    "is there enough memory? use fewer workers"
                ) from error


def _completed(
    executor: Executor, function: Callable[[Task], Result], tasks: Sequence[tuple[int, Task]]
) -> Iterator[tuple[int, Result]]:
    with _starting_processes(with_script=function.__module__ == "__main__"):
        futures: dict[Future[Result], int] = {executor.submit(_run, function, task): index for index, task in tasks}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        # Those of a process pool end with it; cancelled ones would make its thread complain as the workers are ended.
        if not isinstance(executor, ProcessPoolExecutor):
            for future in futures:
                future.cancel()


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    before = set(multiprocessing.active_children())
    # Not forked: the threads that OpenCV has by now would be missing in the child, which waits for them for ever.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker)
    finished = False
    try:
        yield pool
        finished = True
    finally:
        if not finished:
            # Their tasks would run on for seconds, and at exit Python would wait for them.
            ended = set(multiprocessing.active_children()) - before
            for process in ended:
                process.terminate()
            for process in ended:
                process.join(_SECONDS_TO_END)
                # One that waits for a lock that died with another worker takes the request for a failed result.
                process.kill()
        pool.shutdown(wait=finished, cancel_futures=True)


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
