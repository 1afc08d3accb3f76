"""Long work as generators of steps, for progress bars, cancelling and resuming.

A generator yields a `Step` after each finished piece and returns its result at the end. Its caller decides what to do
with the steps, and stops the work by not asking for the next one.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from threading import Event, Lock
from typing import TypeVar

import cv2
from threadpoolctl import threadpool_limits

from morphspace.errors import BadInput

Item = TypeVar("Item")
Result = TypeVar("Result")

WORKERS_VARIABLE = "MORPHSPACE_WORKERS"
WORKER_BYTES = 2**28  # of a frame in progress, up to 900 x 900 px; a build takes 75 MB at 512 x 512 px
KEPT_BYTES, LARGEST_KEPT_BYTES = 2**28, 2**25  # in all, and of one block, the limit of the library
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # from malloc.h of Linux
SHARE_OF_MEMORY = 0.5  # of the machine's memory, for frames in progress
MEMORY_LIMIT = Path("/sys/fs/cgroup/memory.max")  # limit of a container on Linux

_WORKERS: ContextVar[int | Executor | None] = ContextVar("workers", default=None)
_ENDED: ContextVar[Event | None] = ContextVar(
    "ended", default=None
)  # set when no result of this work is awaited


@dataclass(frozen=True)
class Step:
    """A finished piece of long work.

    Attributes
    ----------
    stage : str
        The name of the work.
    done, total : int
        Finished pieces and all pieces.
    """

    stage: str
    done: int
    total: int
    lines: tuple[str, ...] = ()


Steps = Generator[Step, None, Result]


def spread(count: int, most: int) -> list[int]:
    """Return at most `most` of `count` indices, evenly spaced and ascending, with the first and the last.

    Examples
    --------
    >>> spread(10, 4)
    [0, 3, 6, 9]
    """
    number = min(count, most)
    if number < 2:
        return [0] * number
    step = (count - 1) / (number - 1)
    return [*dict.fromkeys(round(place * step) for place in range(number - 1)), count - 1]


def result_of(steps: Generator[Step, None, Result], on_step: Callable[[Step], None] | None = None) -> Result:
    """Run a generator of steps to its end, call `on_step` for each step, and return the result.

    Examples
    --------
    >>> def work():
    ...     yield Step("squares", 1, 1)
    ...     return 4
    >>> result_of(work(), lambda step: print(step.stage, step.done, "of", step.total))
    squares 1 of 1
    4
    """
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        if on_step is not None:
            on_step(step)


class _SingleThreads:
    """The limit of one thread for BLAS and OpenCV, shared by overlapping blocks.

    Both limits belong to the whole process. Blocks may overlap and end in any order; if each restored the limit that
    it found, a finished block could leave its own. The first block therefore sets the limit and the last one restores
    it.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._blocks = 0
        self._undo = ExitStack()

    @contextmanager
    def limited(self) -> Iterator[None]:
        """Keep the limit for a block."""
        with self._lock:
            if self._blocks == 0:
                self._undo.enter_context(threadpool_limits(limits=1, user_api="blas"))
                self._undo.callback(cv2.setNumThreads, cv2.getNumThreads())
                cv2.setNumThreads(1)
            self._blocks += 1
        try:
            yield
        finally:
            with self._lock:
                self._blocks -= 1
                if self._blocks == 0:
                    self._undo.close()


_SINGLE_THREADS = _SingleThreads()


def single_threads() -> AbstractContextManager[None]:
    """Limit BLAS and OpenCV to one thread each for a block, as `in_order` does: the same bits everywhere."""
    return _SINGLE_THREADS.limited()


@cache
def keep_freed_memory() -> None:
    """Let the process keep up to 256 MB of freed memory for new arrays; the flow calls this.

    The C library of Linux clears every page that it takes from the system. It returns large blocks at once (mallopt
    with M_MMAP_THRESHOLD) and free memory beyond a limit (M_TRIM_THRESHOLD). On frames of 512 x 512 px the flow then
    takes 10 % more CPU time (median of 7 alternating pairs of runs, 2 % to 32 %) and 1.6 times the page faults. Other
    C libraries stay unchanged. The only other settings of the process are the threads of BLAS and OpenCV
    (`single_threads`) and of OpenImageIO (`io.images`).
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library
        tune = ctypes.CDLL(None).mallopt
        tune(M_MMAP_THRESHOLD, LARGEST_KEPT_BYTES)
        tune(M_TRIM_THRESHOLD, KEPT_BYTES)


def worker_count() -> int:
    """Return how many frames to process at a time.

    The first of these that is set applies: the number of `using_workers`; the environment variable
    MORPHSPACE_WORKERS; the number of cores that this process may use, or fewer if the frames would take more than
    half of the memory.

    Raises
    ------
    BadInput
        If the variable is not a whole number from 1.
    """
    given = _WORKERS.get()
    if isinstance(given, int):
        return given
    words = os.environ.get(WORKERS_VARIABLE, "").strip()
    if not words:
        return max(1, min(core_count(), int(SHARE_OF_MEMORY * _memory_bytes() / WORKER_BYTES)))
    if not (words.isascii() and words.isdigit() and int(words) >= 1):
        raise BadInput(
            f"{WORKERS_VARIABLE} is {words!r}; expected a whole number from 1. Correct it or remove it from the "
            "environment"
        )
    return int(words)


def core_count() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _memory_bytes() -> int:
    """Return the memory of the machine, or of the container if that is less."""
    found = sys.maxsize
    with suppress(AttributeError, OSError, ValueError):  # Windows does not report it
        found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, ValueError):  # no container, or one without a limit
        found = min(found, int(MEMORY_LIMIT.read_text()))
    return found


@contextmanager
def using_workers(given: int | Executor | None) -> Iterator[None]:
    """Set for a block the number of workers of `in_order`, or its executor; None changes nothing.

    Raises `BadInput` for a number below 1.
    """
    if isinstance(given, int) and given < 1:
        raise BadInput(
            f"the number of workers is {given}; expected at least 1. Leave it out for one per core"
        )
    token = _WORKERS.set(_WORKERS.get() if given is None else given)
    try:
        yield
    finally:
        _WORKERS.reset(token)


def check_awaited() -> None:
    """Raise `CancelledError` in work of `in_order` whose loop has ended, so that a stopped run ends within a second.

    A picture of 800 x 960 px takes a second of processor time; the flow calls this between its parts.
    """
    ended = _ENDED.get()
    if ended is not None and ended.is_set():
        raise CancelledError


def _until(ended: Event, work: Callable[[Item], Result], item: Item) -> Result:
    _ENDED.set(ended)
    return work(item)


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], executor: Executor | int | None = None
) -> Iterator[Result]:
    """Call `work` on the items in parallel and yield the results in the order of the items.

    Only a few items are in progress at a time, so memory does not grow with their number. BLAS and OpenCV run on one
    thread each inside the work. On a busy machine, BLAS threads that waited for each other made an encoding ten times
    slower. Some of OpenCV's results depend in their last bits on how many threads share a picture. The results are
    therefore the same bits for any number of workers.

    Parameters
    ----------
    work : function
        For an executor of other processes it must be picklable.
    items : iterable
        Its arguments, read as they are needed.
    executor : Executor or int, optional
        The executor, which is not shut down, or the number of threads. By default that of `using_workers`, else
        `worker_count`
        threads.

    Examples
    --------
    >>> list(in_order(abs, [-3, 2, -1], 2))
    [3, 2, 1]
    """
    asked = executor if executor is not None else _WORKERS.get()
    ended = Event()
    if isinstance(asked, Executor):
        pool: AbstractContextManager[Executor] = nullcontext(asked)
        most = getattr(asked, "_max_workers", None) or worker_count()
    else:
        most = asked or worker_count()
        pool = ThreadPoolExecutor(most)
        work = partial(_until, ended, work)
    with _SINGLE_THREADS.limited(), pool as running:
        pending: deque[Future[Result]] = deque()
        try:
            for item in items:
                pending.append(running.submit(work, item))
                if len(pending) > most:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            ended.set()
            for future in pending:
                future.cancel()
            wait(pending)
