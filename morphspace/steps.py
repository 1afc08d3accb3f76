"""Long work as generators of steps: one mechanism for progress bars, cancelling and resuming.

A generator yields a `Step` whenever a piece is finished and returns its result at the end. Whoever drives it decides
what to do with the steps; stopping is not asking for the next one.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock
from typing import TypeVar

import cv2
from threadpoolctl import threadpool_limits

from morphspace.errors import BadInput

Item = TypeVar("Item")
Result = TypeVar("Result")

WORKERS_VARIABLE = "MORPHSPACE_WORKERS"
WORKER_BYTES = (
    2**28
)  # of a frame under way; a build takes 75 MB a worker at 512 x 512 px: room for 900 x 900 px
KEPT_BYTES, LARGEST_KEPT_BYTES = 2**28, 2**25  # in all, and of one block; the library allows no larger
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # as malloc.h of Linux has them
SHARE_OF_MEMORY = 0.5  # of the machine's, for frames under way
MEMORY_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container, on Linux

_WORKERS: ContextVar[int | Executor | None] = ContextVar("workers", default=None)


@dataclass(frozen=True)
class Step:
    """A finished piece of long work: `stage` says what is being done, `done` of `total` pieces are finished.

    `lines` are for a person who watches, such as the plan of what follows.
    """

    stage: str
    done: int
    total: int
    lines: tuple[str, ...] = ()


Steps = Generator[Step, None, Result]


def spread(count: int, most: int) -> list[int]:
    """Return at most `most` of `count` places, evenly spread in rising order, the first and the last among them."""
    number = min(count, most)
    if number < 2:
        return [0] * number
    step = (count - 1) / (number - 1)
    return [*dict.fromkeys(round(place * step) for place in range(number - 1)), count - 1]


def result_of(steps: Generator[Step, None, Result], on_step: Callable[[Step], None] | None = None) -> Result:
    """Run the work to its end, telling `on_step` of each finished piece, and give its result."""
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        if on_step is not None:
            on_step(step)


class _SingleThreads:
    """Keeps the threads inside BLAS and OpenCV at one while anybody asks for it, and gives back what was before.

    Both limits are the whole process's. Loops may overlap, and end in another order than they began: each setting back
    what it had found would leave the limit of one that is over. So the first sets it and the last one out undoes it.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._asking = 0
        self._undo = ExitStack()

    @contextmanager
    def asked(self) -> Iterator[None]:
        """Hold the limit for a block."""
        with self._lock:
            if self._asking == 0:
                self._undo.enter_context(threadpool_limits(limits=1, user_api="blas"))
                self._undo.callback(cv2.setNumThreads, cv2.getNumThreads())
                cv2.setNumThreads(1)
            self._asking += 1
        try:
            yield
        finally:
            with self._lock:
                self._asking -= 1
                if self._asking == 0:
                    self._undo.close()


_SINGLE_THREADS = _SingleThreads()


def single_threads() -> AbstractContextManager[None]:
    """Keep BLAS and OpenCV at one thread each for a block, as `in_order` does: the same bits on every machine."""
    return _SINGLE_THREADS.asked()


@cache
def keep_freed_memory() -> None:
    """Let the process keep up to 256 MB of the memory that it frees, for the next arrays; the flow asks for it.

    The C library of Linux clears every page that it takes from the system, and gives large blocks back at once (mallopt
    with M_MMAP_THRESHOLD) and what is free beyond a limit (M_TRIM_THRESHOLD). On frames of 512 x 512 px the flow then
    costs 10 % more CPU time (median of 7 pairs of runs in turn, from 2 % to 32 %) and has 1.6 times the page faults.
    Other C libraries are left as they are. The process has no other setting of this kind but the threads of BLAS, of
    OpenCV (`single_threads`) and of OpenImageIO (`io.images`).
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library
        tune = ctypes.CDLL(None).mallopt
        tune(M_MMAP_THRESHOLD, LARGEST_KEPT_BYTES)
        tune(M_TRIM_THRESHOLD, KEPT_BYTES)


def worker_count() -> int:
    """Return how many frames to work on at a time.

    In this order: what `using_workers` set for the block; the environment variable MORPHSPACE_WORKERS; the number of
    cores that this process may use, fewer where their frames would take more than half of the memory. Raises `BadInput`
    where the variable is no number from 1.
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
    """Return the memory of the machine or, where that is less, of the container."""
    found = sys.maxsize
    with suppress(AttributeError, OSError, ValueError):  # Windows has no such figure
        found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, ValueError):  # no container, or one without a limit
        found = min(found, int(MEMORY_LIMIT.read_text()))
    return found


@contextmanager
def using_workers(given: int | Executor | None) -> Iterator[None]:
    """Set for a block how many frames `in_order` works on at a time, or with which executor. None changes nothing."""
    if isinstance(given, int) and given < 1:
        raise BadInput(f"the number of workers is {given}; expected at least 1. Leave it out for one a core")
    token = _WORKERS.set(_WORKERS.get() if given is None else given)
    try:
        yield
    finally:
        _WORKERS.reset(token)


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], executor: Executor | int | None = None
) -> Iterator[Result]:
    """Do `work` on the items at the same time and yield the results in the items' order.

    Only a few items are under way at a time, so memory does not grow with their number. Matrix products and OpenCV's
    filters inside the work run on one thread each: on a busy machine BLAS threads that wait for each other made an
    encoding ten times slower, and some of OpenCV's results depend in their last bits on how many threads share a
    picture. So the results are the same bits for any number of workers.

    Parameters
    ----------
    work
        The function; for an executor of other processes it must be one that can be sent there.
    items
        Its arguments, read as they are needed.
    executor
        What runs it, and is not shut down; or the number of threads to make. None takes what `using_workers` set for
        the block, else `worker_count` threads.
    """
    asked = executor if executor is not None else _WORKERS.get()
    if isinstance(asked, Executor):
        pool: AbstractContextManager[Executor] = nullcontext(asked)
        most = getattr(asked, "_max_workers", None) or worker_count()
    else:
        most = asked or worker_count()
        pool = ThreadPoolExecutor(most)
    with _SINGLE_THREADS.asked(), pool as running:
        pending: deque[Future[Result]] = deque()
        try:
            for item in items:
                pending.append(running.submit(work, item))
                if len(pending) > most:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
            wait(pending)
